"""The main table on a downloaded data set: a folder as SLoClas unpacks, known directions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile
from plane_waves import plane_waves

from model_export.__main__ import main
from model_export.experiments.on_recordings import TASKS, recordings
from model_export.experiments.study import Study
from service.doa.array import MicrophoneArray

pytestmark = [pytest.mark.torch, pytest.mark.learns]

SQUARE = MicrophoneArray(
    "the recordings'", 0.02285 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
)
ZERO_DEG = 40.0
"""Angle by which the loudspeaker's scale is turned against the array"""


@pytest.fixture
def download(tmp_path: Path) -> Path:
    """Three directions, five segments each: four train, one tests."""
    for degrees in (1, 121, 241):
        folder = tmp_path / "SoClas_database" / "Segmented_Sound" / "bell" / f"class1_{degrees}"
        folder.mkdir(parents=True)
        for segment in range(5):
            audio = plane_waves(SQUARE, [degrees + ZERO_DEG], num_samples=17408, seed=segment)
            scaled = 0.3 * audio / np.abs(audio).max()
            soundfile.write(folder / f"{segment}.wav", scaled.T, 16000, subtype="PCM_16")
    return tmp_path


def test_every_method_is_trained_and_scored_on_a_download(
    download: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    docs, runs = tmp_path / "docs", tmp_path / "runs"
    command = ["recordings", "sloclas", str(download), "--scale", "smoke"]
    assert main([*command, "--runs", str(runs), "--out", str(docs)]) == 0
    text = (docs / "results.md").read_text()
    assert "### Recordings: SLoClas" in text
    rows = {line.split(" | ")[0]: line for line in text.splitlines() if line.startswith("| ")}
    # The angle between the two zeros is learned, so classical methods are right.
    for method in ("| MUSIC", "| NormMUSIC", "| SRP-PHAT", "| FRIDA"):
        assert float(rows[method].split(" | ")[1]) < 3.0
    assert "2.91" in rows["| NeuralMUSIC"]
    assert "Recordings: SLoClas" in capsys.readouterr().out


def test_a_wrong_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="SoClas"):
        recordings(Study(tmp_path / "runs", "smoke", tmp_path), "sloclas", tmp_path)


def test_every_task_opens_its_data_set(tmp_path: Path) -> None:
    for name, task in TASKS.items():
        dataset = task.open(tmp_path)
        assert {task.train, task.test} <= set(dataset.splits), name

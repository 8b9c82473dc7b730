"""``datasets list`` and ``datasets verify``: what is recognised, printed and returned."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from model_export.__main__ import main
from model_export.datasets.catalogue import DATASETS
from model_export.datasets.fault import Count

pytestmark = pytest.mark.torch

SIGNS = {
    "speech-commands": "validation_list.txt",
    "av163": "seq08-1p-0100/seq08-1p-0100_array1_mic1.wav",
    "sloclas": "SoClas_database/Segmented_Sound/class1/class1_1/a.wav",
    "afpild": "AFPILD_v1/S01/s01_1_footstep_audio.wav",
    "locata": "dev/task1/recording1/eigenmike/audio_array_eigenmike.wav",
}


def printed(capsys: pytest.CaptureFixture[str]) -> Any:
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("name", SIGNS)
def test_a_data_set_is_recognised_and_incomplete(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    sign = tmp_path / SIGNS[name]
    sign.parent.mkdir(parents=True, exist_ok=True)
    sign.touch()
    assert main(["datasets", "verify", str(tmp_path), "--json"]) == 1
    report = printed(capsys)
    assert (report["dataset"], report["complete"]) == (name, False)
    assert {"count", "missing"} & {fault["code"] for fault in report["findings"]}


def test_every_data_set_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["datasets", "list", "--json"]) == 0
    facts = printed(capsys)
    assert [fact["name"] for fact in facts] == list(SIGNS) == list(DATASETS)
    assert all(fact["licence"] and "http" in fact["source"] and fact["layout"] for fact in facts)
    assert main(["datasets", "list"]) == 0
    text = capsys.readouterr().out
    assert all(fact["source"] in text and fact["licence"] in text for fact in facts)


@pytest.mark.parametrize("folder", ["", "absent"])
def test_a_folder_of_something_else_is_not_recognised(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], folder: str
) -> None:
    assert main(["datasets", "verify", str(tmp_path / folder)]) == 2
    assert capsys.readouterr().err.startswith(f"error: {tmp_path / folder} ")
    assert main(["datasets", "verify", str(tmp_path), "--dataset", "sloclas"]) == 1


def test_a_folder_of_two_data_sets_asks_which(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("av163", "afpild"):
        (tmp_path / SIGNS[name]).parent.mkdir(parents=True)
        (tmp_path / SIGNS[name]).touch()
    assert main(["datasets", "verify", str(tmp_path)]) == 2
    assert "looks like av163 and afpild" in capsys.readouterr().err
    assert main(["datasets", "verify", str(tmp_path), "--dataset", "av163", "--json"]) == 1
    assert printed(capsys)["dataset"] == "av163"


def test_what_is_printed_for_people(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    write_wav: Callable[..., None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sequence = tmp_path / "Segmented_Sound" / "class1" / "class1_6"
    for segment in range(12):
        write_wav(sequence / f"{segment:02d}.wav", np.zeros((2, 100)))
    assert main(["datasets", "verify", str(tmp_path)]) == 1
    text = capsys.readouterr().out
    assert text.startswith(f"sloclas in {tmp_path}\n  1 classes, published 10\n")
    assert (
        "\nchannels: 12\n  Segmented_Sound/class1/class1_6/00.wav: has 2 channels, expected 4: "
        in text
    )
    assert "09.wav" in text
    assert "10.wav" not in text
    assert "\n  and 2 more, see --json\n" in text
    assert text.endswith("\nincomplete\n")
    # With smaller published totals the same folder is complete.
    monkeypatch.setattr("model_export.datasets.sloclas.CLASSES", 1)
    monkeypatch.setattr("model_export.datasets.sloclas.DIRECTIONS", 1)
    monkeypatch.setattr("model_export.datasets.sloclas.CHANNELS", 2)
    assert main(["datasets", "verify", str(tmp_path)]) == 0
    assert capsys.readouterr().out.splitlines() == [
        f"sloclas in {tmp_path}",
        "  1 classes, published 1",
        "  1 directions, published 1",
        "  12 segments",
        "complete",
    ]


def test_rounded_totals_are_no_fault() -> None:
    assert Count("footsteps", 61_000, (62_174,), exact=False).complete
    assert str(Count("footsteps", 61_000, (62_174,), exact=False)) == (
        "61,000 footsteps, published about 62,174"
    )
    assert not Count("sessions", 159, (160,)).complete

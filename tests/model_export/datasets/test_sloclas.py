"""SLoClas: the direction in the folder's name, the microphones' order, the split by names."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from model_export.datasets.fault import DatasetError
from model_export.datasets.sloclas import SLoClas
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

pytestmark = pytest.mark.torch

MICROPHONES = 0.0323 * np.array(
    [[np.cos(a), np.sin(a), 0.0] for a in np.deg2rad([135.0, 45.0, 315.0, 225.0])]
)
"""Metres, the square's corners in the recordings' order"""

AddSequence = Callable[..., Path]


@pytest.fixture
def add_sequence(tmp_path: Path, write_wav: Callable[..., None]) -> AddSequence:
    def add(
        degrees: int, kind: int = 1, segments: int = 5, audio: FloatArray | None = None
    ) -> Path:
        root = tmp_path / "SoClas_database" / "Segmented_Sound"
        folder = root / f"class{kind}" / f"class{kind}_{degrees}"
        for segment in range(segments):
            sound = np.full((4, 400), 0.01 * segment) if audio is None else audio
            write_wav(folder / f"segment_{segment:03d}.wav", sound)
        return folder

    return add


def test_the_loudspeaker_is_heard_where_the_folder_says(
    tmp_path: Path,
    add_sequence: AddSequence,
    spherical_waves: Callable[..., FloatArray],
    localize: Callable[[FloatArray, MicrophoneArray], float],
) -> None:
    for degrees in (71, 236):
        azimuth = np.deg2rad(degrees)
        place = 1.5 * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        add_sequence(degrees, segments=1, audio=spherical_waves(MICROPHONES, place))
    items = list(SLoClas(tmp_path).items("test"))
    annotated = [float(np.rad2deg(item.directions.azimuth[0, 0])) for item in items]
    np.testing.assert_allclose(sorted(annotated), [71.0, 236.0])
    heard = [np.rad2deg(localize(item.audio, item.array)) for item in items]
    np.testing.assert_allclose(heard, annotated, atol=1.0)


def test_four_fifths_of_the_sorted_names_train(tmp_path: Path, add_sequence: AddSequence) -> None:
    add_sequence(1, segments=5)
    add_sequence(360, kind=2, segments=10)
    names = {
        split: [Path(item.metadata["path"]).stem[-1] for item in SLoClas(tmp_path).items(split)]
        for split in SLoClas.splits
    }
    assert names == {"train": list("0123") + list("01234567"), "test": list("4") + list("89")}
    item = next(SLoClas(tmp_path / "SoClas_database" / "Segmented_Sound").items("test"))
    assert item.metadata["class"] == "class1"
    assert item.metadata["annotated_deg"] == 1


def test_a_whole_download_has_no_findings(tmp_path: Path, add_sequence: AddSequence) -> None:
    original = add_sequence(1, segments=1)
    for kind, degrees in product(range(1, 11), range(1, 361, 5)):
        copy = original.parents[1] / f"class{kind}" / f"class{kind}_{degrees}"
        if copy != original:
            copy.mkdir(parents=True)
            (copy / "segment_000.wav").hardlink_to(original / "segment_000.wav")
    assert SLoClas.recognises(tmp_path)
    assert SLoClas.verify(tmp_path) == []
    assert [count.found for count in SLoClas.counts(tmp_path)] == [10, 72, 720]


def test_faults_are_found_and_named(
    tmp_path: Path, add_sequence: AddSequence, write_wav: Callable[..., None]
) -> None:
    folder = add_sequence(11, segments=4)
    write_wav(folder / "segment_001.wav", np.zeros((2, 400)))
    (folder / "segment_002.wav").write_bytes(b"not found")
    (folder / "segment_003.wav").write_bytes(b"")
    folder.with_name("class1_400").mkdir()
    write_wav(folder.with_name("class1_400") / "segment_000.wav", np.zeros((4, 400)))
    found = {(f.code, f.path.name): f.detail for f in SLoClas.verify(tmp_path)}
    assert found.keys() == {
        ("count", "Segmented_Sound"),
        ("missing", "class1"),
        ("annotation", "class1_400"),
        ("channels", "segment_001.wav"),
        ("audio", "segment_002.wav"),
        ("audio", "segment_003.wav"),
    }
    assert found["missing", "class1"].startswith("has sounds from 1 of 72 directions")
    assert found["channels", "segment_001.wav"].startswith("has 2 channels, expected 4: ")
    shutil.rmtree(folder)
    with pytest.raises(DatasetError, match="class1_400: the folder's name has no direction"):
        list(SLoClas(tmp_path).items("test"))


def test_a_folder_without_the_audio_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="holds no Segmented_Sound/"):
        next(SLoClas(tmp_path).items("train"))
    assert not SLoClas.recognises(tmp_path)
    assert [fault.code for fault in SLoClas.verify(tmp_path)] == ["missing"]

"""AV16.3: a mouth at a known place is found through the files of either ring, or of both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from model_export.datasets.av163 import ANNOTATED, AV163, Arrays
from model_export.datasets.fault import DatasetError
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

pytestmark = pytest.mark.torch

RING_1 = [
    *((-0.1, 0.4), (-0.07071, 0.32929), (0.0, 0.3), (0.07071, 0.32929)),
    *((0.1, 0.4), (0.07071, 0.47071), (0.0, 0.5), (-0.07071, 0.47071)),
]
"""Metres, as the corpus' own documents list microphones 1 to 8 of the first array"""
RING_2 = [(x, y - 0.8) for x, y in RING_1]
MOUTH = (0.9, -1.6)
SECONDS = 1.2

Localize = Callable[[FloatArray, MicrophoneArray], float]


def mouth_rows(
    *positions: Sequence[float], start: float = 10.0, step: float = 0.04
) -> list[list[float]]:
    """Rows of a .3dmouthgt file: timecode in seconds, a flag, x, y, z."""
    return [[start + step * k, 1, x, y, 0.0] for k, (x, y) in enumerate(positions)]


def write_rows(path: Path, rows: list[list[float]]) -> None:
    path.write_text("".join(" ".join(f"{value:.6f}" for value in row) + "\n" for row in rows))


@pytest.fixture(scope="module")
def recorded(spherical_waves: Callable[..., FloatArray]) -> FloatArray:
    """Audio (16, T) of a mouth in front of both rings."""
    microphones = np.array([(x, y, 0.0) for x, y in RING_1 + RING_2])
    return spherical_waves(microphones, np.array([*MOUTH, 0.0]), seconds=SECONDS)


@pytest.fixture
def add_sequence(
    tmp_path: Path, recorded: FloatArray, write_wav: Callable[..., None]
) -> Callable[..., Path]:
    def add(name: str = "seq08-1p-0100", persons: int = 1) -> Path:
        folder = tmp_path / name
        for index, channel in enumerate(recorded):
            ring, number = divmod(index, 8)
            write_wav(folder / f"{name}_array{ring + 1}_mic{number + 1}.wav", channel)
        for person in range(1, persons + 1):
            rows = mouth_rows(*[MOUTH] * 30)
            write_rows(folder / f"{name}-person{person}-interpolated.3dmouthgt", rows)
        return folder

    return add


@pytest.mark.parametrize(
    ("arrays", "centre", "within"),
    # Both rings together are one metre wide, and the mouth is in their near field.
    [("1", (0.0, 0.4), 1.0), ("2", (0.0, -0.4), 1.0), ("both", (0.0, 0.0), 6.0)],
)
def test_the_mouth_is_heard_where_it_is(
    tmp_path: Path,
    add_sequence: Callable[..., Path],
    localize: Localize,
    arrays: Arrays,
    centre: tuple[float, float],
    within: float,
) -> None:
    add_sequence()
    add_sequence("seq18-2p-0101", persons=2)
    item = next(iter(AV163(tmp_path, arrays).items("test")))
    expected = np.rad2deg(np.arctan2(MOUTH[1] - centre[1], MOUTH[0] - centre[0])) % 360
    windows = list(item.windows(16000, 1600))
    assert len(windows) == 3
    for _, azimuth in windows:
        np.testing.assert_allclose(np.rad2deg(azimuth), [expected], atol=1e-4)
    heard = np.rad2deg(localize(windows[0][0], item.array))
    assert abs((heard - expected + 180) % 360 - 180) < within
    assert item.array.num_microphones == (16 if arrays == "both" else 8)
    assert item.metadata["sequence"] == "seq08-1p-0100"


def test_annotations_are_in_timecode_and_audio_begins_at_ten_seconds(
    tmp_path: Path, add_sequence: Callable[..., Path]
) -> None:
    folder = add_sequence("seq11-1p-0100")
    rows = mouth_rows((1.0, 0.4), (0.0, 1.4), start=10.5)
    write_rows(folder / "seq11-1p-0100-person1-interpolated.3dmouthgt", rows)
    (item,) = AV163(tmp_path, "1").items("train")
    found = np.rad2deg(item.directions.at(np.array([0.49, 0.5, 0.52, 0.54, 0.55]))[:, 0])
    np.testing.assert_allclose(found, [np.nan, 0.0, 45.0, 90.0, np.nan], atol=1e-3)


def test_two_people_are_known_at_their_own_times(
    tmp_path: Path, add_sequence: Callable[..., Path]
) -> None:
    folder = add_sequence("seq19-2p-0101", persons=2)
    path = folder / "seq19-2p-0101-person2-interpolated.3dmouthgt"
    write_rows(path, mouth_rows(*[(0.0, 2.0)] * 5, start=10.4))
    (item,) = AV163(tmp_path, "1").items("train")
    counts = np.isfinite(item.directions.at(np.array([0.2, 0.5, 0.8]))).sum(axis=1)
    assert counts.tolist() == [1, 2, 1]


def test_the_papers_two_sequences_test_and_the_others_train(
    tmp_path: Path, add_sequence: Callable[..., Path]
) -> None:
    for name, persons in (("seq08-1p-0100", 1), ("seq18-2p-0101", 2), ("seq01-1p-0000", 1)):
        add_sequence(name, persons)
    splits = {
        split: [item.metadata["sequence"] for item in AV163(tmp_path, "1").items(split)]
        for split in AV163.splits
    }
    assert splits == {"train": ["seq01-1p-0000"], "test": ["seq08-1p-0100", "seq18-2p-0101"]}
    with pytest.raises(ValueError, match="choose train or test"):
        next(AV163(tmp_path).items("dev"))


def test_audio_is_read_when_its_item_is_reached(
    tmp_path: Path, add_sequence: Callable[..., Path]
) -> None:
    add_sequence("seq01-1p-0000")
    broken = add_sequence("seq02-1p-0000") / "seq02-1p-0000_array1_mic3.wav"
    broken.write_bytes(broken.read_bytes()[:2000])
    items = AV163(tmp_path, "1").items("train")
    assert next(items).metadata["sequence"] == "seq01-1p-0000"
    with pytest.raises(DatasetError, match=r"mic3\.wav: the WAV header promises"):
        next(items)


def test_a_whole_download_has_no_findings(
    tmp_path: Path, add_sequence: Callable[..., Path]
) -> None:
    for name in ANNOTATED:
        add_sequence(name, persons=int(name[6]))
    assert AV163.recognises(tmp_path)
    assert AV163.verify(tmp_path) == []


def test_faults_are_found_and_named(
    tmp_path: Path, add_sequence: Callable[..., Path], write_wav: Callable[..., None]
) -> None:
    folder = add_sequence()
    (folder / "seq08-1p-0100_array2_mic5.wav").unlink()
    write_wav(folder / "seq08-1p-0100_array1_mic2.wav", np.zeros((2, 16000), np.float32))
    write_wav(folder / "seq08-1p-0100_array1_mic3.wav", np.zeros(16000, np.float32), 8000)
    mouth = folder / "seq08-1p-0100-person1-interpolated.3dmouthgt"
    mouth.write_text(mouth.read_text() + "11.2 1 0.5 oops 0\n")
    inside = {
        (fault.code, fault.path.name): fault.detail
        for fault in AV163.verify(tmp_path)
        if fault.path.parent == folder
    }
    assert {key: detail.split(",")[0] for key, detail in inside.items()} == {
        ("missing", "seq08-1p-0100_array2_mic5.wav"): (
            "is missing: unpack or download the file again"
        ),
        ("channels", "seq08-1p-0100_array1_mic2.wav"): "has 2 channels",
        ("sample_rate", "seq08-1p-0100_array1_mic3.wav"): "has 8000 Hz",
        ("annotation", mouth.name): "line 31 column 4 is 'oops'",
    }
    missing = [f.path.name for f in AV163.verify(tmp_path) if f.path.parent == tmp_path]
    assert missing == [name for name in ANNOTATED if name != folder.name]


def test_a_channel_that_was_cut_off_is_named(
    tmp_path: Path, add_sequence: Callable[..., Path], write_wav: Callable[..., None]
) -> None:
    folder = add_sequence("seq01-1p-0000")
    write_wav(folder / "seq01-1p-0000_array1_mic2.wav", np.zeros(8000, np.float32))
    with pytest.raises(DatasetError, match=r"mic2\.wav: lasts 0\.50 s, another microphone 1\.20 s"):
        list(AV163(tmp_path, "1").items("train"))


def test_another_sequences_annotation_is_refused(
    tmp_path: Path, add_sequence: Callable[..., Path]
) -> None:
    folder = add_sequence("seq01-1p-0000")
    path = folder / "seq01-1p-0000-person1-interpolated.3dmouthgt"
    write_rows(path, mouth_rows(MOUTH, MOUTH, start=60.0))
    with pytest.raises(DatasetError, match=r"outside the audio, 10 to 11\.2 s"):
        list(AV163(tmp_path, "1").items("train"))
    assert [f.path for f in AV163.verify(tmp_path) if f.code == "annotation"] == [path]


def test_a_missing_test_sequence_is_an_error(
    tmp_path: Path, add_sequence: Callable[..., Path]
) -> None:
    add_sequence("seq01-1p-0000")
    with pytest.raises(DatasetError, match="seq08-1p-0100: is missing: download this sequence"):
        next(AV163(tmp_path).items("test"))

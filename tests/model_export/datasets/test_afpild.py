"""AFPILD: footsteps between two boundaries, the splits by session, an offset that is learned."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice, product
from pathlib import Path

import numpy as np
import pytest

from model_export.datasets.afpild import AFPILD, Variant
from model_export.datasets.fault import DatasetError
from model_export.datasets.offset import learn_offset
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

pytestmark = pytest.mark.torch

MICROPHONES = 0.0323 * np.array(
    [[np.cos(a), np.sin(a), 0.0] for a in np.deg2rad([45.0, 135.0, 225.0, 315.0])]
)
"""Metres, as the NeuralMUSIC paper's code assumes"""
ROWS = 14
"""Rows of an annotation, of which steps 5 to 10 are used"""
STEP = 800

AddSession = Callable[..., Path]


@pytest.fixture
def add_session(tmp_path: Path, write_wav: Callable[..., None]) -> AddSession:
    """Every sample's value is the number of its step, in hundredths."""

    def add(subject: int, session: int, rows: int = ROWS, audio: FloatArray | None = None) -> Path:
        stem = f"s{subject:02d}_{session}_footstep"
        folder = tmp_path / "AFPILD_v1" / f"S{subject:02d}"
        steps = np.repeat(np.arange(rows), STEP) / 100
        write_wav(folder / f"{stem}_audio.wav", np.tile(steps, (4, 1)) if audio is None else audio)
        lines = [
            f"{STEP * k},{np.cos(np.deg2rad(10 * k)):.6f},{np.sin(np.deg2rad(10 * k)):.6f}"
            for k in range(rows)
        ]
        table = folder / f"{stem}_annotation.csv"
        table.write_text("\n".join(["sample_loc,loc_x,loc_y", *lines]) + "\n")
        return table

    return add


def test_a_footstep_is_what_lies_between_its_boundary_and_the_next(
    tmp_path: Path, add_session: AddSession
) -> None:
    add_session(7, 1)
    add_session(7, 4)
    items = list(AFPILD(tmp_path).items("train"))[:6]
    # Step 5 is the first that is used, and the last three rows are not.
    assert [item.metadata["event"] for item in items] == [5, 6, 7, 8, 9, 10]
    for item in items:
        event = item.metadata["event"]
        np.testing.assert_allclose(item.audio, np.full((4, STEP), event / 100), atol=1e-4)
        assert np.rad2deg(item.directions.azimuth[0, 0]) == pytest.approx(10 * event, abs=1e-3)
    assert items[0].metadata["speaker"] == "S07"


def test_more_audio_around_a_footstep(tmp_path: Path, add_session: AddSession) -> None:
    add_session(1, 2)
    add_session(1, 3)
    first, *_, last = AFPILD(tmp_path, seconds=0.5).items("test")
    assert first.audio.shape == last.audio.shape == (4, 8000)
    # Half a second about the middle of step 5, at sample 4400; step 10's would pass the end.
    np.testing.assert_allclose(first.audio[0, [0, 3999, 7999]], [0.0, 0.05, 0.1], atol=6e-3)
    np.testing.assert_allclose(last.audio[0, -1], 0.13, atol=1e-4)


@pytest.mark.parametrize(
    ("variant", "train", "test"), [("cloth", {1, 4}, {2, 3}), ("shoe", {1, 2}, {3, 4})]
)
def test_sessions_make_the_splits(
    tmp_path: Path, add_session: AddSession, variant: Variant, train: set[int], test: set[int]
) -> None:
    for session in range(1, 5):
        add_session(1, session)
    dataset = AFPILD(tmp_path, variant)
    assert {item.metadata["session"] for item in dataset.items("train")} == train
    assert {item.metadata["session"] for item in dataset.items("test")} == test


def test_random_halves_are_always_the_same_and_share_nothing(
    tmp_path: Path, add_session: AddSession
) -> None:
    for session in range(1, 5):
        add_session(1, session, rows=48)
    train, again, test = (
        [item.metadata["event"] for item in islice(AFPILD(tmp_path, "rd").items(split), 20)]
        for split in ("train", "train", "test")
    )
    assert train == again
    assert len(train) == len(test) == 20
    assert sorted(train + test) == list(range(5, 45))


def test_the_rooms_frame_is_learned_from_training_footsteps(
    tmp_path: Path,
    add_session: AddSession,
    spherical_waves: Callable[..., FloatArray],
    localize: Callable[[FloatArray, MicrophoneArray], float],
) -> None:
    turn = 65.0
    rows, length = 14, 6400
    audio = np.zeros((4, rows * length), np.float32)
    for step in range(5, 11):
        azimuth = np.deg2rad(10 * step + turn)
        place = 2 * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        heard = spherical_waves(MICROPHONES, place, seconds=length / 16000)
        audio[:, step * length : (step + 1) * length] = heard
    for session in (1, 4):
        table = add_session(1, session, audio=audio)
        lines = table.read_text().splitlines()
        lines[1:] = [f"{k * length},{line.split(',', 1)[1]}" for k, line in enumerate(lines[1:])]
        table.write_text("\n".join(lines) + "\n")
    offset = learn_offset(AFPILD(tmp_path).items("train"), localize)
    assert np.rad2deg(offset) == pytest.approx(turn, abs=1.0)


def test_a_whole_download_has_no_findings(tmp_path: Path, add_session: AddSession) -> None:
    for subject, session in product(range(1, 41), range(1, 5)):
        add_session(subject, session)
    assert AFPILD.recognises(tmp_path)
    assert AFPILD.recognises(tmp_path / "AFPILD_v1")
    assert AFPILD.verify(tmp_path) == []
    assert [count.found for count in AFPILD.counts(tmp_path)] == [160, 960]


def test_faults_are_found_and_named(
    tmp_path: Path, add_session: AddSession, write_wav: Callable[..., None]
) -> None:
    tables = {session: add_session(1, session) for session in (1, 2, 3, 4)}
    add_session(2, 1, rows=8)
    tables[1].write_text(tables[1].read_text().replace("0.642788", "half"))
    tables[2].unlink()
    write_wav(tables[3].with_name("s01_3_footstep_audio.wav"), np.zeros((6, 20 * STEP)))
    write_wav(tables[4].with_name("s01_4_footstep_audio.wav"), np.zeros((4, 6 * STEP)))
    found = {
        fault.path.name: (fault.code, fault.detail)
        for fault in AFPILD.verify(tmp_path)
        if fault.path.name.startswith(("s01", "s02_1"))
    }
    assert {name: code for name, (code, _) in found.items()} == {
        "s01_1_footstep_annotation.csv": "annotation",
        "s01_2_footstep_annotation.csv": "missing",
        "s01_3_footstep_audio.wav": "channels",
        "s01_4_footstep_audio.wav": "audio",
        "s02_1_footstep_annotation.csv": "annotation",
    }
    assert "line 6 column 3 is 'half'" in found["s01_1_footstep_annotation.csv"][1]
    assert "annotated until 0.6 s" in found["s01_4_footstep_audio.wav"][1]
    assert "has 8 rows" in found["s02_1_footstep_annotation.csv"][1]
    with pytest.raises(DatasetError, match="column 3 is 'half'"):
        next(AFPILD(tmp_path).items("train"))


def test_boundaries_that_do_not_ascend_are_refused(tmp_path: Path, add_session: AddSession) -> None:
    table = add_session(1, 1)
    table.write_text(table.read_text().replace(f"{7 * STEP},", f"{6 * STEP},"))
    with pytest.raises(DatasetError, match="sample_loc does not ascend"):
        next(AFPILD(tmp_path).items("train"))

"""Speech Commands in rooms: who is in which split, what a scene holds, what a download lacks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import soundfile

from model_export.datasets.fault import DatasetError
from model_export.datasets.speech_commands_rooms import SpeechCommandsRooms
from model_export.simulation.protocol import SceneProtocol
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

pytestmark = pytest.mark.torch

ANECHOIC = SceneProtocol(orders=(0, 0))


def test_a_word_is_heard_from_where_the_scene_puts_it(
    corpus: Path, localize: Callable[[FloatArray, MicrophoneArray], float]
) -> None:
    items = list(SpeechCommandsRooms(corpus, protocol=ANECHOIC, scenes=3).items("train"))
    truth = np.array([np.rad2deg(item.directions.azimuth[0, 0]) for item in items])
    heard = np.array([np.rad2deg(localize(item.audio, item.array)) for item in items])
    np.testing.assert_allclose((heard - truth + 180) % 360 - 180, 0.0, atol=2.0)
    assert len({*truth.round(3).tolist()}) == 3


def test_no_speaker_is_in_two_splits_and_a_scene_is_always_the_same(corpus: Path) -> None:
    dataset = SpeechCommandsRooms(corpus, protocol=ANECHOIC, scenes=6)
    speakers = {
        split: {speaker for item in dataset.items(split) for speaker in item.metadata["speaker"]}
        for split in ("train", "test")
    }
    assert not speakers["train"] & speakers["test"]
    listed = (corpus / "validation_list.txt").read_text()
    assert all(speaker in listed for speaker in speakers["test"])
    first, again = next(dataset.items("train")), next(dataset.items("train"))
    np.testing.assert_array_equal(first.audio, again.audio)


def test_two_talkers_are_at_least_ten_degrees_apart(corpus: Path) -> None:
    protocol = SceneProtocol(num_sources=2, orders=(0, 0))
    items = list(SpeechCommandsRooms(corpus, protocol=protocol, scenes=5).items("train"))
    apart = [np.ptp(np.rad2deg(item.directions.azimuth[0])) for item in items]
    assert all(10 <= gap <= 350 for gap in apart)
    assert all(len(item.metadata["path"]) == 2 for item in items)


def test_silent_clips_are_passed_over(tmp_path: Path) -> None:
    (tmp_path / "yes").mkdir()
    rng = np.random.default_rng(0)
    for speaker, level in (("00000000", 0.0), ("00000001", 0.1)):
        sound = level * rng.standard_normal(8000)
        soundfile.write(tmp_path / "yes" / f"{speaker}_nohash_0.wav", sound, 16000)
    listed = "yes/00000000_nohash_0.wav\nyes/00000001_nohash_0.wav\n"
    (tmp_path / "testing_list.txt").write_text(listed)
    items = SpeechCommandsRooms(tmp_path, protocol=ANECHOIC, scenes=6).items("test")
    assert [item.metadata["speaker"] for item in items] == [["00000001"]] * 6
    sounding = tmp_path / "yes" / "00000001_nohash_0.wav"
    soundfile.write(sounding, np.zeros(8000), 16000)
    with pytest.raises(DatasetError, match="is silent, as are all other clips"):
        next(SpeechCommandsRooms(tmp_path, protocol=ANECHOIC).items("test"))


def test_a_part_of_the_corpus_is_said_to_be_one(tmp_path: Path) -> None:
    (tmp_path / "yes").mkdir()
    (tmp_path / "_background_noise_").mkdir()
    soundfile.write(tmp_path / "yes" / "00000000_nohash_0.wav", np.zeros((8000, 2)), 16000)
    soundfile.write(tmp_path / "yes" / "00000001_nohash_0.wav", np.zeros(8000), 8000)
    soundfile.write(tmp_path / "_background_noise_" / "x_nohash_0.wav", np.zeros(8), 16000)
    (tmp_path / "validation_list.txt").write_text("yes/00000002_nohash_0.wav\n")
    found = [(f.code, f.path.name) for f in SpeechCommandsRooms.verify(tmp_path)]
    assert found == [
        ("count", tmp_path.name),
        ("count", tmp_path.name),
        ("missing", "00000002_nohash_0.wav"),
        ("missing", "testing_list.txt"),
        ("channels", "00000000_nohash_0.wav"),
        ("sample_rate", "00000001_nohash_0.wav"),
    ]
    assert [str(count) for count in SpeechCommandsRooms.counts(tmp_path)] == [
        "2 clips, published 64,727 or 105,829",
        "1 words, published 30 or 35",
    ]

"""Simulated scenes against physics: delays, powers, coherence; and splits by speaker."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from model_export.datasets.speech import load, speech_commands
from model_export.simulation.arrays import TEST_ARRAYS, named_array, random_array
from model_export.simulation.noise import unit_power
from model_export.simulation.protocol import SceneProtocol, simulate_scene, write_scenes
from model_export.simulation.room_bank import RoomBank, RoomChunk
from model_export.simulation.rooms import (
    PAPER_ARRAY_CENTRE,
    PAPER_ROOM_SIZE,
    SAMPLE_RATE,
    RoomSpec,
    diffuse_noise,
    impulse_responses,
    paper_room,
    random_room,
)
from model_export.simulation.running_speech import running_speech
from model_export.simulation.scene_config import SceneConfig
from model_export.simulation.scenes import (
    WINDOW_SAMPLES,
    convolve,
    convolve_window,
    draw_scene,
)
from model_export.simulation.synthesis import synthetic_voice
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.scoring import circular_error
from service.doa.steering import unit_vectors
from service.inference.classical import ClassicalLocalizer

ANECHOIC = RoomSpec((8.0, 8.0, 4.0), (4.0, 4.0, 2.0), rt60=0.0)


@pytest.fixture(scope="module")
def voices() -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [synthetic_voice(rng, 1.0) for _ in range(6)]


@pytest.mark.parametrize("azimuth_deg", [0.0, 70.0, 200.0])
def test_a_wave_reaches_the_nearer_microphone_first_and_by_the_right_time(
    azimuth_deg: float,
) -> None:
    array = MicrophoneArray("wide", np.array([[0.5, 0, 0], [-0.5, 0, 0], [0, 0.5, 0]]))
    source = 3.0 * unit_vectors(np.deg2rad(np.array([azimuth_deg])))
    (responses,) = impulse_responses(ANECHOIC, array.positions, source)
    spectra = np.fft.rfft(responses, 4096)
    lag = np.fft.irfft(spectra[1] * np.conj(spectra[0]), 16 * 4096).argmax() / 16
    lag = (lag + 2048) % 4096 - 2048
    distances = np.linalg.norm(source - array.positions, axis=1)
    expected = (distances[1] - distances[0]) / 343.0 * SAMPLE_RATE
    assert lag == pytest.approx(expected, abs=0.15)


def test_every_source_has_unit_power_and_the_noise_has_its_level(voices) -> None:
    quiet = simulate_scene(SceneProtocol(num_sources=2, snr_db=200.0), voices, [1, 2])
    noisy = simulate_scene(SceneProtocol(num_sources=2, snr_db=10.0), voices, [1, 2])
    np.testing.assert_allclose(quiet.azimuth, noisy.azimuth)
    # The whole utterance with its tail has unit power; the window may cut off the tail.
    assert np.var(quiet.audio[0]) == pytest.approx(2.0, rel=0.35)
    noise = noisy.audio - quiet.audio
    assert np.var(noise) == pytest.approx(2 * 10 ** (-10 / 10), rel=0.05)
    assert np.corrcoef(noise)[0, 1] == pytest.approx(0, abs=0.05)


def test_the_same_seed_gives_the_same_scene(voices) -> None:
    first, again, other = (simulate_scene(SceneProtocol(), voices, [3, s]) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.audio, again.audio)
    assert first.metadata == again.metadata
    assert not np.array_equal(first.audio, other.audio)


def test_sources_keep_their_distance_from_each_other(voices) -> None:
    for seed in range(20):
        scene = simulate_scene(
            SceneProtocol(num_sources=3, min_separation_deg=40), voices, [4, seed]
        )
        gaps = circular_error(scene.azimuth[:, None], scene.azimuth[None])
        assert np.rad2deg(gaps[np.triu_indices(3, 1)].min()) >= 40
    pair = simulate_scene(SceneProtocol(num_sources=2, separation_deg=30.0), voices, [4, 99])
    assert np.rad2deg(circular_error(*pair.azimuth)) == pytest.approx(30)


def test_talkers_above_and_below_are_where_the_scene_says(voices) -> None:
    protocol = SceneProtocol(
        array="tetrahedron 50 mm",
        num_sources=2,
        orders=(0, 0),
        snr_db=200.0,
        elevations_deg=(-60, 80),
        min_separation_deg=60,
    )
    scene = simulate_scene(protocol, voices, [8, 1])
    level = np.cos(scene.elevation)
    towards = np.stack(
        [level * np.cos(scene.azimuth), level * np.sin(scene.azimuth), np.sin(scene.elevation)]
    )
    assert towards[:, 0] @ towards[:, 1] <= np.cos(np.deg2rad(60))
    assert np.abs(np.rad2deg(scene.elevation)).max() > 10
    alone = simulate_scene(replace(protocol, num_sources=1), voices, [8, 2])
    (found,) = ClassicalLocalizer("norm_music", alone.array).estimate(alone.audio[None], 1, 1)
    (source,) = found.sources
    assert source.elevation == pytest.approx(alone.elevation[0], abs=0.1)
    assert math.cos(source.azimuth - alone.azimuth[0]) > 0.98


def test_continuous_talkers_leave_no_pause(voices) -> None:
    padded = [np.concatenate([np.zeros(6000, np.float32), v[:6000], 1e-4 * v]) for v in voices]
    dry = running_speech(np.random.default_rng(0), padded[0], 40000)
    assert dry.shape == (40000,)
    frames = np.square(dry.reshape(-1, 400)).mean(axis=1)
    quiet = "".join("x" if frame < 1e-6 else " " for frame in frames).split()
    assert max(map(len, quiet), default=0) * 400 < 6000  # the clip's own silence is 22000 long
    protocol = SceneProtocol(snr_db=200.0, continuous=True, num_samples=8000, room=ANECHOIC)
    powers = []
    for seed in range(12):
        scene = simulate_scene(protocol, padded, [6, seed])
        assert scene.audio.shape == (4, 8000)
        powers.append(np.var(scene.audio[0]))
    # A second of speech has unit power; half a second of it may be a little louder or quieter.
    assert np.mean(powers) == pytest.approx(1, rel=0.3)


def test_a_window_in_which_the_talker_pauses_is_not_voiced() -> None:
    rng = np.random.default_rng(0)
    word = np.concatenate([rng.standard_normal(8000), np.zeros(40000), rng.standard_normal(8000)])
    protocol = SceneProtocol(continuous=True, num_samples=8000, room=ANECHOIC)
    scenes = [simulate_scene(protocol, [word.astype(np.float32)], [7, s]) for s in range(20)]
    assert {scene.voiced for scene in scenes} == {True, False}
    for scene in scenes:
        loud = np.var(scene.audio[0]) > 0.4  # the noise alone has a variance of 0.001
        assert scene.voiced or not loud


def test_the_test_arrays_are_what_they_are_called() -> None:
    for name, array in TEST_ARRAYS.items():
        assert named_array(name) is array
        assert str(array.num_microphones) in name
        radius = np.linalg.norm(array.positions - array.positions.mean(axis=0), axis=1)
        if "ring" in name:
            np.testing.assert_allclose(1000 * radius, float(name.split()[-2]))
        else:
            assert np.ptp(radius) > 0.01
    assert named_array("matrix-voice") is preset("matrix-voice")


def test_written_scenes_have_their_truth_beside_them(voices, tmp_path: Path) -> None:
    write_scenes(tmp_path, SceneProtocol(num_sources=2), voices, count=2, seed=5)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        f"scene_0000{i}.{suffix}" for i in range(2) for suffix in ("json", "wav")
    ]
    truth = json.loads((tmp_path / "scene_00001.json").read_text())
    scene = simulate_scene(SceneProtocol(num_sources=2), voices, [5, 1])
    np.testing.assert_allclose(truth["azimuth_deg"], np.rad2deg(scene.azimuth), atol=1e-3)
    assert truth["room"]["max_order"] == 4
    assert len(truth["array"]["positions_m"]) == 4


def test_diffuse_noise_has_the_coherence_of_an_isotropic_field() -> None:
    """sin(k d) / (k d) between two microphones, averaged over many fields."""
    positions = np.array([[0.05, 0.0, 0.0], [-0.05, 0.0, 0.0]])
    rng = np.random.default_rng(6)
    cross, power = 0.0, 0.0
    for _ in range(40):
        spectra = np.fft.rfft(diffuse_noise(rng, positions, 2048), axis=-1)
        cross = cross + spectra[0] * np.conj(spectra[1])
        power = power + np.abs(spectra) ** 2
    coherence = (cross / np.sqrt(power[0] * power[1])).real.reshape(-1)[:1024]
    smooth = coherence.reshape(16, 64).mean(axis=1)
    frequency = np.fft.rfftfreq(2048, 1 / SAMPLE_RATE)[:1024].reshape(16, 64).mean(axis=1)
    expected = np.sinc(2 * frequency * 0.1 / 343.0)
    np.testing.assert_allclose(smooth, expected, atol=0.08)


def test_random_arrays_and_rooms_are_valid() -> None:
    rng = np.random.default_rng(7)
    for microphones in (3, 4, 6, 8) * 10:
        array = random_array(rng, microphones)
        assert array.num_microphones == microphones
        # A ring of three with a diameter of 3 cm is 2.6 cm across.
        assert 0.0259 <= array.aperture <= 0.2001
        assert not array.linear
        room = random_room(rng)
        assert (room.max_order is None) != (room.rt60 is None)
        assert all(0.3 < c < side - 0.3 for c, side in zip(room.centre, room.size, strict=True))


def test_convolution_does_not_wrap_round() -> None:
    dry, response = np.zeros(100, np.float32), np.zeros((1, 50), np.float32)
    dry[99], response[0, 49] = 1.0, 1.0
    wet = convolve(dry, response)
    assert wet.shape[-1] >= 149
    assert wet[0].argmax() == 148


@pytest.mark.parametrize("start", [0, 100, 3000])
def test_a_convolved_window_is_that_of_the_whole_convolution(start: int) -> None:
    rng = np.random.default_rng(4)
    dry = rng.standard_normal(WINDOW_SAMPLES + 3000).astype(np.float32)
    responses = rng.standard_normal((2, 1000)).astype(np.float32)
    whole = np.stack([np.convolve(dry, each) for each in responses])
    np.testing.assert_allclose(
        convolve_window(dry, responses, start),
        whole[:, start : start + WINDOW_SAMPLES],
        atol=1e-3,
    )


def test_the_paper_s_room_is_the_paper_s() -> None:
    room = paper_room(4)
    assert (room.size, room.centre, room.max_order) == ((7, 7, 3), (3, 3, 1), 4)


PLACES = np.deg2rad([20.0, 120.0, 250.0, 255.0])


@pytest.fixture(scope="module")
def chunk() -> RoomChunk:
    """One room with four source positions."""
    array = preset("respeaker-usb-4mic-v2")
    sources = 1.5 * unit_vectors(PLACES)
    rng = np.random.default_rng(8)
    return RoomChunk(
        responses=impulse_responses(paper_room(1), array.positions, sources)[None],
        positions=array.positions[None],
        azimuth=PLACES[None],
        elevation=np.zeros((1, 4)),
        distance=np.full((1, 4), 1.5),
        diffuse=diffuse_noise(rng, array.positions, WINDOW_SAMPLES)[None],
        room=np.array([[*PAPER_ROOM_SIZE, *PAPER_ARRAY_CENTRE, 1, 0.0]]),
    )


def test_talkers_that_come_late_begin_inside_the_window_and_are_heard(voices, chunk) -> None:
    rng = np.random.default_rng(9)
    config = SceneConfig(source_counts=(0.0, 0.6, 0.4), late=1.0)
    begins = []
    for _ in range(30):
        scene = draw_scene(rng, chunk, voices, config)
        power = np.square(scene.direct).mean(axis=1)
        assert power.min() > 0.1 * power.max() > 0
        loud = np.square(scene.direct) > 1e-3 * np.square(scene.direct).max(axis=1, keepdims=True)
        begins += list(loud.argmax(axis=1) / WINDOW_SAMPLES)
    assert 0.25 < min(begins) < 0.5
    assert 0.8 < max(begins) < 1.0


def test_training_scenes_hold_what_they_say(voices, chunk) -> None:
    rng = np.random.default_rng(8)
    counts = []
    for _ in range(60):
        scene = draw_scene(rng, chunk, voices, SceneConfig(source_counts=(0.3, 0.3, 0.3, 0.1)))
        assert scene.audio.shape == (4, WINDOW_SAMPLES)
        assert np.isfinite(scene.audio).all()
        assert scene.direct.shape == (len(scene.azimuth), WINDOW_SAMPLES)
        assert set(np.round(scene.azimuth, 6)) <= set(np.round(PLACES, 6))
        counts.append(len(scene.azimuth))
        if len(scene.azimuth) > 1:  # two of the sources are too close to sound together
            gaps = circular_error(scene.azimuth[:, None], scene.azimuth[None])
            assert gaps[np.triu_indices(len(scene.azimuth), 1)].min() > np.deg2rad(12)
    assert set(counts) == {0, 1, 2, 3}


def test_unit_power_is_of_the_first_microphone() -> None:
    audio = np.random.default_rng(9).standard_normal((2, 1000)).astype(np.float32) * [[3], [5]]
    assert np.mean(unit_power(audio)[0] ** 2) == pytest.approx(1)


def test_no_speaker_is_in_two_splits(corpus: Path) -> None:
    splits = {s: speech_commands(corpus, s) for s in ("train", "development", "heldout")}
    speakers = [{clip.speaker for clip in clips} for clips in splits.values()]
    assert sum(map(len, speakers)) == len(set.union(*speakers)) == 40
    assert len(speakers[2]) == 4
    assert all(np.abs(audio).max() == pytest.approx(1) for audio in load(splits["heldout"]))


def test_background_noise_is_no_speaker(corpus: Path, tmp_path: Path) -> None:
    (tmp_path / "_background_noise_").mkdir()
    (tmp_path / "_background_noise_" / "x_nohash_0.wav").write_bytes(b"")
    (tmp_path / "validation_list.txt").write_text("yes/x_nohash_0.wav\n")
    with pytest.raises(FileNotFoundError, match="heldout clips"):
        speech_commands(tmp_path, "heldout")


def test_an_empty_room_bank_is_explained(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="model_export rooms"):
        RoomBank(tmp_path)

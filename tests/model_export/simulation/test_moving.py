"""Walking talkers sound as physics demands, and come from their true directions."""

from __future__ import annotations

import numpy as np
import pyroomacoustics as pra
import pytest

from model_export.simulation.moving import Arc, Talker, convolve_moving, simulate_moving, walk
from model_export.simulation.rooms import RESPONSE_SAMPLES, RoomSpec
from model_export.simulation.synthesis import synthetic_voice
from service.doa.presets import preset
from service.doa.scoring import circular_error
from service.doa.steering import unit_vectors
from service.doa.stft import Stft
from service.doa.types import FloatArray

RATE = 16000
SQUARE = preset("respeaker-usb-4mic-v2")
ROOM = RoomSpec((5.0, 4.0, 2.8), (2.2, 1.8, 1.1), rt60=0.2)


def voice(seconds: float) -> FloatArray:
    return synthetic_voice(np.random.default_rng(1), seconds)


def test_who_stands_still_sounds_as_in_a_static_simulation() -> None:
    speech = voice(0.5)
    centre = np.asarray(ROOM.centre)
    absorption, order = pra.inverse_sabine(ROOM.rt60, ROOM.size)
    room = pra.ShoeBox(
        ROOM.size, fs=RATE, materials=pra.Material(absorption), max_order=min(order, 45)
    )
    room.add_microphone_array((SQUARE.positions + centre).T)
    room.add_source(1.5 * unit_vectors(np.array(0.7)) + centre, signal=speech)
    room.simulate()
    expected = room.mic_array.signals[:, : len(speech)]
    # The tail that is cut after half a second is 60 dB down in this room.
    assert RESPONSE_SAMPLES > 2 * 0.2 * RATE
    found = walk(ROOM, SQUARE, Talker(Arc(0.7), speech))
    assert np.abs(found - expected).max() < 1e-3 * np.abs(expected).max()


def test_equal_responses_fade_into_each_other_without_a_trace() -> None:
    rng = np.random.default_rng(2)
    dry, response = rng.standard_normal(2000), rng.standard_normal((2, 50))
    knots = np.array([0.0, 333.3, 1200.0, 1500.5])
    found = convolve_moving(dry, np.repeat(response[None], 4, axis=0), knots)
    for microphone in range(2):
        expected = np.convolve(dry, response[microphone])[:2000]
        np.testing.assert_allclose(found[microphone], expected, atol=1e-4)


def test_each_response_holds_alone_at_its_knot_and_half_between_two() -> None:
    responses = np.array([[[1.0]], [[3.0]], [[7.0]]])
    found = convolve_moving(np.ones(301), responses, np.array([0.0, 100.0, 300.0]))
    np.testing.assert_allclose(found[0, [0, 50, 100, 200, 300]], [1, 2, 3, 5, 7], rtol=1e-5)


def test_a_walk_has_no_clicks() -> None:
    """A tone stays a tone: fading spreads its power no farther than the Doppler shift."""
    tone = np.sin(2 * np.pi * 1000 * np.arange(RATE) / RATE)
    anechoic = RoomSpec(ROOM.size, ROOM.centre, rt60=0.0)
    found = walk(anechoic, SQUARE, Talker(Arc(0.3, np.deg2rad(40)), tone))[0, 1000:]
    power = np.abs(np.fft.rfft(found * np.hanning(len(found)))) ** 2
    frequency = np.fft.rfftfreq(len(found), 1 / RATE)
    assert power[np.abs(frequency - 1000) > 30].sum() < 1e-4 * power.sum()


@pytest.mark.parametrize("velocity_deg", [-30.0, 25.0])
def test_the_sound_comes_from_where_the_talker_is(velocity_deg: float) -> None:
    """NormMUSIC's estimate in windows of 0.2 s is the true azimuth in their middle."""
    rng = np.random.default_rng(3)
    talker = Talker(Arc(1.0, np.deg2rad(velocity_deg)), rng.standard_normal(2 * RATE))
    scene = simulate_moving(rng, ROOM, SQUARE, [talker], snr_db=20.0)
    stft = Stft()
    method = pra.doa.algorithms["NormMUSIC"](
        SQUARE.positions.T, RATE, stft.n_fft, n_grid=360, dim=2
    )
    length = RATE // 5
    for begin in range(0, 2 * RATE - length + 1, RATE // 2):
        method.locate_sources(
            stft.transform(scene.audio[:, begin : begin + length]), freq_range=[300, 3500]
        )
        truth = scene.azimuths((begin + length / 2) / RATE)
        assert circular_error(method.azimuth_recon[:1], truth)[0] < np.deg2rad(6)


def test_talkers_are_as_loud_as_each_other_and_the_noise_as_the_snr_says() -> None:
    speech = np.random.default_rng(4).standard_normal(RATE)
    quiet = np.concatenate([np.zeros(RATE), 1e-3 * speech])
    talkers = [Talker(Arc(0.0), np.pad(5 * speech, (0, RATE))), Talker(Arc(2.0), quiet)]
    scene = simulate_moving(np.random.default_rng(5), ROOM, SQUARE, talkers, snr_db=40.0)
    first, second = scene.audio[0, 4000:RATE], scene.audio[0, RATE + 4000 :]
    assert 10 * np.log10(np.mean(first**2) / np.mean(second**2)) == pytest.approx(0, abs=0.5)
    alone = simulate_moving(
        np.random.default_rng(5), ROOM, SQUARE, [Talker(Arc(0.0), quiet)], snr_db=20.0
    )
    assert 10 * np.log10(np.mean(alone.audio[:, : RATE - 100] ** 2)) == pytest.approx(-20, abs=0.3)


def test_who_is_voiced_when() -> None:
    speech = np.concatenate([np.zeros(RATE), voice(1.0), np.zeros(RATE)])
    talker = Talker(Arc(0.0), speech)
    heard = [talker.voiced(time, 0.5) for time in (0.9, 1.6, 2.9)]
    assert heard == [False, True, False]

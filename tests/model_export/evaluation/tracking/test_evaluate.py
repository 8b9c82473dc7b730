"""Streams become scores, and scores the document."""

from __future__ import annotations

import numpy as np
import pytest

from model_export.evaluation.tracking.evaluate import (
    Stream,
    embedded_estimates,
    follow,
    tally_streams,
    untracked,
)
from model_export.evaluation.tracking.report import bars, document
from model_export.evaluation.tracking.scenes import CELLS, LEAD_S
from model_export.evaluation.tracking.scores import Tally
from model_export.simulation.moving import Arc, MovingScene, Talker
from model_export.simulation.synthesis import synthetic_voice
from service.doa.array import SPEED_OF_SOUND
from service.doa.presets import preset
from service.doa.steering import unit_vectors
from service.doa.tracking import Detection
from service.doa.types import FloatArray

RATE = 16000


def plane_wave(azimuth: float, signal: FloatArray) -> FloatArray:
    """Microphone signals (N, T) of a plane wave (T,)."""
    positions = preset("respeaker-usb-4mic-v2").positions
    advance = positions @ unit_vectors(np.array(azimuth)) / SPEED_OF_SOUND
    omega = 2 * np.pi * np.fft.rfftfreq(len(signal), 1 / RATE)
    spectrum = np.fft.rfft(signal) * np.exp(1j * omega * advance[:, None])
    return np.fft.irfft(spectrum, len(signal), axis=-1).astype(np.float32)


def test_the_embedded_bundle_hears_a_plane_wave_and_no_silence() -> None:
    voice = synthetic_voice(np.random.default_rng(1), 1.5)
    audio = np.concatenate([plane_wave(2.0, voice), np.zeros((4, 16000), np.float32)], axis=1)
    heard = dict(embedded_estimates()(audio, 0.25))
    assert list(heard) == pytest.approx(np.arange(0.25, 2.51, 0.25))
    for time in (1.0, 1.25, 1.5):
        assert heard[time][0].azimuth == pytest.approx(2.0, abs=np.deg2rad(3))
    assert heard[2.25] == heard[2.5] == []


def test_a_stream_s_detections_are_followed_and_scored() -> None:
    """A perfect localizer of one walking talker gives one track, on time and without errors."""
    path = Arc(6.0, np.deg2rad(20))
    speech = np.concatenate([np.zeros(round(LEAD_S * RATE)), np.ones(4 * RATE)])
    scene = MovingScene(np.zeros((4, len(speech))), (Talker(path, speech),))
    times = np.arange(1, 47) / 10
    detections = [
        (t, [Detection(float(path.azimuth(t)), 0.95)] if t > LEAD_S else []) for t in times
    ]
    streams = [Stream("one", detections, scene), Stream("nobody", [(t, []) for t in times], None)]
    for tracks in (follow, untracked):
        tallies = tally_streams(streams, tracks)
        found = tallies["one"].scores()
        assert found["count_right"] == 1
        assert found["matched_error_deg"] < 7
        assert found["median_latency_s"] == pytest.approx(0.1)
        assert tallies["nobody"].scores()["false_tracks_per_minute"] == 0
    assert tally_streams(streams, follow)["one"].switches == 0
    assert tally_streams(streams, untracked)["one"].switches == 38


def test_the_document_says_which_bars_are_met() -> None:
    good = Tally(1.0, 0, 0, 10, 10, 20, 0, 0.0, hotas=[1.0], errors=[0.1], latencies=[0.1])
    poor = Tally(1.0, 2, 3, 10, 0, 20, 15, 1.0, hotas=[0.1], errors=[0.1], latencies=[0.4])
    names = [*(cell.name for cell in CELLS), "silence"]
    met = document(dict.fromkeys(names, good), dict.fromkeys(names, poor), "heldout")
    count = len(bars(dict.fromkeys(names, good)))
    assert f"\n{count} of {count} bars met." in met
    assert "**short**" not in met
    assert "| silence | 0 | 3 |" in met
    short = document(dict.fromkeys(names, poor), dict.fromkeys(names, good), "heldout")
    assert f"\n0 of {count} bars met." in short
    assert short.count("**short**") == count

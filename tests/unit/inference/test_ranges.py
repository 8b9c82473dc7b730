"""Whatever numbers a network gives, what is said is a direction and a chance."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from service.doa.orientation import Orientation
from service.doa.presets import preset
from service.doa.stft import Stft
from service.doa.tracking import Detection, Tracker
from service.doa.types import FloatArray
from service.inference.bundle import Bundle
from service.inference.localizer import localizer_of
from service.inference.registry import BundleRegistry
from service.inference.results import Source, WindowEstimate
from service.inference.stream import stream_localizer_of
from service.recordings.answers import WindowAnswer
from service.recordings.identities import identified
from service.recordings.results import WindowResult
from service.recordings.summary import summarise
from service.streaming.answers import stream_source

TURN = 2 * np.pi
SQUARE = preset("respeaker-usb-4mic-v2")
AUDIO = 0.1 * np.random.default_rng(0).standard_normal((4, 4, 16_640)).astype(np.float32)
SPECTRA = Stft().transform(AUDIO[0])
HUGE = np.float32(1e30)


class Network:
    """In an engine's place: outputs of the real one's shapes, of values that a test chooses.

    Parameters
    ----------
    engine : Engine
        For the shapes.
    rng : Generator
    kind : str
        Of values.
    gates : bool
        Whether they are the sigmoids of values, as those of a `weights` bundle's first network.
    """

    def __init__(self, engine: Any, rng: np.random.Generator, kind: str, gates: bool) -> None:
        self._engine, self._rng, self._kind, self._gates = engine, rng, kind, gates
        self.initial_state = engine.initial_state

    def run(self, inputs: Sequence[FloatArray]) -> list[FloatArray]:
        outputs = [self._values(output) for output in self._engine.run(inputs)]
        if self._gates:
            with np.errstate(over="ignore"):
                outputs[0] = 1 / (1 + np.exp(-outputs[0]))
            outputs[1] = np.maximum(outputs[1], 0) + np.log1p(np.exp(-np.abs(outputs[1])))
        return outputs

    def _values(self, like: FloatArray) -> FloatArray:
        drawn = self._rng.standard_normal(like.shape).astype(np.float32)
        chosen: FloatArray = {
            "ordinary": drawn,
            "sure": drawn * np.float32(15),
            "equal": np.full_like(drawn, drawn.flat[0]),
            "zero": np.zeros_like(drawn),
            "tiny": drawn * np.float32(1e-44),
            "saturated": drawn * np.float32(1e4),
            "huge": drawn * HUGE,
            "one of them": np.where(drawn == drawn.max(), HUGE, np.float32(0)),
        }[self._kind]
        return chosen


KINDS = ("ordinary", "sure", "equal", "zero", "tiny", "saturated", "huge", "one of them")
disturbances = st.tuples(st.integers(0, 2**32 - 1), st.sampled_from(KINDS), st.sampled_from(KINDS))


def disturbed(bundle: Bundle, seed: int, covariance: str, count: str) -> Bundle:
    rng, gates = np.random.default_rng(seed), bundle.manifest.variant == "weights"
    stream = bundle.covariance_stream
    networks: Any = {
        "covariance": Network(bundle.covariance, rng, covariance, gates),
        "source_count": Network(bundle.source_count, rng, count, False),
        "covariance_stream": stream and Network(stream, rng, covariance, gates),
    }
    return replace(bundle, **networks)


@pytest.fixture(scope="module")
def registry() -> BundleRegistry:
    return BundleRegistry.load()


def check(estimate: WindowEstimate) -> None:
    assert np.isfinite(estimate.spectrum).all()
    for source in estimate.sources:
        assert 0 <= source.azimuth < TURN
        assert 0 <= source.confidence <= 1


@pytest.mark.parametrize("name", ["any-array", "paper"])
@settings(max_examples=30, deadline=None)
@example(disturbance=(11, "ordinary", "sure"), known=None, turned=0.0)  # 1.0000001 of a softmax
@given(disturbance=disturbances, known=st.none() | st.integers(1, 3), turned=st.floats(-360, 360))
def test_recordings_get_directions_and_chances(
    name: str,
    registry: BundleRegistry,
    disturbance: tuple[int, str, str],
    known: int | None,
    turned: float,
) -> None:
    bundle = disturbed(registry.get(name), *disturbance)
    yaw = Orientation.of_degrees(turned, ())
    placed = []
    for index, estimate in enumerate(localizer_of(bundle, SQUARE).estimate(AUDIO, known, 3)):
        check(estimate)
        sources = [replace(s, azimuth=yaw.on_robot(s.azimuth)) for s in estimate.sources]
        placed.append(WindowResult(index, index + 1, replace(estimate, sources=tuple(sources))))
    named = list(identified(placed))
    for window in named:
        check(window.estimate)
        answer = json.loads(WindowAnswer.of(window).model_dump_json())
        for source in answer["sources"]:
            assert 0 <= source["azimuth_deg"] < 360
            assert 0 <= source["confidence"] <= 1
        assert all(value <= 1 for value in answer["spectrum"])
    for summed in summarise(named):
        assert 0 <= summed.azimuth < TURN
        assert 0 <= summed.confidence <= 1
        assert 0 < summed.share <= 1


@pytest.mark.parametrize("name", ["any-array", "paper"])
@settings(max_examples=15, deadline=None)
@given(disturbance=disturbances, known=st.none() | st.integers(1, 3))
def test_streams_get_directions_and_chances(
    name: str, registry: BundleRegistry, disturbance: tuple[int, str, str], known: int | None
) -> None:
    bundle = disturbed(registry.get(name), *disturbance)
    stream = stream_localizer_of("neural", bundle, SQUARE, Stft())
    tracker = Tracker()
    for step, first in enumerate(range(0, SPECTRA.shape[-1], 8)):
        stream.push(SPECTRA[..., first : first + 8])
        estimate = stream.estimate(known, 3)
        check(estimate)
        found = [Detection(source.azimuth, source.confidence) for source in estimate.sources]
        for track in tracker.update(found, step / 10):
            assert 0 <= track.azimuth < TURN
            assert 0 <= track.confidence <= 1
            sent = stream_source(track, Orientation(1.0))
            assert 0 <= sent.azimuth_deg < 360
            assert np.isfinite([sent.std_deg, sent.velocity_deg_s]).all()


@pytest.mark.parametrize("azimuth", [-5e-324, -1e-20, TURN, np.nextafter(TURN, 0), 1e9, -1e9])
@pytest.mark.parametrize("confidence", [-1e-9, 1.0000001, 0.5, float("nan"), float("inf")])
def test_rounding_takes_no_source_out_of_its_range(azimuth: float, confidence: float) -> None:
    check(WindowEstimate((Source(azimuth, confidence),), np.zeros(1)))
    assert 0 <= Orientation(-1e-20).on_robot(0.0) < TURN

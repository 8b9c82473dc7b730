"""The classical methods' confidences are chances: of talkers in rooms, and in pauses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pyroomacoustics as pra
import pytest

from neuralmusic.protocol.client_messages import AudioFormat, OutputOptions
from neuralmusic.protocol.methods import Method
from service.bench.window import bench_pieces
from service.doa.array import MicrophoneArray
from service.doa.scoring import circular_error
from service.doa.stft import Stft
from service.doa.types import FloatArray
from service.inference.classical import ClassicalLocalizer
from service.streaming.pipeline import StreamPipeline, StreamPlan

RATE = 16_000
METHODS: tuple[Method, ...] = ("norm_music", "music", "srp_phat", "gcc_phat")
PLACES = (30.0, 110.0, 200.0, 290.0)
WINDOW = 16_640


@pytest.fixture(scope="module")
def room(square: MicrophoneArray, plane_waves: Callable[..., FloatArray]) -> list[FloatArray]:
    """Four seconds of a talker at each place, RT60 0.45 s, 20 dB."""
    size, centre = np.array([6.0, 5.0, 3.0]), np.array([2.7, 2.2, 1.2])
    absorption, order = pra.inverse_sabine(0.45, size)
    rng = np.random.default_rng(0)
    heard = []
    for number, azimuth in enumerate(np.deg2rad(PLACES)):
        simulated = pra.ShoeBox(
            size, fs=RATE, materials=pra.Material(absorption), max_order=min(order, 10)
        )
        talk = plane_waves(square, [0.0], seconds=4.0, snr_db=60, seed=number)[0]
        towards = np.array([np.cos(azimuth), np.sin(azimuth), 0.1])
        simulated.add_source(centre + 1.5 * towards, signal=talk)
        simulated.add_microphone_array((centre + square.positions).T)
        simulated.simulate()
        audio = simulated.mic_array.signals[:, : 4 * RATE]
        audio = audio + 0.1 * audio.std() * rng.standard_normal(audio.shape)
        heard.append((0.1 * audio / audio.std()).astype(np.float32))
    return heard


@pytest.mark.parametrize("method", METHODS)
def test_confidences_are_as_high_as_the_share_that_is_right(
    method: Method, square: MicrophoneArray, room: list[FloatArray]
) -> None:
    localizer = ClassicalLocalizer(method, square)
    right, confidences = [], []
    for place, audio in zip(np.deg2rad(PLACES), room, strict=True):
        for begin in range(0, 3 * RATE, 4000):
            (found,) = localizer.estimate(audio[None, :, begin : begin + WINDOW], None, 3)
            for source in found.sources:
                confidences.append(source.confidence)
                right.append(float(circular_error(np.array(source.azimuth), place)) < 0.175)
    assert len(right) > 30
    assert np.mean(confidences) == pytest.approx(np.mean(right), abs=0.2)


@pytest.mark.parametrize("method", METHODS)
def test_a_stream_follows_a_talker_in_a_room(
    method: Method, square: MicrophoneArray, room: list[FloatArray]
) -> None:
    """A tracker takes confidences below a half as evidence against a talker."""
    audio = AudioFormat(encoding="pcm_s16le", sample_rate=RATE, channels=4)
    for place, heard in zip(np.deg2rad(PLACES), room, strict=True):
        plan = StreamPlan(audio, square, (0, 1, 2, 3), method, None, Stft())
        pipeline = StreamPipeline(plan)
        steps = [pipeline.step([piece], OutputOptions()) for piece in bench_pieces(heard)]
        tracks = [step.estimate.tracks for step in steps if step.estimate is not None]
        close = [
            min((float(circular_error(np.array(t.azimuth), place)) for t in each), default=9.0)
            for each in tracks
        ]
        assert np.mean(np.array(close) < 0.2) > (0.5 if method == "music" else 0.85)


@pytest.mark.parametrize(
    ("method", "asked"),
    # MUSIC has sharp peaks in noise, too, where it is told that there are two.
    [
        *(("norm_music", 1), ("norm_music", 2), ("music", 1), ("srp_phat", 1), ("srp_phat", 2)),
        *(("gcc_phat", 1), ("gcc_phat", 2)),
    ],
)
def test_who_is_asked_for_in_a_pause_is_unlikely_to_be_there(
    method: Method, asked: int, square: MicrophoneArray
) -> None:
    localizer = ClassicalLocalizer(method, square)
    rng = np.random.default_rng(1)
    for _ in range(5):
        noise = (0.01 * rng.standard_normal((1, 4, WINDOW))).astype(np.float32)
        (found,) = localizer.estimate(noise, asked, 3)
        assert all(source.confidence < 0.4 for source in found.sources)

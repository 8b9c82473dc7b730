"""A head that turns while talkers stand still: streams with and without poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from model_export import SAMPLE_RATE
from model_export.evaluation.cells import living_room
from model_export.evaluation.false_sources import ARRAY
from model_export.evaluation.tracking.scenes import SNR_DB
from model_export.simulation.moving import STEP, convolve_moving
from model_export.simulation.noise import sensor_noise
from model_export.simulation.rooms import RESPONSE_SAMPLES, impulse_responses
from model_export.simulation.running_speech import active_power, running_speech
from neuralmusic.protocol.client_messages import AudioFormat, OutputOptions
from service.doa.array import MicrophoneArray
from service.doa.peaks import circular_difference
from service.doa.pose import Pose, Rotation
from service.doa.presets import preset
from service.doa.steering import unit_vectors
from service.doa.types import FloatArray
from service.inference.registry import BundleRegistry
from service.streaming.buffer import Piece
from service.streaming.pipeline import Estimate, StreamPipeline, StreamPlan

RT60 = 0.3
SECONDS = 8.0
HOP = SAMPLE_RATE // 10
POSES_A_SECOND = 50
SETTLED_S = 1.0
"""Seconds at the beginning that are not scored"""


@dataclass(frozen=True, slots=True)
class Turn:
    """How a head turns, how its poses are told, and who talks."""

    name: str
    yaw: Callable[[float], float]
    """Degrees at a time in seconds"""
    talkers_deg: tuple[float, ...] = (60.0,)
    pose_error_deg: float = 0.0
    """Standard deviation of every pose"""
    late_s: float = 0.0
    """Seconds after which a pose arrives"""
    told: bool = True
    """Whether poses are sent"""


def steady(degrees_a_second: float) -> Callable[[float], float]:
    """A turn at one speed."""
    return lambda time: degrees_a_second * time


def shaken(time: float) -> float:
    """45 degrees either way, once in two seconds."""
    return 45 * math.sin(math.pi * time)


TURNS = (
    *(Turn(f"{speed}°/s", steady(speed)) for speed in (0, 60, 90, 180)),
    Turn("90°/s, poses 100 ms late", steady(90), late_s=0.1),
    Turn("90°/s, poses wrong by 2° (standard deviation)", steady(90), pose_error_deg=2.0),
    Turn("90°/s, no poses sent", steady(90), told=False),
    Turn("two talkers, ±45° at 0.5 Hz", shaken, (40.0, 300.0)),
    Turn("two talkers, ±45° at 0.5 Hz, no poses sent", shaken, (40.0, 300.0), told=False),
)


@dataclass(slots=True)
class TurnScores:
    """Scores over the streams of one turn."""

    errors: list[float] = field(default_factory=list)
    """Signed degrees from every active source to the nearest talker"""
    ids: list[int] = field(default_factory=list)
    """Number of ids in every stream"""
    right: list[bool] = field(default_factory=list)
    """Whether a result has as many active sources as there are talkers"""

    def row(self) -> str:
        """Bias, mean absolute error, ids, count right."""
        errors = np.array(self.errors)
        return (
            f"{errors.mean():+.1f}° | {np.abs(errors).mean():.1f}° | {np.mean(self.ids):.1f} "
            f"| {100 * np.mean(self.right):.0f} %"
        )


def turning_table(speech: Sequence[FloatArray], seed: int, streams: int = 3) -> str:
    """The table of ``docs/tracking.md`` on heads that turn."""
    lines = ["| the head | bias | error | ids in 7 s | count right |", "|---|---|---|---|---|"]
    for turn in TURNS:
        scores = TurnScores()
        for index in range(streams):
            rng = np.random.default_rng([seed, index])
            _score(turn, list(follow(turn, simulate(turn, speech, rng), rng)), scores)
        lines.append(f"| {turn.name} | {scores.row()} |")
    return "\n".join(lines) + "\n"


def simulate(turn: Turn, speech: Sequence[FloatArray], rng: np.random.Generator) -> FloatArray:
    """Audio (N, T) of talkers 1.5 m away; a room response is simulated every two degrees."""
    array, length = preset(ARRAY), round(SECONDS * SAMPLE_RATE)
    times = np.arange(0, SECONDS, 0.005)
    yaws = np.deg2rad([turn.yaw(float(time)) for time in times])
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(yaws)))])
    knots = np.unique(np.searchsorted(way, np.arange(0, way[-1] + 1e-9, STEP)))
    audio = np.zeros((array.num_microphones, length))
    clips = rng.permutation(len(speech))[: len(turn.talkers_deg)]
    for azimuth, clip in zip(np.deg2rad(turn.talkers_deg), clips, strict=True):
        responses = np.array([_response(array, yaw, azimuth) for yaw in yaws[knots].tolist()])
        dry = running_speech(rng, speech[clip], length)
        wet = convolve_moving(dry, responses, times[knots] * SAMPLE_RATE)
        audio += wet / np.sqrt(active_power(wet[0]))
    audio += 10 ** (-SNR_DB / 20) * sensor_noise(rng, audio.shape)
    return (0.05 * audio).astype(np.float32)


def _response(array: MicrophoneArray, yaw: float, azimuth: float) -> FloatArray:
    """(N, K): the room turned about an array that keeps its place."""
    cosine, sine = math.cos(yaw), math.sin(yaw)
    turned = array.positions @ np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    place = 1.5 * unit_vectors(np.array([azimuth]))
    found: FloatArray = impulse_responses(
        living_room(RT60), turned, place, longest=RESPONSE_SAMPLES
    )[0]
    return found


def follow(turn: Turn, audio: FloatArray, rng: np.random.Generator) -> Iterator[Estimate]:
    """Results of the embedded bundle in the world's frame, ten a second."""
    array = preset(ARRAY)
    bundle = BundleRegistry.load().for_array(array)
    assert bundle is not None
    channels = array.num_microphones
    sent = AudioFormat(encoding="pcm_f32le", sample_rate=SAMPLE_RATE, channels=channels)
    plan = StreamPlan(sent, array, tuple(range(channels)), "neural", bundle, bundle.stft)
    pipeline, output, told = StreamPipeline(plan), OutputOptions(frame="world"), 0
    for begin in range(0, audio.shape[1] - HOP + 1, HOP):
        poses = []
        while turn.told and told / POSES_A_SECOND + turn.late_s <= (begin + HOP) / SAMPLE_RATE:
            time = told / POSES_A_SECOND
            degrees = turn.yaw(time) + turn.pose_error_deg * rng.standard_normal()
            poses.append(Pose(time, Rotation.of_angles(math.radians(degrees))))
            told += 1
        data = np.ascontiguousarray(audio[:, begin : begin + HOP].T).tobytes()
        step = pipeline.step([Piece(begin, data, 0.0, None)], output, poses=poses)
        if step.estimate is not None and step.estimate.t_end > SETTLED_S:
            yield step.estimate


def _score(turn: Turn, results: Sequence[Estimate], scores: TurnScores) -> None:
    talkers = np.deg2rad(turn.talkers_deg).tolist()
    for result in results:
        active = [track for track in result.tracks if track.active]
        scores.right.append(len(active) == len(talkers))
        for track in active:
            ways = [circular_difference(track.azimuth, talker) for talker in talkers]
            scores.errors.append(math.degrees(min(ways, key=abs)))
    scores.ids.append(len({track.id for result in results for track in result.tracks}))

"""Streams that tracking is scored on: who talks where, and the simulated audio."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import soundfile

from model_export import SAMPLE_RATE
from model_export.evaluation.cells import living_room
from model_export.evaluation.false_sources import ARRAY, NOISES, noise_file
from model_export.simulation.moving import Arc, MovingScene, Talker, simulate_moving
from model_export.simulation.running_speech import running_speech
from service.doa.presets import preset
from service.doa.types import FloatArray

LEAD_S = 0.7
"""Seconds of noise alone before anybody talks"""
SNR_DB = 20.0
NOISE_S = 60.0

Paths = Callable[[np.random.Generator], tuple[Arc, ...]]


@dataclass(frozen=True, slots=True)
class TrackingCell:
    """One kind of stream."""

    name: str
    rt60: float
    paths: Paths
    seconds: float
    streams: int
    least_voiced: int = 1
    """Fewest talkers who must talk in an update for it to be scored"""


def apart(separation_deg: float) -> Paths:
    """Two talkers who stand this far apart."""

    def paths(rng: np.random.Generator) -> tuple[Arc, ...]:
        first = rng.uniform(0, 2 * np.pi)
        return Arc(first), Arc(first + np.deg2rad(separation_deg))

    return paths


def one_walks(rng: np.random.Generator) -> tuple[Arc, ...]:
    """One talker who walks past at 15 to 40 degrees per second, either way."""
    speed = np.deg2rad(rng.uniform(15, 40)) * rng.choice([-1, 1])
    return (Arc(rng.uniform(0, 2 * np.pi), speed, rng.uniform(1.0, 1.6)),)


def two_cross(rng: np.random.Generator) -> tuple[Arc, ...]:
    """Two talkers who start about 110 degrees apart and cross, each at a speed of its own."""
    middle, seconds = rng.uniform(0, 2 * np.pi), rng.uniform(2.5, 4.0)
    arcs = []
    for side, distance in ((-1, rng.uniform(1.0, 1.2)), (1, rng.uniform(1.4, 1.6))):
        reach = np.deg2rad(rng.uniform(45, 65))
        arcs.append(Arc(middle + side * reach, -side * reach / seconds, distance))
    return tuple(arcs)


CELLS = (
    *(
        TrackingCell(
            f"two talkers {separation_deg}° apart, RT60 {rt60:g} s",
            rt60,
            apart(separation_deg),
            seconds=8.0,
            streams=4,
            least_voiced=2,
        )
        for rt60 in (0.0, 0.3, 0.6)
        for separation_deg in (45, 90, 150)
    ),
    *(
        TrackingCell(f"one walks, RT60 {rt60:g} s", rt60, one_walks, seconds=8.0, streams=6)
        for rt60 in (0.3, 0.6)
    ),
    *(
        TrackingCell(f"two cross, RT60 {rt60:g} s", rt60, two_cross, seconds=8.0, streams=6)
        for rt60 in (0.3, 0.6)
    ),
)
"""Cells of the evaluation; the peers were measured on those with two still talkers"""


def simulate_stream(
    cell: TrackingCell, speech: Sequence[FloatArray], seed: int, index: int
) -> MovingScene:
    """One stream of a cell: ``LEAD_S`` of noise, then everybody talks at once."""
    rng = np.random.default_rng([seed, zlib.crc32(cell.name.encode()), index])
    paths = cell.paths(rng)
    clips = rng.permutation(len(speech))[: len(paths)]
    lead, length = round(LEAD_S * SAMPLE_RATE), round(cell.seconds * SAMPLE_RATE)
    talkers = []
    for path, clip in zip(paths, clips, strict=True):
        words = running_speech(rng, speech[clip], length - lead)
        talkers.append(Talker(path, np.concatenate([np.zeros(lead, words.dtype), words])))
    room = living_room(cell.rt60)
    return simulate_moving(rng, room, preset(ARRAY), talkers, snr_db=SNR_DB)


def noise_streams(seed: int) -> dict[str, FloatArray]:
    """Recordings (N, T) in which nobody talks, by name."""
    streams = {}
    for noise in NOISES:
        file = noise_file(replace(noise, seconds=NOISE_S), preset(ARRAY), seed)
        samples, _ = soundfile.read(file, dtype="float32")
        streams[noise.name.removeprefix("60 s of ")] = samples.T
    return streams

"""Streams that tracking is scored on: who talks where, and the simulated audio."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

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


@dataclass(frozen=True, slots=True)
class Part:
    """What one talker does in a stream."""

    path: Arc
    turns: tuple[tuple[float, float], ...] = ((LEAD_S, np.inf),)
    """Seconds of the stream in which the talker talks, each with its end"""


Parts = Callable[[np.random.Generator], tuple[Part, ...]]


@dataclass(frozen=True, slots=True)
class TrackingCell:
    """One kind of stream."""

    name: str
    rt60: float
    parts: Parts
    seconds: float
    streams: int
    least_voiced: int = 1
    """Fewest talkers who must talk in an update for it to be scored"""
    bars: bool = True
    """Whether bars are asked of this cell"""


def apart(separation_deg: float) -> Parts:
    """Two talkers who stand this far apart."""

    def parts(rng: np.random.Generator) -> tuple[Part, ...]:
        first = rng.uniform(0, 2 * np.pi)
        return Part(Arc(first)), Part(Arc(first + np.deg2rad(separation_deg)))

    return parts


def one_walks(rng: np.random.Generator) -> tuple[Part, ...]:
    """One talker who walks past at 15 to 40 degrees per second, either way."""
    speed = np.deg2rad(rng.uniform(15, 40)) * rng.choice([-1, 1])
    return (Part(Arc(rng.uniform(0, 2 * np.pi), speed, rng.uniform(1.0, 1.6))),)


def two_cross(rng: np.random.Generator) -> tuple[Part, ...]:
    """Two talkers who start about 110 degrees apart and cross, each at a speed of its own."""
    middle, seconds = rng.uniform(0, 2 * np.pi), rng.uniform(2.5, 4.0)
    arcs = []
    for side, distance in ((-1, rng.uniform(1.0, 1.2)), (1, rng.uniform(1.4, 1.6))):
        reach = np.deg2rad(rng.uniform(45, 65))
        arcs.append(Arc(middle + side * reach, -side * reach / seconds, distance))
    return tuple(map(Part, arcs))


def one_walks_behind(rng: np.random.Generator) -> tuple[Part, ...]:
    """One talker stands; another walks past behind at 15 to 40 degrees per second."""
    place, side = rng.uniform(0, 2 * np.pi), rng.choice([-1, 1])
    speed, reach = np.deg2rad(rng.uniform(15, 40)), np.deg2rad(rng.uniform(50, 70))
    walker = Arc(place + side * reach, -side * speed, rng.uniform(1.6, 2.0), LEAD_S)
    return Part(Arc(place, distance=rng.uniform(1.0, 1.3))), Part(walker)


def one_pauses(rng: np.random.Generator) -> tuple[Part, ...]:
    """One talker who is silent for 3 to 10 seconds and goes on at the same place."""
    begin = rng.uniform(2.5, 3.5)
    end = begin + rng.uniform(3, 10)
    return (Part(Arc(rng.uniform(0, 2 * np.pi)), ((LEAD_S, begin), (end, end + 2.5))),)


def one_moves_in_silence(rng: np.random.Generator) -> tuple[Part, ...]:
    """One talker who walks 30 degrees in 3 seconds of silence and goes on there."""
    begin, side = rng.uniform(2.5, 3.5), rng.choice([-1, 1])
    walk = Arc(rng.uniform(0, 2 * np.pi), side * np.deg2rad(10), 1.5, begin, begin + 3)
    return (Part(walk, ((LEAD_S, begin), (begin + 3, begin + 5.5))),)


def two_take_turns(rng: np.random.Generator) -> tuple[Part, ...]:
    """Two talkers 40 to 180 degrees apart whose turns last 4 to 8 seconds, two for each."""
    first = rng.uniform(0, 2 * np.pi)
    second = first + np.deg2rad(rng.uniform(40, 180))
    changes = LEAD_S + np.cumsum([0.0, *rng.uniform(4, 8, 3), 3.0])
    turns = [(begin, end - 0.3) for begin, end in pairwise(changes)]
    return Part(Arc(first), tuple(turns[::2])), Part(Arc(second), tuple(turns[1::2]))


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
    TrackingCell(
        "one walks behind a talker, RT60 0.3 s", 0.3, one_walks_behind, 8.0, 8, bars=False
    ),
    TrackingCell("one pauses for 3 to 10 s, RT60 0.3 s", 0.3, one_pauses, 16.0, 8, bars=False),
    TrackingCell(
        "one moves 30° in silence, RT60 0.3 s", 0.3, one_moves_in_silence, 9.0, 8, bars=False
    ),
    TrackingCell("two take turns, RT60 0.3 s", 0.3, two_take_turns, 28.0, 4, bars=False),
)
"""Cells of the evaluation; the peers were measured on those with two still talkers"""


def simulate_stream(
    cell: TrackingCell, speech: Sequence[FloatArray], seed: int, index: int
) -> MovingScene:
    """One stream of a cell: ``LEAD_S`` of noise, then everybody talks at once."""
    rng = np.random.default_rng([seed, zlib.crc32(cell.name.encode()), index])
    parts = cell.parts(rng)
    clips = rng.permutation(len(speech))[: len(parts)]
    length = round(cell.seconds * SAMPLE_RATE)
    talkers = []
    for part, clip in zip(parts, clips, strict=True):
        lead = round(LEAD_S * SAMPLE_RATE)
        words = running_speech(rng, speech[clip], length - lead)
        words = np.concatenate([np.zeros(lead, words.dtype), words])
        times = np.arange(length) / SAMPLE_RATE
        talks = [(begin <= times) & (times < end) for begin, end in part.turns]
        talkers.append(Talker(part.path, words * np.logical_or.reduce(talks)))
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

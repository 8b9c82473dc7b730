"""One talker before arrays of 2 to 64 microphones: does the model report whom NormMUSIC finds?

The networks were trained on arrays of 3 to 8 microphones. The sweep tells whether what they learned
holds for others: rings, spheres (open and rigid), grids, lines and irregular arrays, in free field
and in rooms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType

import numpy as np

from model_export import SAMPLE_RATE
from model_export.simulation.noise import sensor_noise, unit_power
from model_export.simulation.rigid_sphere import rigid_sphere_response
from model_export.simulation.rooms import RoomSpec, impulse_responses
from model_export.simulation.scenes import WINDOW_SAMPLES, convolve
from service.doa.array import MicrophoneArray
from service.doa.scoring import circular_error
from service.doa.steering import unit_vectors
from service.doa.types import BoolArray, FloatArray
from service.inference.bundle import Bundle
from service.inference.classical import ClassicalLocalizer
from service.inference.localizer import Localizer, localizer_of

NUMBERS = (2, 3, 4, 8, 12, 16, 26, 32, 48, 64)
RT60 = (0.0, 0.2, 0.4, 0.8)
SNR_DB = (5.0, 15.0, 30.0)
ROOM_SIZE, CENTRE = (7.0, 6.0, 3.0), (3.2, 2.8, 1.3)
DISTANCE = 1.5
HIGHEST_ORDER = 15
"""Image order at which rooms are cut: 64 microphones would take minutes a talker"""
FRONT = np.deg2rad(70)
"""Largest azimuth of talkers before a line or an upright grid, which have mirror images"""
HIT = np.deg2rad(10)


def ring(count: int, radius: float) -> FloatArray:
    azimuth = 0.1 + np.arange(count) * (2 * np.pi / count)
    return radius * unit_vectors(azimuth)


def sphere(count: int, radius: float) -> FloatArray:
    """Points (N, 3) of a Fibonacci lattice."""
    height = 1 - (2 * np.arange(count) + 1) / count
    return radius * unit_vectors(np.pi * (1 + 5**0.5) * np.arange(count), np.arcsin(height))


def grid(count: int, spacing: float) -> FloatArray:
    """Points (N, 3) of a level grid, row by row, about their middle."""
    side = int(np.ceil(np.sqrt(count)))
    points = np.array([(n % side, n // side, 0) for n in range(count)], dtype=float) * spacing
    return points - points.mean(axis=0)


def line(count: int, spacing: float) -> FloatArray:
    return ((np.arange(count) - (count - 1) / 2) * spacing)[:, None] * np.array([[0.0, 1.0, 0.0]])


def irregular(count: int, width: float) -> FloatArray:
    return np.random.default_rng(count).uniform(-0.5, 0.5, (count, 3)) * [width, width, width / 4]


SHAPES: Mapping[str, Callable[[int], FloatArray]] = MappingProxyType(
    {
        "ring r 50 mm": lambda count: ring(count, 0.05),
        "ring r 200 mm": lambda count: ring(count, 0.2),
        "sphere r 42 mm": lambda count: sphere(count, 0.042),
        "sphere r 100 mm": lambda count: sphere(count, 0.1),
        "rigid sphere r 42 mm": lambda count: sphere(count, 0.042),
        "level grid, 20 mm": lambda count: grid(count, 0.02),
        "level grid, 42 mm": lambda count: grid(count, 0.042),
        "upright grid, 42 mm": lambda count: grid(count, 0.042)[:, [2, 0, 1]],
        "line, 25 mm": lambda count: line(count, 0.025),
        "irregular, 200 mm": lambda count: irregular(count, 0.2),
    }
)
RIGID = "rigid sphere r 42 mm"
"""Swept in free field only: images of a room would scatter as well"""


@dataclass(frozen=True, slots=True)
class Case:
    """One scene of the sweep."""

    shape: str
    microphones: int
    rt60: float
    """Seconds; 0 is the free field"""
    snr_db: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """What two methods found of one talker."""

    case: Case
    classical: bool
    """NormMUSIC reports a direction within 10 degrees of the talker"""
    neural: bool
    """The model does"""
    others: int
    """Further directions that the model reports"""


def cases(
    shapes: Iterable[str] = tuple(SHAPES), numbers: Iterable[int] = NUMBERS
) -> Iterator[Case]:
    """All cases but two or three microphones of shapes with height: three always lie in one plane,
    and a leaning one is heard from one side only.
    """
    for shape, microphones, rt60, snr_db in product(shapes, numbers, RT60, SNR_DB):
        vertical = shape.startswith(("upright", "sphere", "rigid", "irregular"))
        if not (microphones < 4 and vertical) and not (shape == RIGID and rt60):
            yield Case(shape, microphones, rt60, snr_db)


def sweep(
    swept: Iterable[Case], speech: Sequence[FloatArray], bundle: Bundle, seed: int
) -> Iterator[Outcome]:
    """Simulate every case and localize its talker by the bundle and by NormMUSIC."""
    for index, case in enumerate(swept):
        array = MicrophoneArray(case.shape, SHAPES[case.shape](case.microphones))
        rng = np.random.default_rng([seed, index])
        audio, azimuth = _scene(rng, case, array, speech)
        found = _found(localizer_of(bundle, array), audio, azimuth)
        classical = _found(ClassicalLocalizer("norm_music", array), audio, azimuth)
        yield Outcome(case, bool(classical.sum()), bool(found.sum()), int((~found).sum()))


def table(outcomes: Sequence[Outcome]) -> str:
    """A Markdown table by the number of microphones."""
    rows = [
        "| microphones | talkers | NormMUSIC | model | lost | others |",
        "|---|---|---|---|---|---|",
    ]
    for number in (*sorted({outcome.case.microphones for outcome in outcomes}), None):
        chosen = [each for each in outcomes if number in (None, each.case.microphones)]
        lost = sum(each.classical and not each.neural for each in chosen)
        counts = (
            len(chosen),
            sum(each.classical for each in chosen),
            sum(each.neural for each in chosen),
            lost,
            sum(each.others for each in chosen),
        )
        rows.append(f"| {number or 'all'} | {' | '.join(map(str, counts))} |")
    return "\n".join(rows)


def _scene(
    rng: np.random.Generator, case: Case, array: MicrophoneArray, speech: Sequence[FloatArray]
) -> tuple[FloatArray, float]:
    """Audio (N, T) float32 of one talker at the array's height, and its azimuth."""
    azimuth = rng.uniform(-FRONT, FRONT) if array.linear else rng.uniform(-np.pi, np.pi)
    direction = unit_vectors(np.array(azimuth))
    dry = speech[int(rng.integers(len(speech)))][:WINDOW_SAMPLES]
    if case.shape == RIGID:
        wet = _scattered(dry, array.positions, direction)
    else:
        room = RoomSpec(ROOM_SIZE, CENTRE, rt60=case.rt60)
        source = DISTANCE * direction[None]
        responses = impulse_responses(room, array.positions, source, highest_order=HIGHEST_ORDER)
        wet = convolve(dry, responses[0])
    wet = unit_power(wet[:, :WINDOW_SAMPLES])
    noise = np.float32(10 ** (-case.snr_db / 20)) * sensor_noise(rng, wet.shape)
    return wet + noise, azimuth


def _scattered(dry: FloatArray, positions: FloatArray, direction: FloatArray) -> FloatArray:
    """Speech (T,) from far away at microphones (N, 3) in a rigid sphere: (N, T) float32."""
    size = 2 * WINDOW_SAMPLES
    frequencies = np.fft.rfftfreq(size, 1 / SAMPLE_RATE)
    spectrum = np.fft.rfft(dry, size)[1:]
    spectrum = spectrum * rigid_sphere_response(positions, frequencies[1:], direction)
    audio = np.fft.irfft(np.pad(spectrum, ((0, 0), (1, 0))), size)
    return audio[:, :WINDOW_SAMPLES].astype(np.float32)


def _found(localizer: Localizer, audio: FloatArray, azimuth: float) -> BoolArray:
    """Whether each reported source (M,) is within 10 degrees of the talker."""
    (estimate,) = localizer.estimate(audio[None], None, 3)
    reported = np.array([source.azimuth for source in estimate.sources])
    return np.asarray(circular_error(reported, np.array(azimuth)) <= HIT)

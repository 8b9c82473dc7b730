"""What the source-count network is told of a candidate direction.

Nothing in it names the array's geometry but how many microphones it has and how far it resolves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.doa.peaks import Peak, circular_difference
from service.doa.types import FloatArray

NUM_DESCRIPTORS = 21
SHARP_LEVEL = 0.9
NEIGHBOURHOOD = np.deg2rad(20.0)
"""In which blocks may disagree on where a candidate is: two close talkers do, one does not"""


@dataclass(frozen=True, slots=True)
class Field:
    """The cells of one window, out of which candidates are taken."""

    cells: FloatArray
    """(F, K, A) float32 MUSIC spectra, maximum 1 each; the last of K is the whole window"""
    attention: FloatArray
    """(F, K) float32, non-negative"""
    dominance: FloatArray
    """(F, K) float32 in (0, 1]"""
    num_microphones: int
    resolution: float
    """Of the array, from ``service.doa.steering.resolution``"""

    @property
    def total(self) -> float:
        return float(self.attention.sum())


@dataclass(frozen=True, slots=True)
class Finding:
    """One candidate and the state in which it was found."""

    peaks: Sequence[Peak]
    """The highest and, if there is one, the second"""
    index: int
    """Of the highest peak on the grid"""
    fused: FloatArray
    """(A,) of what remained before it"""
    blocks: FloatArray
    """(K, A) likewise, before the sum over blocks"""
    pointing: FloatArray
    """(F, K) the cells' spectra at the peak"""
    support: FloatArray
    """(F, K) attention of the cells that belong to it"""
    remaining: FloatArray
    """(F, K) attention before it"""

    @property
    def azimuth(self) -> float:
        return self.peaks[0].azimuth


def describe(field: Field, findings: Sequence[Finding]) -> FloatArray:
    """(D,) float32 of the last finding, given those before it."""
    found = findings[-1]
    total = field.total
    support = found.support / np.float32(total)
    mass = max(float(support.sum()), 1e-9)
    sharp = np.where(found.pointing > SHARP_LEVEL, found.support, np.float32(0))
    earlier = [abs(circular_difference(found.azimuth, f.azimuth)) for f in findings[:-1]]
    spread, drift = _disagreement(found)
    return np.array(
        [
            *_peak_shape(found),
            float(support.sum()),
            _spread(support.sum(axis=0)),
            _spread(support.sum(axis=1)),
            float(found.remaining.sum()) / total,
            float(findings[0].fused[found.index]),
            min(earlier, default=np.pi) / np.pi,
            float((field.attention * field.dominance).sum()) / total,
            0.1 * float(np.log(total / field.attention.size + 1e-6)),
            field.num_microphones / 8,
            field.resolution,
            float((support * field.dominance).sum()) / mass,
            float(sharp.sum()) / total,
            *_likeness(findings[0].support, found.support),
            spread,
            drift,
        ],
        dtype=np.float32,
    )


def _peak_shape(found: Finding) -> tuple[float, float, float, float]:
    """Height, the spectrum's mean, the second peak against the first, the fall over 10 degrees."""
    peaks, fused = found.peaks, found.fused
    second = peaks[1].height / peaks[0].height if len(peaks) > 1 else 0.0
    step = max(1, round(fused.size / 36))
    sides = fused[[(found.index - step) % fused.size, (found.index + step) % fused.size]]
    return peaks[0].height, float(fused.mean()), second, float(sides.mean() / peaks[0].height)


def _likeness(first: FloatArray, support: FloatArray) -> tuple[float, float, float]:
    """How far a candidate sounds when and where the first does, or a block later.

    Reflections sound with the talker or just after him, in the same bins.
    """
    in_time, in_bins = support[:, :-1].sum(axis=0), support.sum(axis=1)
    first_time, first_bins = first[:, :-1].sum(axis=0), first.sum(axis=1)
    return (
        _cosine(in_time, first_time),
        _cosine(in_time[1:], first_time[:-1]),
        _cosine(in_bins, first_bins),
    )


def _disagreement(found: Finding) -> tuple[float, float]:
    """Spread in units of 10 degrees of the blocks' own peaks near the candidate, and its drift.

    The drift is the spread's part that goes with time: talkers that take turns.
    """
    size = found.fused.size
    reach = round(NEIGHBOURHOOD / (2 * np.pi) * size)
    near = (found.index + np.arange(-reach, reach + 1)) % size
    blocks = found.blocks[:-1, near]
    offset = (blocks.argmax(axis=1) - reach) * (36.0 / size)
    weight = found.support[:, :-1].sum(axis=0)
    mass = float(weight.sum())
    if mass <= 0:
        return 0.0, 0.0
    centred = offset - float((weight * offset).sum()) / mass
    spread = float(np.sqrt((weight * centred**2).sum() / mass))
    steps = np.minimum(weight[1:], weight[:-1])
    drift = float((steps * np.abs(np.diff(offset))).sum() / max(float(steps.sum()), 1e-9))
    return spread, drift


def _spread(weights: FloatArray) -> float:
    """Over which share of its places a weight is spread: 1 where evenly, 1 / size where at one."""
    squares = float(np.square(weights).sum()) * weights.size
    return float(weights.sum()) ** 2 / squares if squares > 0 else 0.0


def _cosine(first: FloatArray, second: FloatArray) -> float:
    norms = float(np.sqrt(np.square(first).sum() * np.square(second).sum()))
    return float((first * second).sum()) / norms if norms > 0 else 0.0

"""Random microphone arrays for training models that must work on any geometry."""

from __future__ import annotations

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

MIN_SPACING = 0.008  # m; microphones of real boards are not closer
KINDS = ("ring", "ring_and_centre", "irregular", "three_dimensional")


def random_array(
    rng: np.random.Generator, num_microphones: int, aperture: tuple[float, float] = (0.03, 0.20)
) -> MicrophoneArray:
    """A ring, a ring with a centre, an irregular planar or a three-dimensional array.

    ``aperture`` bounds the diameter in metres; it is drawn log-uniformly, small boards being the
    rule on robots.
    """
    diameter = float(np.exp(rng.uniform(*np.log(aperture))))
    kind = rng.choice(KINDS, p=(0.45, 0.1, 0.25, 0.2))
    if kind == "ring_and_centre" and num_microphones < 4:
        kind = "ring"
    if kind == "ring":
        positions = _ring(rng, num_microphones, diameter / 2)
    elif kind == "ring_and_centre":
        positions = np.vstack([_ring(rng, num_microphones - 1, diameter / 2), np.zeros(3)])
    else:
        positions = _scatter(rng, num_microphones, diameter, flat=kind == "irregular")
    return MicrophoneArray(str(kind), positions[rng.permutation(num_microphones)])


def _ring(rng: np.random.Generator, count: int, radius: float) -> FloatArray:
    azimuth = rng.uniform(0, 2 * np.pi) + np.arange(count) * (2 * np.pi / count)
    return radius * np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(count)], axis=-1)


def _scatter(rng: np.random.Generator, count: int, diameter: float, *, flat: bool) -> FloatArray:
    """Points in a ball or disc with a minimum spacing, stretched to the wanted aperture."""
    while True:
        points = rng.normal(size=(count, 3))
        points *= rng.uniform(0.3, 1.0, (count, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
        if flat:
            points[:, 2] = 0
        distances = np.linalg.norm(points[:, None] - points[None], axis=-1)
        points *= diameter / distances.max()
        spacing = (distances * diameter / distances.max())[np.triu_indices(count, 1)].min()
        # Nearly collinear layouts cannot tell front from back and would only teach confusion.
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if spacing >= MIN_SPACING and spread[1] > 0.35 * spread[0]:
            return points

"""Microphone arrays: random ones to train models for any array, fixed ones to test them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.types import FloatArray

MIN_SPACING = 0.008  # m; microphones of real boards are not closer
KINDS = ("ring", "ring_and_centre", "irregular", "three_dimensional")


def named_array(name: str) -> MicrophoneArray:
    """The array or preset of this name; raises UnknownArray if there is none."""
    return TEST_ARRAYS.get(name) or LINES.get(name) or SPATIAL_ARRAYS.get(name) or preset(name)


def random_array(
    rng: np.random.Generator, num_microphones: int, aperture: tuple[float, float] = (0.03, 0.20)
) -> MicrophoneArray:
    """A ring, a ring with a centre, an irregular planar or a three-dimensional array.

    ``aperture`` bounds the diameter in metres, which is drawn log-uniformly because robots mostly
    have small boards.
    """
    diameter = float(np.exp(rng.uniform(*np.log(aperture))))
    kind = rng.choice(KINDS, p=(0.45, 0.1, 0.25, 0.2))
    if kind == "ring_and_centre" and num_microphones < 4:
        kind = "ring"
    if kind == "ring":
        positions = _ring(num_microphones, diameter / 2, rng.uniform(0, 2 * np.pi))
    elif kind == "ring_and_centre":
        ring = _ring(num_microphones - 1, diameter / 2, rng.uniform(0, 2 * np.pi))
        positions = np.vstack([ring, np.zeros(3)])
    else:
        positions = _scatter(rng, num_microphones, diameter, flat=kind == "irregular")
    return MicrophoneArray(str(kind), positions[rng.permutation(num_microphones)])


def _ring(count: int, radius: float, first_azimuth: float = 0.0) -> FloatArray:
    azimuth = first_azimuth + np.arange(count) * (2 * np.pi / count)
    return radius * np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(count)], axis=-1)


def _scatter(rng: np.random.Generator, count: int, diameter: float, *, flat: bool) -> FloatArray:
    """Points (N, 3) in a ball or disc with a minimum spacing, scaled to the aperture, metres."""
    while True:
        points = rng.normal(size=(count, 3))
        points *= rng.uniform(0.3, 1.0, (count, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
        if flat:
            points[:, 2] = 0
        distances = np.linalg.norm(points[:, None] - points[None], axis=-1)
        points *= diameter / distances.max()
        spacing = (distances * diameter / distances.max())[np.triu_indices(count, 1)].min()
        # Nearly collinear arrays cannot tell front from back, which would confuse training.
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if spacing >= MIN_SPACING and spread[1] > 0.35 * spread[0]:
            return points


TEST_ARRAYS: Mapping[str, MicrophoneArray] = MappingProxyType(
    {
        array.name: array
        for array in (
            MicrophoneArray("6-mic ring r 36 mm", _ring(6, 0.036)),
            MicrophoneArray("4-mic ring r 50 mm", _ring(4, 0.050)),
            MicrophoneArray(
                "irregular 4-mic",
                # Four points of a random disc 9 cm across (seed 4), up to 8 mm off the plane.
                np.array([[-16, 29, 4], [1, -25, -2], [52, -5, -7], [-38, 0, 4]]) / 1000,
            ),
            MicrophoneArray("8-mic ring r 100 mm", _ring(8, 0.100)),
        )
    }
)
"""Arrays for evaluation, in no training; rings count counter-clockwise from +x"""

LINES: Mapping[str, MicrophoneArray] = MappingProxyType(
    {
        array.name: array
        for array in (
            MicrophoneArray(
                "4-mic line, 40 mm apart",
                np.array([[0, y, 0] for y in (60, 20, -20, -60)]) / 1000,
            ),
        )
    }
)
"""Uniform linear arrays along y, for methods that need one; directions are towards +x only"""

_GOLDEN = (1 + 5**0.5) / 2
_ICOSAHEDRON = np.array(
    [
        np.roll((0, first, second * _GOLDEN), turn)
        for turn in range(3)
        for first in (-1, 1)
        for second in (-1, 1)
    ]
) / np.hypot(1, _GOLDEN)

SPATIAL_ARRAYS: Mapping[str, MicrophoneArray] = MappingProxyType(
    {
        array.name: array
        for array in (
            MicrophoneArray(
                "tetrahedron 50 mm",
                np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * 0.05 / 8**0.5,
            ),
            MicrophoneArray(
                "cube 40 mm",
                np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.02,
            ),
            MicrophoneArray("head of 12", _ICOSAHEDRON * [0.065, 0.060, 0.050]),
        )
    }
)
"""Arrays with height, named by the length of their edges; the head is an ellipsoid of a small
humanoid's size, whose shadow is not simulated"""

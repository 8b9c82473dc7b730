"""The cells of one window on the sphere: found on a coarse grid, refined around the candidates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from service.doa.fusion import attention_fusion
from service.doa.music import eigenvector_power
from service.doa.peaks import parabolic_offset
from service.doa.sphere import (
    DirectionGrid,
    angle_between,
    azimuth_elevation,
    moved,
    tangents,
)
from service.doa.steering import unit_vectors
from service.doa.types import ComplexArray, FloatArray
from service.inference.field import NEIGHBOURHOOD, REMOVAL_LEVEL, Field, FoundCandidate

STEP = np.deg2rad(2.0)
"""Radians between the directions around a candidate"""
REACH = 2
"""Steps from the middle of these directions to each side"""
MOST_STEPS = 4
"""Times that the directions around a candidate are moved after the maximum"""
SIDE_REACH = np.deg2rad(10.0)
"""Radians from a candidate to the directions that tell how steep its peak is"""
TINY = np.float32(np.finfo(np.float32).tiny)
_LEFT, _UP = (each.ravel() for each in np.meshgrid(*[np.arange(-REACH, REACH + 1)] * 2))
"""Steps to the left and upwards of the directions around a candidate"""
_MIDDLE = len(_LEFT) // 2
_WIDTH = 2 * REACH + 1


@dataclass(frozen=True)
class Sphere:
    """An array's directions, and its steering vectors in any of them."""

    grid: DirectionGrid
    steering: Callable[[FloatArray], ComplexArray]
    """Steering vectors (F, N, P) of directions (P, 3)"""
    floor: float
    """MUSIC's floor"""

    @cached_property
    def azimuths(self) -> FloatArray:
        """(D,) azimuths of the grid's directions in radians."""
        return self.grid.azimuth

    def distance(self, principal: ComplexArray, directions: FloatArray) -> FloatArray:
        """MUSIC's denominators (C, P) float32 of cells (F, R, N), bin by bin, in directions (P, 3)."""
        vectors = np.swapaxes(principal, 1, 2)
        power = eigenvector_power(vectors, self.steering(directions))  # (F, R, P)
        return np.float32(1 + self.floor) - power.reshape(-1, len(directions))


@dataclass(frozen=True)
class SphereField(Field):
    """A field whose ``cells`` (C, D) are spectra on the D directions of a grid."""

    principal: ComplexArray
    """(F, R + 1, N) unit vectors, the principal eigenvectors of the cells"""
    sphere: Sphere

    def azimuth_spectrum(self, fused: FloatArray) -> FloatArray:
        """A fused spectrum's maximum over the elevations."""
        return self.sphere.grid.azimuth_spectrum(fused)

    def find(self, remaining: FloatArray) -> FoundCandidate | None:
        """The highest peak of the cells with the attention (C,) that remains, if there is one."""
        fused = attention_fusion(self.cells, remaining)
        peaks = self.sphere.grid.peaks(fused, 2)
        if not peaks:
            return None
        index = peaks[0]
        direction = self._climb(index, self.sphere.grid.vectors[index], remaining)
        pointing = self._spectra(index, direction[None])[:, 0]
        height = float(remaining @ pointing) / max(float(remaining.sum()), float(TINY))
        heights = [height, *(float(fused[other]) for other in peaks[1:])]
        azimuth, elevation = azimuth_elevation(direction)
        support = remaining * (pointing > REMOVAL_LEVEL)
        return FoundCandidate(
            azimuth, heights, index, fused, pointing, support, remaining, elevation
        )

    def refined(self, source: FoundCandidate, weights: FloatArray) -> tuple[float, float | None]:
        """Azimuth and elevation of the maximum next to a source, with these weights (C,)."""
        return azimuth_elevation(self._climb(source.index, _direction(source), weights))

    def sides(self, findings: Sequence[FoundCandidate]) -> FloatArray:
        """(n,) mean of each candidate's fused spectrum 10 degrees around its peak."""
        around = np.arange(8) * (np.pi / 4)
        left, up = SIDE_REACH * np.cos(around), SIDE_REACH * np.sin(around)
        sides = [
            float(
                found.remaining
                @ self._spectra(found.index, moved(_direction(found), left, up)).mean(axis=1)
            )
            / max(float(found.remaining.sum()), float(TINY))
            for found in findings
        ]
        return np.array(sides)

    def between(self, one: FoundCandidate, other: FoundCandidate) -> float:
        """Angle between two candidates in radians."""
        return float(angle_between(_direction(one), _direction(other)))

    def block_peaks(self, found: FoundCandidate, attention: FloatArray) -> FloatArray:
        """(K - 1, 2) radians from a candidate to the highest values near it of every block.

        ``attention`` (K - 1, C) is each block's own.
        """
        near = self.sphere.grid.within(found.index, NEIGHBOURHOOD)
        highest = near[(attention @ self.cells[:, near]).argmax(axis=1)]
        direction = _direction(found)
        axes = np.array(tangents(direction))
        others = self.sphere.grid.vectors[highest]
        across = others @ axes.T
        length = np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
        offset = across / length * angle_between(others, direction[None])[:, None]
        return np.asarray(offset, dtype=np.float32)

    def _climb(self, index: int, start: FloatArray, weights: FloatArray) -> FloatArray:
        """The direction (3,) of the maximum next to ``start``, with these weights (C,)."""
        middle = start
        for _ in range(MOST_STEPS):
            around = moved(middle, _LEFT * STEP, _UP * STEP)
            fused = weights @ self._spectra(index, around)
            place = int(fused.argmax())
            row, column = divmod(place, _WIDTH)
            inside = 0 < row < _WIDTH - 1 and 0 < column < _WIDTH - 1
            if inside:
                break
            middle = around[place]
        else:
            return middle
        image = fused.reshape(_WIDTH, _WIDTH)
        left = column - REACH + parabolic_offset(image[row].tolist(), column)
        up = row - REACH + parabolic_offset(image[:, column].tolist(), row)
        return moved(middle, np.array(left * STEP), np.array(up * STEP))

    def _spectra(self, index: int, directions: FloatArray) -> FloatArray:
        """Spectra (C, P) in directions (P, 3) near one of the grid, at most 1.

        The grid's value there relates them to the cell's maximum on the grid.
        """
        both = np.concatenate([self.sphere.grid.vectors[index][None], directions])
        distance = self.sphere.distance(self.principal, both)
        least = self.cells[:, index] * distance[:, 0]
        np.minimum(least, distance.min(axis=1), out=least)
        return least[:, None] / distance[:, 1:]


def _direction(found: FoundCandidate) -> FloatArray:
    assert found.elevation is not None
    return unit_vectors(np.array(found.azimuth), found.elevation)

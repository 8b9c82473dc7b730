"""The cells of one window on the sphere: found on a coarse grid, refined around the candidates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from service.doa.fusion import attention_fusion
from service.doa.music import eigenvector_power
from service.doa.pose import Rotation
from service.doa.sphere import (
    DirectionGrid,
    angle_between,
    azimuth_elevation,
    climbed,
    tangents,
)
from service.doa.types import ComplexArray, FloatArray
from service.inference.field import NEIGHBOURHOOD, REMOVAL_LEVEL, Field, FoundCandidate

TINY = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True)
class Sphere:
    """An array's directions, and its steering vectors in any of them."""

    grid: DirectionGrid
    steering: Callable[[FloatArray], ComplexArray]
    """Steering vectors (F, N, P) of directions (P, 3)"""
    floor: float
    """MUSIC's floor"""

    def distance(self, principal: ComplexArray, directions: FloatArray) -> FloatArray:
        """MUSIC's denominators (P, C) float32 of cells (F, R, N), bin by bin.

        ``directions`` are P unit vectors (P, 3).
        """
        power = eigenvector_power(np.swapaxes(principal, 1, 2), self.steering(directions))
        flat = power.reshape(-1, len(directions)).T  # (F, R, P) to (P, C)
        return np.float32(1 + self.floor) - np.ascontiguousarray(flat)


@dataclass(frozen=True)
class SphereField(Field):
    """A field whose ``cells`` (C, D) are spectra on the D directions of a grid."""

    principal: ComplexArray
    """(F, R + 1, N) unit vectors, the principal eigenvectors of the cells"""
    sphere: Sphere
    turns: Sequence[Rotation] | None = None
    """(R + 1,) rotations into this field's frame, where blocks were heard in others"""

    def azimuth_spectrum(self, fused: FloatArray) -> FloatArray:
        """A fused spectrum's maximum over the elevations."""
        return self.sphere.grid.azimuth_spectrum(fused)

    def image(self, fused: FloatArray) -> FloatArray:
        """A fused spectrum as an image of the sphere."""
        return self.sphere.grid.image(fused)

    def find(self, remaining: FloatArray) -> FoundCandidate | None:
        """The highest peak of the cells with the attention (C,) that remains, if there is one."""
        grid = self.sphere.grid
        fused = attention_fusion(self.cells, remaining)
        peaks = grid.peaks(fused, 2)
        if not peaks:
            return None
        direction = grid.vertex(fused, peaks[0])
        pointing = self._spectra(peaks[0], direction[None])[:, 0]
        height = float(remaining @ pointing) / max(float(remaining.sum()), TINY)
        heights = [height, *(float(fused[other]) for other in peaks[1:])]
        azimuth, _ = azimuth_elevation(direction)
        support = remaining * (pointing > REMOVAL_LEVEL)
        return FoundCandidate(
            azimuth, heights, peaks[0], fused, pointing, support, remaining, direction
        )

    def refined(self, source: FoundCandidate, weights: FloatArray) -> tuple[float, float | None]:
        """Azimuth and elevation of the maximum next to a source, with these weights (C,)."""
        assert source.direction is not None
        return azimuth_elevation(
            climbed(
                source.direction, lambda towards: weights @ self._spectra(source.index, towards)
            )
        )

    def sides(self, findings: Sequence[FoundCandidate]) -> FloatArray:
        """(n,) mean of each candidate's fused spectrum at the grid's directions around its peak."""
        neighbours = self.sphere.grid.neighbours
        return np.array([found.fused[neighbours[found.index]].mean() for found in findings])

    def between(self, one: FoundCandidate, other: FoundCandidate) -> float:
        """Angle between two candidates in radians."""
        assert one.direction is not None
        assert other.direction is not None
        return float(angle_between(one.direction, other.direction))

    def block_peaks(self, found: FoundCandidate, attention: FloatArray) -> FloatArray:
        """(K - 1, 2) radians from a candidate to the highest values near it of every block.

        ``attention`` (K - 1, C) is each block's own.
        """
        assert found.direction is not None
        grid = self.sphere.grid
        near = grid.within(found.index, NEIGHBOURHOOD)
        highest = near[(attention @ self.cells[:, near]).argmax(axis=1)]
        offset = grid.vectors[highest] @ np.array(tangents(found.direction)).T
        return np.asarray(offset, dtype=np.float32)

    def _spectra(self, index: int, directions: FloatArray) -> FloatArray:
        """Spectra (C, P) in directions (P, 3) near one of the grid, at most 1.

        The grid's value there relates them to the cell's maximum on the grid.
        """
        both = np.concatenate([self.sphere.grid.vectors[index][None], directions])
        distance = self._distance(both)
        least = self.cells[:, index] * distance[0]
        np.minimum(least, distance.min(axis=0), out=least)
        return np.asarray((least / distance[1:]).T)

    def _distance(self, directions: FloatArray) -> FloatArray:
        """MUSIC's denominators (P, C) in directions (P, 3) of this field's frame."""
        if self.turns is None:
            return self.sphere.distance(self.principal, directions)
        rows = [
            self.sphere.distance(self.principal[:, row : row + 1], directions @ turn.matrix)
            for row, turn in enumerate(self.turns)
        ]
        return np.stack(rows, axis=-1).reshape(len(directions), -1)

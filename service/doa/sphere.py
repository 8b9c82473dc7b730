"""Grids of directions on the sphere, and the peaks of a spatial spectrum on them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
import scipy.sparse

from service.doa.peaks import wrapped
from service.doa.steering import unit_vectors
from service.doa.types import FloatArray, IntArray

FREQUENCY = 8
"""Parts of an icosahedron's edge in the grid: 642 directions, neighbours 7 to 9 degrees apart"""
MIN_SEPARATION = np.deg2rad(10.0)
"""Radians; of two maxima closer than this only the higher one counts"""
NUM_AZIMUTHS = 180
"""Azimuths of the spectrum that is left where elevations are taken together"""
IMAGE_SHAPE = (36, 72)
"""Elevations and azimuths of an image of the sphere, 5 degrees apart"""
SMOOTHING = np.deg2rad(5.0)
"""Standard deviation of the weights by which a direction's value is taken from its neighbours'"""
CLIMB_STEP = np.deg2rad(2.5)
"""Radians from a direction to the six around it among which a climb finds the highest value"""
MOST_MOVES = 4
"""Most times that a climb moves by a step: to the distance between separate maxima"""
HEXAGON = CLIMB_STEP * np.array([[np.cos(a), np.sin(a)] for a in np.arange(6) * (np.pi / 3)])
"""Places (6, 2) in radians of these directions"""


@dataclass(frozen=True, eq=False)
class DirectionGrid:
    """D directions that cover the sphere or a half of it evenly."""

    vectors: FloatArray
    """(D, 3) unit vectors; on the whole sphere the second half is opposite the first"""
    neighbours: IntArray
    """(D, 6) indices of the nearest directions; its own where there are fewer"""
    normal: FloatArray | None = None
    """(3,) unit vector in the middle of a half; None on the whole sphere"""

    @property
    def size(self) -> int:
        return len(self.vectors)

    def within(self, index: int, reach: float) -> IntArray:
        """Indices of the directions at most ``reach`` radians from one of them."""
        return np.flatnonzero(self.vectors @ self.vectors[index] >= math.cos(reach))

    def azimuth_spectrum(self, spectrum: FloatArray) -> FloatArray:
        """The maximum (A,) over the elevations of values (D,), interpolated."""
        values: FloatArray = self._azimuth_weights @ spectrum
        highest: FloatArray = values.reshape(-1, NUM_AZIMUTHS).max(axis=0)
        return highest

    def image(self, spectrum: FloatArray) -> FloatArray:
        """Values (D,) as an equirectangular image (36, 72), interpolated.

        Rows are elevations, -87.5, -82.5, ... 87.5 degrees; columns are azimuths, 0, 5, ... 355
        degrees. Directions that the grid does not cover are 0.
        """
        values: FloatArray = self._image_weights @ spectrum
        return values.reshape(IMAGE_SHAPE)

    @cached_property
    def _azimuth_weights(self) -> scipy.sparse.csr_array:
        return self._weights(np.deg2rad(np.arange(-85, 90, 10)), NUM_AZIMUTHS)

    @cached_property
    def _image_weights(self) -> scipy.sparse.csr_array:
        rows, columns = IMAGE_SHAPE
        return self._weights(np.deg2rad((np.arange(rows) + 0.5) * 180 / rows - 90), columns)

    def _weights(self, elevation: FloatArray, num_azimuths: int) -> scipy.sparse.csr_array:
        """(E A, D) shares of the grid's values at E elevations and A azimuths."""
        azimuth = np.arange(num_azimuths) * (2 * np.pi / num_azimuths)
        wanted = unit_vectors(*np.meshgrid(azimuth, elevation)).reshape(-1, 3)
        near, weights = self._nearest(wanted, 6)
        rows = np.repeat(np.arange(len(wanted)), near.shape[1])
        shares = (weights.astype(np.float32).ravel(), (rows, near.ravel()))
        return scipy.sparse.csr_array(shares, shape=(len(wanted), self.size))

    def turned(self, spectra: FloatArray, rotation: FloatArray) -> FloatArray:
        """Spectra (F, D) after a rotation (3, 3), interpolated; 0 where none was known."""
        near, weights = self._nearest(self.vectors @ rotation, 3)
        values: FloatArray = np.einsum("fdk,dk->fd", spectra[:, near], weights.astype(np.float32))
        return values

    def _nearest(self, wanted: FloatArray, count: int) -> tuple[IntArray, FloatArray]:
        """Indices and weights (P, count) of the nearest directions of unit vectors (P, 3)."""
        closeness = wanted @ self.vectors.T
        near = np.argsort(-closeness, axis=1)[:, :count]
        angle = np.arccos(np.clip(np.take_along_axis(closeness, near, axis=1), -1, 1))
        weights = np.exp(-np.square(angle / SMOOTHING) / 2)
        weights /= weights.sum(axis=1, keepdims=True)
        if self.normal is not None:  # the other half has no values
            weights *= (wanted @ self.normal >= -1e-9)[:, None]
        return near, weights

    def peaks(self, spectrum: FloatArray, most: int) -> list[int]:
        """Indices of the largest local maxima of (D,) values, highest first.

        A constant spectrum has none. Of maxima closer than ``MIN_SEPARATION`` only the higher
        one counts.
        """
        around = spectrum[self.neighbours.T]
        highest = (spectrum >= around.max(axis=0)) & (spectrum > around.min(axis=0))
        found = np.flatnonzero(highest)
        kept: list[int] = []
        for index in found[np.argsort(-spectrum[found], kind="stable")].tolist():
            if len(kept) == most:
                break
            near = self.vectors[kept] @ self.vectors[index] > math.cos(MIN_SEPARATION)
            if not near.any():
                kept.append(index)
        return kept

    def vertex(self, spectrum: FloatArray, index: int) -> FloatArray:
        """Unit vector (3,) to a peak's vertex between a direction and its neighbours."""
        if index not in self._paraboloids:
            axes = np.array(tangents(self.vectors[index]))
            places = self.vectors[self.neighbours[index]] @ axes.T
            self._paraboloids[index] = axes, Paraboloid(places)
        axes, paraboloid = self._paraboloids[index]
        place = paraboloid.vertex(spectrum[index], spectrum[self.neighbours[index]])
        return on_sphere(self.vectors[index], axes, place)

    @cached_property
    def _paraboloids(self) -> dict[int, tuple[FloatArray, Paraboloid]]:
        return {}


class Paraboloid:
    """A paraboloid through a value and six around it, as ``parabolic_offset`` in one dimension.

    ``places`` (6, 2) are those of the six values, relative to the first.
    """

    def __init__(self, places: FloatArray) -> None:
        x, y = places.T
        self._coefficients = np.linalg.pinv(np.stack([x, y, x * x, y * y, x * y], axis=1))
        self._most = float(np.hypot(x, y).max()) / 2

    def vertex(self, value: float, around: FloatArray) -> FloatArray:
        """Place (2,) of the vertex, at most half way to the six; 0 where there is none.

        The paraboloid is laid through the reciprocals of the first value and the six (6,).
        """
        rise = 1 / around - 1 / value if around.min() > 0 else value - around
        slope_x, slope_y, xx, yy, xy = (self._coefficients @ rise).tolist()
        determinant = 4 * xx * yy - xy * xy
        if not (xx > 0 and determinant > 0):
            return np.zeros(2)
        x = (xy * slope_y - 2 * yy * slope_x) / determinant
        y = (xy * slope_x - 2 * xx * slope_y) / determinant
        return np.array([x, y]) * min(1.0, self._most / max(math.hypot(x, y), 1e-9))


_PARABOLOID = Paraboloid(HEXAGON)


def climbed(start: FloatArray, values: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Unit vector (3,) to the maximum uphill from a direction (3,), at most four steps away.

    ``values`` gives the values (P,) in P directions (P, 3).
    """
    middle = start
    for _ in range(MOST_MOVES):
        axes = np.array(tangents(middle))
        around = on_sphere(middle, axes, HEXAGON)
        found = values(np.concatenate([middle[None], around]))
        highest = int(found.argmax())
        if highest == 0:
            return on_sphere(middle, axes, _PARABOLOID.vertex(found[0], found[1:]))
        middle = around[highest - 1]
    return middle


@cache
def whole_sphere() -> DirectionGrid:
    """The directions of a geodesic grid: the vertices of a divided icosahedron."""
    return _grid(_icosphere(FREQUENCY))


def half_sphere(normal: FloatArray) -> DirectionGrid:
    """The directions of ``whole_sphere`` on one side of a plane through the origin.

    ``normal`` (3,) points to the side that is kept; directions in the plane belong to it.
    """
    vectors = whole_sphere().vectors
    return replace(_grid(vectors[vectors @ normal >= -1e-9]), normal=normal)


def angle_between(first: FloatArray, second: FloatArray) -> FloatArray:
    """Great-circle angles (...) in radians between unit vectors (..., 3)."""
    # The arc cosine loses half of the digits near 0.
    across = np.linalg.norm(np.cross(first, second), axis=-1)
    return np.asarray(np.arctan2(across, np.sum(first * second, axis=-1)))


def azimuth_elevation(vector: FloatArray) -> tuple[float, float]:
    """Azimuth in [0, 2 pi) and elevation in radians of a vector (3,)."""
    x, y, z = vector.tolist()
    return wrapped(math.atan2(y, x)), math.atan2(z, math.hypot(x, y))


def tangents(vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Two unit vectors square to a direction and to each other: to its left, and upwards."""
    x, y, z = vector.tolist()
    level = math.hypot(x, y)
    east, north = (x / level, y / level) if level > 0 else (1.0, 0.0)
    return np.array([-north, east, 0.0]), np.array([-z * east, -z * north, level])


def on_sphere(vector: FloatArray, axes: FloatArray, place: FloatArray) -> FloatArray:
    """Unit vectors (..., 3) at places (..., 2) in radians along the axes (2, 3) of a direction."""
    along = place @ axes
    angle = np.linalg.norm(place, axis=-1, keepdims=True)
    moved: FloatArray = np.cos(angle) * vector + np.sinc(angle / np.pi) * along
    return moved


def _grid(vectors: FloatArray) -> DirectionGrid:
    closeness = vectors @ vectors.T
    order = np.argsort(-closeness, axis=1)[:, 1:7]
    # Twelve vertices of the icosahedron have five neighbours, those at an edge of a half fewer.
    reach = 1.45 * np.arccos(np.clip(np.sort(closeness, axis=1)[:, -2], -1, 1)).max()
    near = np.take_along_axis(closeness, order, axis=1) >= math.cos(reach)
    own = np.arange(len(vectors))[:, None]
    return DirectionGrid(vectors, np.where(near, order, own))


def _icosphere(frequency: int) -> FloatArray:
    """(D, 3) vertices of a divided icosahedron on the sphere, opposite ones D / 2 apart."""
    golden = (1 + math.sqrt(5)) / 2
    corners = np.array([(0, a, b * golden) for a in (-1, 1) for b in (-1, 1)], dtype=np.float64)
    corners = np.concatenate([np.roll(corners, shift, axis=1) for shift in range(3)])
    corners /= np.linalg.norm(corners, axis=1, keepdims=True)
    edge = np.linalg.norm(corners[:, None] - corners[None], axis=-1)
    adjacent = np.isclose(edge, np.min(edge[edge > 0]))
    points = []
    for i, j, k in np.argwhere(np.ones((12, 12, 12))):
        if i < j < k and adjacent[i, j] and adjacent[j, k] and adjacent[i, k]:
            for a in range(frequency + 1):
                for b in range(frequency + 1 - a):
                    shares = np.array([a, b, frequency - a - b]) / frequency
                    points.append(shares @ corners[[i, j, k]])
    vectors = np.array(points)
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    vectors = vectors[np.unique(np.round(vectors, 9), axis=0, return_index=True)[1]]
    rounded = np.round(vectors, 9)
    # Opposite directions: one of each pair, then the others in the same order.
    first_positive = np.array(
        [next(v for v in row[::-1] if v != 0) > 0 for row in rounded.tolist()]
    )
    half = vectors[first_positive]
    return np.concatenate([half, -half])

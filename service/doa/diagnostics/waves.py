"""Waves that a right array may hear besides plane ones: from nearby, or round a rigid body.

A talker half a metre away sends curved waves, and microphones in a shell hear longer delays than
between the same places in free air. A mistake is named only where neither explains the sound.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.special

from service.doa.array import SPEED_OF_SOUND
from service.doa.diagnostics.cells import Cells
from service.doa.types import ComplexArray, FloatArray

DISTANCES = (0.3, 0.6, 1.2)
"""Distances of near talkers in metres, from the middle of the array"""
STEPS = np.deg2rad([8.0, 4.0, 4.0, 2.0, 1.0])
"""Steps of the ascent to the best direction, radians: the grid on which it begins has gaps of up to
26 degrees"""
AROUND = np.array([[a, b] for a in (-1, 0, 1) for b in (-1, 0, 1)], dtype=np.float64)
COARSE = 108
"""Directions of the whole sphere from which the search round a body sets out"""
ROUND = 0.05  # of the radius: microphones on one sphere miss it by less
ANGLES = 181
"""Angles from the wave's direction, 0 to 180 degrees, at which the sound is tabulated"""
ORDERS = 40
"""Terms of the series: enough for a radius of six wavelengths"""

Waves = Callable[[FloatArray], ComplexArray]
"""From directions (C, K, 3), those of every cell, to the phases (C, K, N) of waves from there"""


def best_fits(
    cells: Cells, vectors: ComplexArray, positions: FloatArray, towards: FloatArray
) -> FloatArray:
    """(B,) fits of every block's best wave of any kind; a body is there in all blocks or in none.

    Parameters
    ----------
    cells : Cells
    vectors : (C, N) complex
        Their vectors, with a suspected mistake undone.
    positions : (N, 3) float
        Metres.
    towards : (B, 3) float
        Unit vectors at which the search begins.
    """
    centred = positions - positions.mean(axis=0)
    free: FloatArray = np.max(
        [
            _ascent(cells, vectors, _near(cells, centred, distance), towards)
            for distance in (np.inf, *DISTANCES)
        ],
        axis=0,
    )
    sphere = sphere_through(positions)
    if sphere is None:
        return free
    waves = _rigid(cells, positions - sphere)
    # Delays round a body lead the search for a plane wave astray.
    rigid = _ascent(cells, vectors, waves, _likeliest(cells, vectors, waves))
    return rigid if rigid.mean() > free.mean() else free


def _ascent(cells: Cells, vectors: ComplexArray, waves: Waves, towards: FloatArray) -> FloatArray:
    """(B,) fits at the maxima uphill from ``towards``."""
    counts = np.bincount(cells.block)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    best = np.zeros(len(towards))
    for step in STEPS:
        directions = _around(towards, step)  # (B, K, 3)
        response = np.abs(np.einsum("cn,ckn->ck", np.conj(vectors), waves(directions[cells.block])))
        fits = np.add.reduceat(response**2, starts, axis=0) / counts[:, None]
        chosen = fits.argmax(axis=1)
        towards = directions[np.arange(len(directions)), chosen]
        best = fits.max(axis=1) / vectors.shape[1] ** 2
    return best


def _likeliest(cells: Cells, vectors: ComplexArray, waves: Waves) -> FloatArray:
    """(B, 3) the best directions of every block on a coarse grid of the sphere."""
    index = np.arange(COARSE) + 0.5
    height, turn = 1 - 2 * index / COARSE, np.pi * (1 + np.sqrt(5)) * index  # a Fibonacci spiral
    level = np.sqrt(1 - height**2)
    grid = np.column_stack([level * np.cos(turn), level * np.sin(turn), height])
    fits = np.zeros((cells.num_blocks, COARSE))
    for first in range(0, COARSE, len(AROUND)):  # in parts: all directions of all cells are large
        part = slice(first, first + len(AROUND))
        phases = waves(np.broadcast_to(grid[part], (cells.block.size, *grid[part].shape)))
        response = np.abs(np.einsum("cn,ckn->ck", np.conj(vectors), phases)) ** 2
        np.add.at(fits[:, part], cells.block, response)
    likeliest: FloatArray = grid[fits.argmax(axis=1)]
    return likeliest


def _around(towards: FloatArray, step: float) -> FloatArray:
    """(B, K, 3) unit vectors, a step around those given, themselves among them."""
    other = np.where(np.abs(towards[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(towards, other)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    tangents = np.stack([first, np.cross(towards, first)], axis=1)  # (B, 2, 3)
    moved = towards[:, None] + np.tan(step) * AROUND @ tangents
    around: FloatArray = moved / np.linalg.norm(moved, axis=-1, keepdims=True)
    return around


def _near(cells: Cells, centred: FloatArray, distance: float) -> Waves:
    """Waves from a distance in metres, on microphones (N, 3) in free air."""
    wavenumber = 2 * np.pi / SPEED_OF_SOUND * cells.frequency[:, None, None]

    def waves(directions: FloatArray) -> ComplexArray:
        nearer = directions @ centred.T
        if np.isfinite(distance):
            squared = (centred**2).sum(axis=-1)
            path = np.sqrt(np.maximum(distance**2 - 2 * distance * nearer + squared, 0.0))
            nearer = distance - path
        phases: ComplexArray = np.exp(1j * wavenumber * nearer)
        return phases

    return waves


def _rigid(cells: Cells, on_sphere: FloatArray) -> Waves:
    """Plane waves round a rigid sphere about the origin, with the microphones (N, 3) on it."""
    radius = float(np.linalg.norm(on_sphere, axis=-1).mean())
    frequencies, bins = np.unique(cells.frequency, return_inverse=True)
    table = sphere_response(2 * np.pi / SPEED_OF_SOUND * frequencies * radius)
    table /= np.abs(table)
    outward = on_sphere / np.linalg.norm(on_sphere, axis=-1, keepdims=True)

    def waves(directions: FloatArray) -> ComplexArray:
        angle = np.arccos(np.clip(directions @ outward.T, -1, 1))
        column = np.rint(angle * ((ANGLES - 1) / np.pi)).astype(int)
        phases: ComplexArray = table[bins[:, None, None], column]
        return phases

    return waves


def sphere_response(size: FloatArray) -> ComplexArray:
    """Sound on a rigid sphere that a plane wave meets, relative to the wave in the middle.

    The series of spherical harmonics with a time factor of exp(i w t) (Williams, *Fourier
    Acoustics*, 1999, chapter 6).

    Parameters
    ----------
    size : (F,) float
        Circumference over wavelength, k a.

    Returns
    -------
    response : (F, ANGLES) complex128
        Column j is at j degrees from the direction that the wave comes from.
    """
    cosine = np.cos(np.linspace(0, np.pi, ANGLES))
    response = np.zeros((len(size), ANGLES), dtype=np.complex128)
    for order in range(ORDERS):
        slope = scipy.special.spherical_jn(order, size, derivative=True)
        with np.errstate(over="ignore"):  # the term is then zero
            slope = slope - 1j * scipy.special.spherical_yn(order, size, derivative=True)
        term = np.nan_to_num(-1j * 1j**order * (2 * order + 1) / (size**2 * slope))
        response += term[:, None] * scipy.special.eval_legendre(order, cosine)
    return response


def sphere_through(positions: FloatArray) -> FloatArray | None:
    """The middle (3,) of a sphere on whose surface all microphones are, or None.

    Microphones in a plane are on its equator. Those on a line are on none.
    """
    middle = positions.mean(axis=0)
    centred = positions - middle
    _, spread, axes = np.linalg.svd(centred)
    rank = int(np.count_nonzero(spread > ROUND * spread[0]))
    if rank < 2:
        return None
    flat = centred @ axes[:rank].T
    # |p - m|^2 = r^2 is linear in m and r^2 - |m|^2.
    system = np.column_stack([2 * flat, np.ones(len(flat))])
    solution, *_ = np.linalg.lstsq(system, (flat**2).sum(axis=-1), rcond=None)
    centre: FloatArray = middle + solution[:rank] @ axes[:rank]
    radius = np.linalg.norm(positions - centre, axis=-1)
    return centre if np.ptp(radius) < ROUND * radius.mean() else None

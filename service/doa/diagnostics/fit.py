"""How well plane waves explain the cells, for the geometry as given and for suspected mistakes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from service.doa.array import SPEED_OF_SOUND
from service.doa.diagnostics.cells import Cells
from service.doa.diagnostics.waves import best_fits
from service.doa.steering import steering_vectors, unit_vectors
from service.doa.types import ComplexArray, FloatArray

AZIMUTH_STEP = np.deg2rad(5.0)
ELEVATIONS = np.arccos([1.0, 0.9, 0.75, 0.6])  # even steps of the delays in a level array
CHUNK = 8  # hypotheses at a time: half a megabyte of responses for a block's cells


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """One possible mistake; the default is no mistake."""

    order: tuple[int, ...]
    """Channel of every microphone"""
    late: tuple[int, ...]
    """Samples by which every microphone's channel is late"""
    scale: float = 1.0
    """Size of the real array against the given one"""


class PlaneWaveFit:
    """Fits one plane wave to every block of cells.

    The fit of a block is the mean over its cells of |u^H a|^2 / N^2 at the best direction: 1 for a
    plane wave, about 1/N for noise.

    Parameters
    ----------
    cells : Cells
    positions : (N, 3) float
        Metres.
    sample_rate : int
        Hertz; ``Hypothesis.late`` counts its samples.
    """

    def __init__(self, cells: Cells, positions: FloatArray, sample_rate: int) -> None:
        self._cells = cells
        self._positions = positions
        self._sample_rate = sample_rate
        level = bool(np.ptp(positions[:, 2]) < 1e-4)
        # Elevations above are enough: a level array cannot tell them from those below.
        elevation = ELEVATIONS if level else np.concatenate([ELEVATIONS, -ELEVATIONS[1:]])
        azimuth = np.arange(0, 2 * np.pi - 1e-9, AZIMUTH_STEP)
        self._azimuth = np.tile(azimuth, elevation.size)
        self._elevation = np.repeat(elevation, azimuth.size)
        self._frequencies, self._bin = np.unique(cells.frequency, return_inverse=True)
        self._given = self._steering(1.0)
        self._counts = np.bincount(cells.block, minlength=cells.num_blocks)
        self._starts = np.concatenate([[0], np.cumsum(self._counts)])  # cells stand block by block

    def scores(self, hypotheses: Sequence[Hypothesis]) -> FloatArray:
        """Fits (H, B) of hypotheses that share one scale."""
        chunks = [hypotheses[i : i + CHUNK] for i in range(0, len(hypotheses), CHUNK)]
        return np.concatenate(
            [self._responses(chunk).max(axis=-1) / self._counts for chunk in chunks]
        )

    def fine_scores(self, hypotheses: Sequence[Hypothesis]) -> FloatArray:
        """Fits (H, B) at the best directions of any, by waves of any kind (``waves``)."""
        return np.array([self._fine(hypothesis) for hypothesis in hypotheses])

    def _fine(self, hypothesis: Hypothesis) -> FloatArray:
        (vectors,) = np.swapaxes(self._undone([hypothesis]), 0, 1)
        positions = self._positions * hypothesis.scale
        return best_fits(self._cells, vectors, positions, self._towards(hypothesis))

    @property
    def redundant(self) -> bool:
        """Whether a direction does not explain any delays between the microphones."""
        centred = self._positions - self._positions.mean(axis=0)
        return bool(len(centred) - 1 > np.linalg.matrix_rank(centred, tol=1e-4))

    def spread(self, hypothesis: Hypothesis) -> float:
        """Spread of the blocks' directions: 0 for a single one, 1 for all around."""
        return 1.0 - float(np.linalg.norm(self._towards(hypothesis).mean(axis=0)))

    def agreement(self, order: tuple[int, ...]) -> FloatArray:
        """(N,) agreement of each microphone with the others under ``order``, up to 1."""
        hypothesis = Hypothesis(order, (0,) * len(order))
        direction = self._towards(hypothesis)[self._cells.block]  # (C, 3)
        centred = self._positions - self._positions.mean(axis=0)
        phase = 2 * np.pi / SPEED_OF_SOUND * self._cells.frequency[:, None] * direction @ centred.T
        aligned = self._cells.vectors[:, order] * np.exp(-1j * phase)  # (C, N)
        others = aligned.sum(axis=-1, keepdims=True) - aligned
        cosine = (aligned * np.conj(others)).real / np.maximum(np.abs(others), 1e-9)
        agreement: FloatArray = cosine.mean(axis=0)
        return agreement

    def _responses(self, hypotheses: Sequence[Hypothesis]) -> FloatArray:
        """(H, B, A) summed responses."""
        cells, microphones = self._cells, self._positions.shape[0]
        scale = hypotheses[0].scale
        steering = self._given if scale == 1.0 else self._steering(scale)
        vectors = self._undone(hypotheses)
        total = np.empty((len(hypotheses), cells.num_blocks, self._azimuth.size), dtype=np.float32)
        for block, (begin, end) in enumerate(pairwise(self._starts)):
            response = np.conj(vectors[begin:end]) @ steering[self._bin[begin:end]]  # (C', H, A)
            # Square in place and sum before joining the parts: fresh memory costs most.
            parts = response.view(np.float32)
            np.square(parts, out=parts)
            sums = np.add.reduce(parts, axis=0)  # (H, 2A)
            np.add(sums[:, 0::2], sums[:, 1::2], out=total[:, block])
        total /= np.float32(microphones**2)
        return total

    def _towards(self, hypothesis: Hypothesis) -> FloatArray:
        """(B, 3) unit vectors to every block's best direction on the grid."""
        best = self._responses([hypothesis])[0].argmax(axis=-1)
        return unit_vectors(self._azimuth[best], self._elevation[best])

    def _undone(self, hypotheses: Sequence[Hypothesis]) -> ComplexArray:
        """(C, H, N) the cells' vectors with wrong orders and delays undone."""
        order = np.array([hypothesis.order for hypothesis in hypotheses])
        late = np.array([hypothesis.late for hypothesis in hypotheses]) / self._sample_rate
        undone = np.exp(2j * np.pi * self._cells.frequency[:, None, None] * late)
        vectors: ComplexArray = self._cells.vectors[:, order] * undone.astype(np.complex64)
        return vectors

    def _steering(self, scale: float) -> ComplexArray:
        return steering_vectors(
            self._positions * scale, self._frequencies, self._azimuth, elevation=self._elevation
        )

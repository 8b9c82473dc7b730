"""Time-frequency cells in which one direct sound begins: the evidence of the geometry.

Over a few frames the channel vector of a cell with one source keeps its direction, so the block of
vectors X (N, K) has rank one. The K x K Gram matrix X^H X shows it: it has the nonzero eigenvalues
of X X^H and stays small for any number of microphones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.doa.stft import Stft
from service.doa.types import ComplexArray, FloatArray, IntArray

FRAME_S = 0.032
MIN_FREQUENCY = 300.0  # Hz; below, neighbouring microphones of small arrays hear the same phase
MAX_FREQUENCY = 4000.0  # Hz; above, speech is weak and positions are known too coarsely
BLOCK_FRAMES = 3  # 64 ms: an onset, before many reflections have arrived
PURITY = 0.66  # sum of squared eigenvalues over squared sum: 1 for one source, 1/3 for noise
ONSET = 3.0
"""Least ratio of the power to the previous block's: sound that has just begun is direct, sound that
goes on is mixed with its reflections. The rule removes most effects of reverberation on the fits"""
MAX_BLOCKS = 100
BLOCK_CELLS = 24
MIN_BLOCK_CELLS = 6  # fewer cells fit nearly any direction
MIN_BLOCKS = 8  # fewer give no statistics


@dataclass(frozen=True, slots=True)
class Cells:
    """C cells of B blocks of time."""

    frequency: FloatArray
    """(C,) hertz"""
    block: IntArray
    """(C,) index of the block, 0 to B - 1"""
    vectors: ComplexArray
    """(C, N) complex64 of modulus 1, since gains of microphones differ and only delays count"""

    @property
    def num_blocks(self) -> int:
        return int(self.block[-1]) + 1 if self.block.size else 0

    @property
    def enough(self) -> bool:
        return self.num_blocks >= MIN_BLOCKS


@dataclass(frozen=True, slots=True)
class _Block:
    power: float
    frequency: FloatArray
    """(C,) hertz"""
    frames: ComplexArray
    """(C, N, K) frames of the cells"""
    gram: ComplexArray
    """(C, K, K) Gram matrices of the cells"""


def direct_cells(
    segments: Sequence[FloatArray],
    sample_rate: int,
    max_frequency: float,
    max_blocks: int = MAX_BLOCKS,
) -> Cells:
    """The strongest single-source cells of an excerpt.

    Parameters
    ----------
    segments : list of (N, T) float32
    sample_rate : int
        Hertz.
    max_frequency : float
        Hertz; bounded by ``MAX_FREQUENCY``.

    Returns
    -------
    cells : Cells
        At most ``max_blocks * BLOCK_CELLS``; empty where no direct sound is heard.
    """
    n_fft = 1 << round(np.log2(FRAME_S * sample_rate))
    stft = Stft(sample_rate, n_fft, n_fft // 2)
    band = (stft.frequencies >= MIN_FREQUENCY) & (
        stft.frequencies <= min(max_frequency, MAX_FREQUENCY)
    )
    blocks: list[_Block] = []
    for segment in segments:
        if segment.shape[-1] >= stft.num_samples(BLOCK_FRAMES):
            spectra = stft.transform(segment)[:, band]
            blocks += _segment_blocks(spectra, stft.frequencies[band])
    blocks = sorted(blocks, key=lambda block: -block.power)[:max_blocks]
    if not blocks:
        microphones = segments[0].shape[0] if segments else 0
        return Cells(np.zeros(0), np.zeros(0, dtype=int), np.zeros((0, microphones), np.complex64))
    return Cells(
        np.concatenate([block.frequency for block in blocks]),
        np.concatenate([np.full(b.frequency.size, index) for index, b in enumerate(blocks)]),
        _principal(
            np.concatenate([block.frames for block in blocks]),
            np.concatenate([block.gram for block in blocks]),
        ),
    )


def _segment_blocks(spectra: ComplexArray, frequencies: FloatArray) -> list[_Block]:
    """Blocks of one segment's spectra (N, F, L) with their strongest onsets."""
    microphones, bins, frames = spectra.shape
    count = frames // BLOCK_FRAMES
    blocks = spectra[..., : count * BLOCK_FRAMES].reshape(microphones, bins, count, BLOCK_FRAMES)
    blocks = np.ascontiguousarray(blocks.transpose(2, 1, 0, 3))  # (blocks, F, N, K)
    gram = np.conj(np.swapaxes(blocks, -1, -2)) @ blocks  # (blocks, F, K, K)
    power = np.trace(gram, axis1=-2, axis2=-1).real
    squared = np.sum(gram.real**2 + gram.imag**2, axis=(-2, -1))
    pure = squared >= PURITY * np.maximum(power, np.finfo(np.float32).tiny) ** 2
    begins = np.zeros_like(pure)
    begins[1:] = power[1:] > ONSET * power[:-1]
    strength = np.where(pure & begins, power, 0.0)
    found = []
    for index in range(1, count):
        chosen = np.argsort(-strength[index])[:BLOCK_CELLS]
        chosen = chosen[strength[index, chosen] > 0]
        if chosen.size >= MIN_BLOCK_CELLS:
            power_of_all = float(strength[index].sum())
            own = blocks[index, chosen], gram[index, chosen]
            found.append(_Block(power_of_all, frequencies[chosen], *own))
    return found


def _principal(frames: ComplexArray, gram: ComplexArray) -> ComplexArray:
    """Phases (C, N) of the principal left singular vectors of frames (C, N, K)."""
    _, vectors = np.linalg.eigh(gram)
    left = (frames @ vectors[..., -1:])[..., 0]
    phases: ComplexArray = left / np.maximum(np.abs(left), np.finfo(np.float32).tiny)
    return phases.astype(np.complex64)

"""The `weights` variant over a stream: every frame passes the STFT and the network once.

Time is cut into the same blocks of 8 frames as in a window. A block's covariances, eigenvectors and
spectra are kept once its frames are final, so that a result costs the network on the new frames
and the covariance, EVD and MUSIC of the one or two blocks that are still open and of the sum.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.covariance import diagonal_loading, weighted_covariance
from service.doa.features import coherence_features
from service.doa.types import ComplexArray, FloatArray
from service.doa.whitening import NoiseCovariance
from service.inference.bundle import Bundle
from service.inference.candidates import Candidates
from service.inference.engine import Engine
from service.inference.results import WindowEstimate
from service.inference.weights import (
    BLOCK_FRAMES,
    CELL_LOADING,
    CandidateSearch,
    SourceCounter,
    analysis_of,
    principal_eigenvectors,
)

CONTEXT_FRAMES = 8
"""Frames before the new ones that the network's first convolutions see again"""
LOOKAHEAD_FRAMES = 4
"""Newest frames whose weights the next step gives again, having seen what follows"""
FEATURE_REACH = 2
"""Frames that the features look back"""
LEVEL_FRAMES = 64
"""A second, over which levels are relative to the mean: the network's training window"""
GRID_SIZE = 180
"""Azimuths of a stream's spectra, half of a recording's: peaks are wider than 2 degrees, and the
parabola through three angles does the rest"""
PAIRED_APERTURE = 0.3
"""Metres; over smaller arrays the phase differs by less than 10 degrees between neighbouring bins,
so that two of them can share one covariance: 18 % less to compute, the errors 0.1 degrees larger"""
RECENCY = (1.0, 1.0, 1.0, 0.6, 0.3)
"""What the blocks of a result count, newest first; 0.51 to 0.66 s with the open ones. Counting all
five alike finds two who stand 1 % more often and follows one who walks 1.4 degrees worse; four
blocks follow better still, but take the onset of sensor noise for a talker"""
WINDOW_BLOCKS = len(RECENCY)


class NetworkStream:
    """The covariance network over a stream of spectra, with its state.

    Parameters
    ----------
    engine : Engine
        Of the graph ``covariance_stream.onnx``.
    num_microphones, num_bins : int
    """

    def __init__(self, engine: Engine, num_microphones: int, num_bins: int) -> None:
        self._engine = engine
        kept = CONTEXT_FRAMES + FEATURE_REACH
        self._spectra = np.zeros((num_microphones, num_bins, kept), dtype=np.complex64)
        self._power: deque[float] = deque(maxlen=LEVEL_FRAMES)
        self._state = engine.initial_state()

    def push(self, spectra: ComplexArray) -> tuple[FloatArray, FloatArray]:
        """Weights and attentions (F, 4 + L) of the four frames before ``spectra`` (N, F, L) and it.

        The last four columns are provisional.
        """
        power = np.sum(spectra.real**2 + spectra.imag**2, axis=0).mean(axis=0)
        self._power.extend(power.tolist())
        mean = np.array([sum(self._power) / len(self._power)], dtype=np.float32)
        joined = np.concatenate([self._spectra, spectra], axis=-1)
        self._spectra = joined[..., -(CONTEXT_FRAMES + FEATURE_REACH) :]
        features = coherence_features(joined[None], mean)[..., FEATURE_REACH:]
        weights, attention, *self._state = self._engine.run([features, *self._state])
        return weights[0], attention[0]


@dataclass(frozen=True, slots=True)
class _Block:
    """Eight frames, or the fewer that an open one has."""

    covariance: ComplexArray
    """(F, N, N), F bins or pairs of them"""
    attention: FloatArray
    """(F,) a mean over eight frames, those that are missing being zero"""
    cells: FloatArray
    """(F, A) MUSIC spectra"""
    dominance: FloatArray
    """(F,)"""


class WeightsStream:
    """One stream of one array's spectra, with a `weights` bundle that has a stream graph."""

    window_frames = WINDOW_BLOCKS * BLOCK_FRAMES

    def __init__(
        self, bundle: Bundle, array: MicrophoneArray, noise: NoiseCovariance | None = None
    ) -> None:
        assert bundle.covariance_stream is not None
        paired = noise is None and array.aperture <= PAIRED_APERTURE
        analysis = replace(
            analysis_of(bundle), grid_size=GRID_SIZE, bins_per_cell=2 if paired else 1
        )
        self._bins_per_cell = analysis.bins_per_cell
        self._search = CandidateSearch(bundle.covariance, analysis, array, noise)
        self._counter = SourceCounter(bundle.source_count)
        self._network = NetworkStream(
            bundle.covariance_stream, array.num_microphones, analysis.num_bins
        )
        self._closed: deque[_Block] = deque(maxlen=WINDOW_BLOCKS)
        shape = (analysis.num_bins, 0)
        self._open = np.zeros((array.num_microphones, *shape), dtype=np.complex64)
        self._weights = np.zeros(shape, dtype=np.float32)
        self._attention = np.zeros(shape, dtype=np.float32)

    def push(self, spectra: ComplexArray) -> None:
        """Take the next frames (N, F, L) of all the STFT's bins, L at least 1."""
        band = self._search.band(spectra)
        weights, attention = self._network.push(band)
        known = max(self._open.shape[-1] - LOOKAHEAD_FRAMES, 0)
        new = self._open.shape[-1] + band.shape[-1] - known
        self._weights = np.concatenate([self._weights[:, :known], weights[:, -new:]], axis=1)
        self._attention = np.concatenate([self._attention[:, :known], attention[:, -new:]], axis=1)
        self._open = np.concatenate([self._open, band], axis=-1)
        while self._open.shape[-1] >= BLOCK_FRAMES + LOOKAHEAD_FRAMES:
            self._closed.append(self._block(slice(0, BLOCK_FRAMES)))
            self._open = self._open[..., BLOCK_FRAMES:]
            self._weights = self._weights[:, BLOCK_FRAMES:]
            self._attention = self._attention[:, BLOCK_FRAMES:]

    def estimate(self, num_sources: int | None, max_sources: int) -> WindowEstimate:
        """Directions of the last blocks; at least one frame must have been pushed."""
        starts = range(0, self._open.shape[-1], BLOCK_FRAMES)
        opened = [self._block(slice(start, start + BLOCK_FRAMES)) for start in starts]
        blocks = [*self._closed, *opened][-WINDOW_BLOCKS:]
        return self._counter.select([self._candidates(blocks)], num_sources, max_sources)[0]

    def _block(self, frames: slice) -> _Block:
        spectra, weights = self._open[..., frames], self._weights[:, frames]
        covariance = weighted_covariance(spectra, weights, spectra.shape[-1])
        attention = self._attention[:, frames].sum(axis=1) / np.float32(BLOCK_FRAMES)
        if self._bins_per_cell > 1:
            covariance = covariance[0::2] + covariance[1::2]
            attention = (attention[0::2] + attention[1::2]) / np.float32(2)
        loaded = diagonal_loading(covariance, CELL_LOADING)
        cells, dominance = self._spectrum(loaded)
        return _Block(loaded[:, 0], attention, cells, dominance)

    def _spectrum(self, covariance: ComplexArray) -> tuple[FloatArray, FloatArray]:
        """MUSIC spectra (F, A) and dominance (F,) of covariances (F, 1, N, N)."""
        principal, dominance = principal_eigenvectors(covariance)
        return self._search.cell_spectra(principal)[:, 0], dominance[:, 0]

    def _candidates(self, blocks: Sequence[_Block]) -> Candidates:
        recency = np.array(RECENCY[: len(blocks)][::-1], dtype=np.float32)
        pairs = list(zip(blocks, recency, strict=True))
        whole = np.sum([block.covariance * counts for block, counts in pairs], axis=0)
        cells, dominance = self._spectrum(whole[:, None])
        return self._search.found(
            np.stack([*(block.cells for block in blocks), cells], axis=1),
            np.stack([block.attention * counts for block, counts in pairs], axis=1),
            np.stack([*(block.dominance for block in blocks), dominance], axis=1),
        )

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
from service.doa.features import coherence_features, unit_vectors_and_power
from service.doa.types import ComplexArray, FloatArray
from service.doa.whitening import NoiseCovariance
from service.inference.bundle import Bundle
from service.inference.candidates import Candidates, find_candidates
from service.inference.engine import Engine
from service.inference.results import WindowEstimate
from service.inference.weights import (
    BLOCK_FRAMES,
    CELL_LOADING,
    SMALL_APERTURE,
    CandidateSearch,
    SourceCounter,
    analysis_of,
    principal_eigenvectors,
)

FEATURE_REACH = 2
"""Frames that the features look back"""
LEVEL_FRAMES = 64
"""A second, over which levels are relative to the mean: the network's training window"""


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
        self._unit = np.zeros((num_microphones, num_bins, FEATURE_REACH), dtype=np.complex64)
        self._frame_power = np.zeros((num_bins, FEATURE_REACH), dtype=np.float32)
        self._means: deque[float] = deque(maxlen=LEVEL_FRAMES)
        self._state = engine.initial_state()

    def push(self, unit: ComplexArray, power: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weights and attentions of the newest frames, after (N, F, L) and (F, L) new ones.

        Both are (P + L, F): the P frames before the new ones were provisional and are final now;
        the newest P are provisional, since the network looks as far ahead.
        """
        # Digital silence says nothing of the level of what follows: a microphone was not on yet.
        self._means.extend(mean for mean in power.mean(axis=0).tolist() if mean > 0)
        mean = np.array(sum(self._means) / max(len(self._means), 1), dtype=np.float32)
        unit = np.concatenate([self._unit, unit], axis=2)
        power = np.concatenate([self._frame_power, power], axis=1)
        self._unit, self._frame_power = (
            unit[..., -FEATURE_REACH:].copy(),
            power[:, -FEATURE_REACH:].copy(),
        )
        features = coherence_features(unit, power, mean)[None, ..., FEATURE_REACH:]
        weights, attention, *self._state = self._engine.run(
            [np.swapaxes(features, 2, 3), *self._state]
        )
        return weights[0], attention[0]


@dataclass(slots=True)
class _Block:
    """Eight frames, or the fewer that an open one has."""

    covariance: ComplexArray
    """(1, F, N, N), F bins or pairs of them"""
    attention: FloatArray
    """(F,) a mean over eight frames, those that are missing being zero"""
    place: int
    """Among the stream's spectra; taken again once the block is out of the window"""
    dominance: FloatArray | None = None
    """(F,) once a result has needed it and the spectra"""


class WeightsStream:
    """One stream of one array's spectra, with a `weights` bundle that has a stream graph."""

    window_frames = WINDOW_BLOCKS * BLOCK_FRAMES

    def __init__(
        self, bundle: Bundle, array: MicrophoneArray, noise: NoiseCovariance | None = None
    ) -> None:
        assert bundle.covariance_stream is not None
        # Over a small array the phase differs by less than 10 degrees between neighbouring bins, so
        # that two can share one covariance: 18 % less to compute, errors 0.1 degrees larger.
        paired = noise is None and array.aperture <= SMALL_APERTURE
        analysis = replace(analysis_of(bundle), bins_per_cell=2 if paired else 1)
        self._bins_per_cell = analysis.bins_per_cell
        self._search = CandidateSearch(bundle.covariance, analysis, array, noise)
        # Found again, directions of who walks follow him worse: older blocks have their say.
        self._counter = SourceCounter(bundle.source_count, together=False)
        self._network = NetworkStream(
            bundle.covariance_stream, array.num_microphones, analysis.num_bins
        )
        self._closed: deque[_Block] = deque(maxlen=WINDOW_BLOCKS)
        self._passed = 0
        """Blocks that are final, those included that are forgotten"""
        self._cells: FloatArray = np.empty((0, 0, 0), dtype=np.float32)
        """(F, blocks and the whole window, A) MUSIC spectra, from the first result on. They stay
        where they are: copied together for every result they would pass through memory each time"""
        empty = (0, analysis.num_bins)
        self._open = np.zeros((array.num_microphones, *empty), dtype=np.complex64)
        """(N, L, F) of unit norm: frames of blocks that are not final"""
        self._weights = np.zeros(empty, dtype=np.float32)
        self._attention = np.zeros(empty, dtype=np.float32)

    def push(self, spectra: ComplexArray) -> None:
        """Take the next frames (N, F, L) of all the STFT's bins, L at least 1."""
        unit, power = unit_vectors_and_power(self._search.band(spectra))
        weights, attention = self._network.push(unit, power)
        provisional = len(weights) - unit.shape[2]
        known = max(len(self._weights) - provisional, 0)
        self._open = np.concatenate([self._open, np.swapaxes(unit, 1, 2)], axis=1)
        new = known - self._open.shape[1]  # before the stream's first frame there is nothing
        self._weights = np.concatenate([self._weights[:known], weights[new:]])
        self._attention = np.concatenate([self._attention[:known], attention[new:]])
        while len(self._weights) >= BLOCK_FRAMES + provisional:
            self._closed.append(self._block(0))
            self._passed += 1
            self._open = self._open[:, BLOCK_FRAMES:]
            self._weights = self._weights[BLOCK_FRAMES:]
            self._attention = self._attention[BLOCK_FRAMES:]

    def estimate(self, num_sources: int | None, max_sources: int) -> WindowEstimate:
        """Directions of the last blocks; at least one frame must have been pushed."""
        opened = [self._block(n) for n in range(-(-len(self._weights) // BLOCK_FRAMES))]
        blocks = [*self._closed, *opened][-WINDOW_BLOCKS:]
        return self._counter.sources(self._candidates(blocks), num_sources, max_sources)

    def _block(self, number: int) -> _Block:
        """One of the open frames' blocks, counted from the oldest."""
        frames = slice(number * BLOCK_FRAMES, (number + 1) * BLOCK_FRAMES)
        unit, weights = np.swapaxes(self._open[:, frames], 1, 2), self._weights[frames]
        covariance = weighted_covariance(unit, weights.T, len(weights))
        attention = self._attention[frames].sum(axis=0) / np.float32(BLOCK_FRAMES)
        if self._bins_per_cell > 1:
            covariance = covariance[:, 0::2] + covariance[:, 1::2]
            attention = (attention[0::2] + attention[1::2]) / np.float32(2)
        place = (self._passed + number) % WINDOW_BLOCKS
        return _Block(diagonal_loading(covariance, CELL_LOADING), attention, place)

    def _candidates(self, blocks: Sequence[_Block]) -> Candidates:
        recency = np.array(RECENCY[: len(blocks)][::-1], dtype=np.float32)
        attention = np.stack([block.attention for block in blocks]) * recency[:, None]
        covariances = [b.covariance * r for b, r in zip(blocks, recency, strict=True)]
        whole = _Block(np.sum(covariances, axis=0), np.empty(0, np.float32), WINDOW_BLOCKS)
        self._complete([row for row in (*blocks, whole) if row.dominance is None])
        order = sorted(range(len(blocks)), key=lambda number: blocks[number].place)
        rows = [*(blocks[number] for number in order), whole]
        dominance = np.stack([row.dominance for row in rows if row.dominance is not None])
        every = len(rows) == self._cells.shape[1]
        cells = self._cells if every else self._cells[:, [row.place for row in rows]]
        chosen = np.broadcast_to(np.array(order)[:, None], attention.shape)
        return find_candidates(self._search.field(cells, attention, chosen, dominance))

    def _complete(self, blocks: Sequence[_Block]) -> None:
        """Spectra and dominance of blocks, all at once: small operations cost their calls."""
        principal, dominance = principal_eigenvectors(
            np.concatenate([block.covariance for block in blocks])
        )
        cells = self._search.cell_spectra(principal)  # (F, blocks, A)
        if not self._cells.size:
            self._cells = np.empty((len(cells), WINDOW_BLOCKS + 1, cells.shape[2]), np.float32)
        self._cells[:, [block.place for block in blocks]] = cells
        for block, share in zip(blocks, dominance, strict=True):
            block.dominance = share

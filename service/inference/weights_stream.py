"""The `weights` variant over a stream: every frame passes the STFT and the network once.

Time is cut into blocks of 8 frames, as in a window. A block's covariances, eigenvectors and spectra
are kept once its frames are final (``service/inference/recent_blocks.py``). A result costs the
network on the new frames, and covariance, EVD and MUSIC of the one or two open blocks and of the
sum.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import TypeVar

import numpy as np

from neuralmusic.protocol.methods import Hemisphere
from service.doa.array import MicrophoneArray
from service.doa.covariance import diagonal_loading, weighted_covariance
from service.doa.features import coherence_features, unit_vectors_and_power
from service.doa.types import ComplexArray, FloatArray
from service.doa.whitening import NoiseCovariance
from service.inference.bundle import Bundle
from service.inference.engine import Engine
from service.inference.recent_blocks import WINDOW_BLOCKS, Headings, RecentBlocks
from service.inference.results import WindowEstimate
from service.inference.source_counter import SourceCounter
from service.inference.weights import (
    BLOCK_FRAMES,
    CELL_LOADING,
    SMALL_APERTURE,
    CandidateSearch,
    analysis_of,
)

FEATURE_REACH = 2
"""Previous frames that the features need"""
LEVEL_FRAMES = 64
"""Frames over which levels are relative to the mean: a second, the network's training window"""


AnyFloats = TypeVar("AnyFloats", FloatArray, ComplexArray)


class NetworkStream:
    """The covariance network over a stream of spectra, with its state.

    Parameters
    ----------
    engine : Engine
        The graph ``covariance_stream.onnx``.
    num_microphones, num_bins : int
    """

    def __init__(self, engine: Engine, num_microphones: int, num_bins: int) -> None:
        self._engine = engine
        self._unit = np.zeros((num_microphones, num_bins, FEATURE_REACH), dtype=np.complex64)
        self._frame_power = np.zeros((num_bins, FEATURE_REACH), dtype=np.float32)
        self._means: deque[float] = deque(maxlen=LEVEL_FRAMES)
        self._state = engine.initial_state()

    def push(self, unit: ComplexArray, power: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Take L new frames (N, F, L) and (F, L); return weights and attentions of the newest ones.

        Both are (P + L, F). The P frames before the new ones were provisional and are now final;
        the newest P are provisional, because the network looks as far ahead.
        """
        # Digital silence tells nothing about the level to come: the microphone was not on yet.
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


class WeightsStream:
    """One stream of one array's spectra, with a `weights` bundle that has a stream graph."""

    window_frames = WINDOW_BLOCKS * BLOCK_FRAMES

    def __init__(
        self,
        bundle: Bundle,
        array: MicrophoneArray,
        noise: NoiseCovariance | None = None,
        hemisphere: Hemisphere = "both",
    ) -> None:
        assert bundle.covariance_stream is not None
        # Over a small array the phases of neighbouring bins differ by less than 10 degrees, so two
        # bins can share one covariance: 18 % less to compute, errors 0.1 degrees larger.
        paired = noise is None and array.aperture <= SMALL_APERTURE
        analysis = replace(analysis_of(bundle), bins_per_cell=2 if paired else 1)
        self._bins_per_cell = analysis.bins_per_cell
        self._search = CandidateSearch(bundle.covariance, analysis, array, noise, hemisphere)
        self.nothing = self._search.nothing
        # Refined directions follow a walking talker worse, because older blocks count more.
        self._counter = SourceCounter(bundle.source_count, together=False)
        self._network = NetworkStream(
            bundle.covariance_stream, array.num_microphones, analysis.num_bins
        )
        self._blocks = RecentBlocks(self._search)
        self._frames = 0
        """Frames of blocks that are not final; in the arrays zeros fill up the last block"""
        self._passed = 0
        """Number of frames in blocks that are final"""
        self._provisional = 0
        """Number of provisional frames, the newest ones"""
        self._unit = np.zeros((array.num_microphones, 0, analysis.num_bins), dtype=np.complex64)
        """(N, L, F) unit vectors"""
        self._weights = np.zeros((0, analysis.num_bins), dtype=np.float32)
        self._attention = self._weights

    def push(self, spectra: ComplexArray) -> None:
        """Take the next frames (N, F, L) of all STFT bins, L at least 1."""
        if self._frames - self._provisional >= BLOCK_FRAMES:  # no result was requested
            self._form_blocks()
        unit, power = unit_vectors_and_power(self._search.band(spectra))
        weights, attention = self._network.push(unit, power)
        before, self._frames = self._frames, self._frames + unit.shape[2]
        self._provisional = min(len(weights) - unit.shape[2], self._frames)
        known = max(before - self._provisional, 0)
        new = known - self._frames  # before the stream's first frame there is nothing
        length = -(-self._frames // BLOCK_FRAMES) * BLOCK_FRAMES
        self._unit = _extended(self._unit, before, np.swapaxes(unit, 1, 2), length)
        self._weights = _extended(self._weights, known, weights[new:], length)
        self._attention = _extended(self._attention, known, attention[new:], length)

    def estimate(
        self, num_sources: int | None, max_sources: int, headings: Headings | None = None
    ) -> WindowEstimate:
        """Directions of the last blocks; at least one frame must have been pushed.

        With ``headings`` they are in the frame that the array had in the newest block.
        """
        self._form_blocks()
        candidates, heading = self._blocks.candidates(headings)
        estimate = self._counter.sources(candidates, num_sources, max_sources)
        return estimate if heading is None else replace(estimate, heading=heading)

    def _form_blocks(self) -> None:
        """Form covariances and attentions of all frames; final blocks' frames are then dropped."""
        covariance = weighted_covariance(
            np.swapaxes(self._unit, 1, 2), self._weights.T, BLOCK_FRAMES
        )
        frames = self._attention.reshape(len(covariance), BLOCK_FRAMES, -1)
        attention = frames.sum(axis=1) / np.float32(BLOCK_FRAMES)
        if self._bins_per_cell > 1:
            covariance = covariance[:, 0::2] + covariance[:, 1::2]
            attention = (attention[:, 0::2] + attention[:, 1::2]) / np.float32(2)
        final = (self._frames - self._provisional) // BLOCK_FRAMES
        centres = self._passed + _centres(self._weights)
        self._blocks.put(
            diagonal_loading(covariance, CELL_LOADING), attention, centres.tolist(), final
        )
        passed = final * BLOCK_FRAMES
        self._passed += passed
        self._frames -= passed
        self._unit = self._unit[:, passed:]
        self._weights, self._attention = self._weights[passed:], self._attention[passed:]


def _centres(weights: FloatArray) -> FloatArray:
    """The frames about which the blocks' weights (L, F) lie, counted from the first."""
    by_frame = weights.sum(axis=1).reshape(-1, BLOCK_FRAMES) + 1e-6
    frames = np.arange(len(weights)).reshape(-1, BLOCK_FRAMES)
    middles: FloatArray = (by_frame * frames).sum(axis=1) / by_frame.sum(axis=1)
    return middles


def _extended(kept: AnyFloats, count: int, new: AnyFloats, length: int) -> AnyFloats:
    """The first ``count`` frames (..., count, F), the new ones and zeros up to ``length``."""
    frames = np.zeros((*kept.shape[:-2], length, kept.shape[-1]), dtype=kept.dtype)
    frames[..., :count, :] = kept[..., :count, :]
    frames[..., count : count + new.shape[-2], :] = new
    return frames

"""Localizing a stream: new frames in, an estimate of the latest half second out.

Task: the work of ``Localizer`` on overlapping windows, without computing anything twice.

Kinds
-----
WeightsStream : a `weights` bundle; network, covariances and spectra are updated.
ClassicalStream : MUSIC, NormMUSIC, SRP-PHAT; sums of outer products are updated.
WindowStream : a `regression` bundle, whose network takes whole windows: spectra are kept, the
    network runs on all of them at every result.
"""

from __future__ import annotations

from collections import deque
from typing import Protocol

import numpy as np

from neuralmusic.errors import InvalidOption
from neuralmusic.protocol.methods import Hemisphere, Method
from service.doa.array import MicrophoneArray
from service.doa.stft import Stft
from service.doa.types import ComplexArray
from service.doa.whitening import NoiseCovariance
from service.inference.bundle import COVARIANCE_STREAM, Bundle
from service.inference.classical import ClassicalLocalizer
from service.inference.localizer import localizer_of
from service.inference.recent_blocks import WINDOW_BLOCKS
from service.inference.regression import RegressionLocalizer
from service.inference.results import WindowEstimate
from service.inference.weights import BLOCK_FRAMES
from service.inference.weights_stream import WeightsStream


class StreamLocalizer(Protocol):
    """One stream of one array; not safe to call from two threads at a time."""

    window_frames: int
    """Most frames behind an estimate"""
    nothing: WindowEstimate
    """Its estimate of silence"""

    def push(self, spectra: ComplexArray) -> None:
        """Take the next frames (N, F, L) of all STFT bins, L at least 1."""
        ...

    def estimate(self, num_sources: int | None, max_sources: int) -> WindowEstimate:
        """Directions of the latest frames; at least one must have been pushed."""
        ...


class ClassicalStream:
    """A classical method on covariances that are summed block by block."""

    window_frames = WINDOW_BLOCKS * BLOCK_FRAMES

    def __init__(self, localizer: ClassicalLocalizer) -> None:
        self._localizer = localizer
        self.nothing = localizer.nothing
        self._blocks: deque[tuple[ComplexArray, int]] = deque(maxlen=WINDOW_BLOCKS)
        """Sums over up to eight frames, and the numbers of frames"""

    def push(self, spectra: ComplexArray) -> None:
        while spectra.shape[-1]:
            if not self._blocks or self._blocks[-1][1] == BLOCK_FRAMES:
                self._blocks.append((np.zeros((1, 1, 1), np.complex64), 0))
            total, frames = self._blocks.pop()
            taken = spectra[..., : BLOCK_FRAMES - frames]
            added = self._localizer.covariance(taken) * np.float32(taken.shape[-1])
            self._blocks.append((total + added, frames + taken.shape[-1]))
            spectra = spectra[..., taken.shape[-1] :]

    def estimate(self, num_sources: int | None, max_sources: int) -> WindowEstimate:
        frames = sum(count for _, count in self._blocks)
        covariance = np.sum([total for total, _ in self._blocks], axis=0) / np.float32(frames)
        return self._localizer.localize(covariance, num_sources, max_sources)


class WindowStream:
    """A network that takes whole windows."""

    def __init__(self, localizer: RegressionLocalizer, window_frames: int) -> None:
        self._localizer = localizer
        self.nothing = localizer.nothing
        self._spectra: ComplexArray | None = None
        self.window_frames = window_frames

    def push(self, spectra: ComplexArray) -> None:
        kept = spectra if self._spectra is None else np.concatenate([self._spectra, spectra], -1)
        self._spectra = kept[..., -self.window_frames :]

    def estimate(self, num_sources: int | None, max_sources: int) -> WindowEstimate:
        assert self._spectra is not None
        return self._localizer.localize(self._spectra[None], num_sources, max_sources)[0]


def stream_localizer_of(
    method: Method,
    bundle: Bundle | None,
    array: MicrophoneArray,
    stft: Stft,
    noise: NoiseCovariance | None = None,
    hemisphere: Hemisphere = "both",
) -> StreamLocalizer:
    """The localizer of a method for a stream; ``bundle`` is None for the classical ones.

    Raises
    ------
    InvalidOption
        If the bundle cannot stream, or cannot take whitened spectra.
    NoiseMismatch
        If the noise was learnt with another array or other frames.
    """
    if bundle is None:
        return ClassicalStream(ClassicalLocalizer(method, array, stft, noise, hemisphere))
    if bundle.covariance_stream is not None:
        return WeightsStream(bundle, array, noise, hemisphere)
    if bundle.manifest.variant == "regression":
        localizer = localizer_of(bundle, array, noise)
        assert isinstance(localizer, RegressionLocalizer)
        return WindowStream(localizer, bundle.manifest.stft.frames)
    raise InvalidOption(
        f"model {bundle.manifest.name} cannot stream: it was exported without "
        f"{COVARIANCE_STREAM}; export it again, or choose another model"
    )

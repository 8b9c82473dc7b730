"""Localizing a stream: new frames in, an estimate of the latest half second out.

Task: the work of ``Localizer`` on overlapping windows, without computing anything twice.

Kinds
-----
WeightsStream : a `weights` bundle; network, covariances and spectra are updated.
ClassicalStream : the classical methods; sums of outer products are updated.
WindowStream : a `regression` bundle, whose network takes whole windows: spectra are kept, the
    network runs on all of them at every result.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from itertools import compress
from typing import Protocol

import numpy as np

from neuralmusic.errors import InvalidOption
from neuralmusic.protocol.methods import Hemisphere, Method
from service.doa.array import MicrophoneArray
from service.doa.pose import Rotation, mean_rotation
from service.doa.stft import Stft
from service.doa.types import ComplexArray
from service.doa.whitening import NoiseCovariance
from service.inference.bundle import COVARIANCE_STREAM, Bundle
from service.inference.classical import ClassicalLocalizer
from service.inference.localizer import localizer_of
from service.inference.recent_blocks import WINDOW_BLOCKS, Headings
from service.inference.regression import RegressionLocalizer
from service.inference.results import WindowEstimate
from service.inference.weights import BLOCK_FRAMES
from service.inference.weights_stream import WeightsStream

ALIKE = np.deg2rad(6.0)
"""Radians by which the array may turn within a classical method's window"""


class StreamLocalizer(Protocol):
    """One stream of one array; not safe to call from two threads at a time."""

    window_frames: int
    """Most frames behind an estimate"""
    nothing: WindowEstimate
    """Its estimate of silence"""

    def push(self, spectra: ComplexArray) -> None:
        """Take the next frames (N, F, L) of all STFT bins, L at least 1."""
        ...

    def estimate(
        self, num_sources: int | None, max_sources: int, headings: Headings | None = None
    ) -> WindowEstimate:
        """Directions of the latest frames; at least one must have been pushed.

        ``headings`` tell how the array was turned at every frame, where it was not still.
        """
        ...


class ClassicalStream:
    """A classical method on covariances that are summed block by block."""

    window_frames = WINDOW_BLOCKS * BLOCK_FRAMES

    def __init__(self, localizer: ClassicalLocalizer) -> None:
        self._localizer = localizer
        self.nothing = localizer.nothing
        self._blocks: deque[tuple[ComplexArray, int]] = deque(maxlen=WINDOW_BLOCKS)
        """Sums over up to eight frames, and the numbers of frames"""
        self._frames = 0
        """Number of all frames"""

    def push(self, spectra: ComplexArray) -> None:
        self._frames += spectra.shape[-1]
        while spectra.shape[-1]:
            if not self._blocks or self._blocks[-1][1] == BLOCK_FRAMES:
                self._blocks.append((np.zeros((1, 1, 1), np.complex64), 0))
            total, frames = self._blocks.pop()
            taken = spectra[..., : BLOCK_FRAMES - frames]
            added = self._localizer.covariance(taken) * np.float32(taken.shape[-1])
            self._blocks.append((total + added, frames + taken.shape[-1]))
            spectra = spectra[..., taken.shape[-1] :]

    def estimate(
        self, num_sources: int | None, max_sources: int, headings: Headings | None = None
    ) -> WindowEstimate:
        blocks, heading = list(self._blocks), None
        if headings is not None:
            blocks, heading = self._alike(headings)
        frames = sum(count for _, count in blocks)
        covariance = np.sum([total for total, _ in blocks], axis=0) / np.float32(frames)
        estimate = self._localizer.localize(covariance, num_sources, max_sources)
        return replace(estimate, heading=heading)

    def _alike(self, headings: Headings) -> tuple[list[tuple[ComplexArray, int]], Rotation]:
        """The blocks in which the array was turned as in the newest, and their mean heading.

        A covariance cannot be turned: that of a turning array would be smeared.
        """
        counts = [count for _, count in self._blocks]
        ends = self._frames - sum(counts) + np.cumsum(counts)
        turned = [
            headings(float(end - (count + 1) / 2)) for end, count in zip(ends, counts, strict=True)
        ]
        alike = [turned[-1].inverse.after(one).angle <= ALIKE for one in turned]
        kept = mean_rotation(compress(turned, alike))
        return list(compress(self._blocks, alike)), kept


class WindowStream:
    """A network that takes whole windows."""

    def __init__(self, localizer: RegressionLocalizer, window_frames: int) -> None:
        self._localizer = localizer
        self.nothing = localizer.nothing
        self._spectra: ComplexArray | None = None
        self._frames = 0
        self.window_frames = window_frames

    def push(self, spectra: ComplexArray) -> None:
        self._frames += spectra.shape[-1]
        kept = spectra if self._spectra is None else np.concatenate([self._spectra, spectra], -1)
        self._spectra = kept[..., -self.window_frames :]

    def estimate(
        self, num_sources: int | None, max_sources: int, headings: Headings | None = None
    ) -> WindowEstimate:
        assert self._spectra is not None
        (estimate,) = self._localizer.localize(self._spectra[None], num_sources, max_sources)
        if headings is None:
            return estimate
        middle = self._frames - (self._spectra.shape[-1] + 1) / 2
        return replace(estimate, heading=headings(middle))


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

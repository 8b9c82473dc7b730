"""The `regression` variant, the paper's: the network gives covariance matrices."""

from __future__ import annotations

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.fusion import attention_fusion, attention_weights, normalise
from service.doa.music import signal_power
from service.doa.peaks import find_peaks
from service.doa.spectrogram import spectrogram_features
from service.doa.steering import azimuth_grid, steering_vectors
from service.doa.types import ComplexArray, FloatArray
from service.inference.bundle import Bundle
from service.inference.results import Source, WindowEstimate


class RegressionLocalizer:
    """From windows of the bundle's array to directions: covariance and count, EVD, MUSIC, FAF."""

    def __init__(self, bundle: Bundle, array: MicrophoneArray) -> None:
        manifest = bundle.manifest
        self._bundle = bundle
        self._stft = bundle.stft
        self.grid_size = manifest.grid_size
        self._frames = manifest.stft.frames
        self._bins = slice(manifest.first_bin, manifest.first_bin + manifest.num_bins)
        self._steering = steering_vectors(
            array.positions, self._stft.frequencies[self._bins], azimuth_grid(self.grid_size)
        )
        self._floor = np.float32(bundle.fusion["floor"])

    def estimate(
        self, windows: FloatArray, num_sources: int | None, max_sources: int
    ) -> list[WindowEstimate]:
        """Directions of every window (B, N, T); see ``WeightsLocalizer.estimate``."""
        return self.localize(self._stft.transform(windows), num_sources, max_sources)

    def localize(
        self, spectra: ComplexArray, num_sources: int | None, max_sources: int
    ) -> list[WindowEstimate]:
        """Directions of every window's spectra (B, N, F, L)."""
        features = spectrogram_features(
            self._cropped(spectra), level_exponent=self._bundle.manifest.level_exponent
        )
        covariance = self.covariance(features)
        (logits,) = self._bundle.source_count.run([features])
        probabilities = np.exp(logits - logits.max(axis=-1, keepdims=True))
        probabilities /= probabilities.sum(axis=-1, keepdims=True)
        counts = np.minimum(np.argmax(logits, axis=-1), max_sources)
        if num_sources is not None:
            counts[:] = num_sources
        return [
            self._pick(matrices, int(count), chances)
            for matrices, count, chances in zip(covariance, counts, probabilities, strict=True)
        ]

    def covariance(self, features: FloatArray) -> ComplexArray:
        """The network's covariances (B, F, N, N) complex64 of the localizer's bins."""
        (real,) = self._bundle.covariance.run([features])  # (B, 257, 2, N, N)
        return (real[:, :, 0] + 1j * real[:, :, 1])[:, self._bins]

    def fused(self, covariance: ComplexArray, num_sources: int) -> FloatArray:
        """Broadband spectrum (A,) of one window's covariances (F, N, N)."""
        _, vectors = np.linalg.eigh(covariance)
        power = signal_power(vectors[..., -num_sources:], self._steering)
        spectra = normalise(1 / (1 - np.minimum(power, 1) + self._floor))
        attention = attention_weights(
            spectra, self._bundle.fusion["squeeze"], self._bundle.fusion["excite"]
        )
        return attention_fusion(spectra, attention)

    def _pick(self, covariance: ComplexArray, count: int, chances: FloatArray) -> WindowEstimate:
        microphones = covariance.shape[-1]
        fused = self.fused(covariance, min(max(count, 1), microphones - 1))
        sources = tuple(
            # The chance of at least this many sources, reduced where the peak stands out little.
            Source(peak.azimuth, float(chances[rank + 1 :].sum() * peak.height / fused.max()))
            for rank, peak in enumerate(find_peaks(fused, count))
        )
        return WindowEstimate(sources, fused)

    def _cropped(self, spectra: ComplexArray) -> ComplexArray:
        """Spectra cropped or zero-padded to the number of frames of the network's training."""
        latest = spectra[..., : self._frames]
        missing = self._frames - latest.shape[-1]
        return np.pad(latest, [(0, 0)] * (latest.ndim - 1) + [(0, missing)])

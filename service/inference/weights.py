"""The `weights` variant: networks weigh cells, covariances of any array form outside of them."""

from __future__ import annotations

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.covariance import weighted_covariance
from service.doa.features import coherence_features
from service.doa.fusion import normalise
from service.doa.steering import azimuth_grid, steering_vectors
from service.doa.types import ComplexArray, FloatArray
from service.inference.bundle import Bundle
from service.inference.candidates import Candidates, find_candidates
from service.inference.results import Source, WindowEstimate

BLOCK_FRAMES = 8


class WeightsLocalizer:
    """Windows of one array's audio to directions, with a `weights` bundle."""

    def __init__(self, bundle: Bundle, array: MicrophoneArray) -> None:
        manifest = bundle.manifest
        self._bundle = bundle
        self._stft = bundle.stft
        self._bins = slice(manifest.first_bin, manifest.first_bin + manifest.num_bins)
        self._steering = steering_vectors(
            array.positions, self._stft.frequencies[self._bins], azimuth_grid(manifest.grid_size)
        )
        self._floor = float(bundle.fusion["floor"])
        self._dominance_power = float(bundle.fusion["dominance_power"])

    def estimate(
        self, windows: FloatArray, num_sources: int | None, max_sources: int
    ) -> list[WindowEstimate]:
        """Directions of every window.

        Parameters
        ----------
        windows : (B, N, T) float32
            At the bundle's sample rate.
        num_sources : int, optional
            Known count; None lets the source-count network decide.
        max_sources : int
            Bound on the estimated count.
        """
        candidates = self.candidates(windows)
        descriptors = np.stack([window.descriptors for window in candidates])
        count_logits, confidence_logits = self._bundle.source_count.run([descriptors])
        counts = np.argmax(count_logits, axis=-1)
        confidence = 1 / (1 + np.exp(-confidence_logits))
        return [
            _select(
                window,
                confidence[index],
                min(int(counts[index]), max_sources) if num_sources is None else num_sources,
            )
            for index, window in enumerate(candidates)
        ]

    def candidates(self, windows: FloatArray) -> list[Candidates]:
        """Candidate sources of every window (B, N, T) before counting."""
        spectra = self.spectra(windows)
        weights, attention = self.weigh(spectra)
        power, cell_attention, dominance = self.block_spectra(spectra, weights, attention)
        return [
            find_candidates(cells, attended, float(mean))
            for cells, attended, mean in zip(power, cell_attention, dominance, strict=True)
        ]

    def spectra(self, windows: FloatArray) -> ComplexArray:
        """STFT of the band, cropped or zero-padded to whole blocks: (B, N, F, L) complex64."""
        spectra = self._stft.transform(windows)[..., self._bins, :]
        missing = -spectra.shape[-1] % BLOCK_FRAMES
        if 0 < missing <= BLOCK_FRAMES // 2 or spectra.shape[-1] < BLOCK_FRAMES:
            widths = [(0, 0)] * (spectra.ndim - 1) + [(0, missing)]
            spectra = np.pad(spectra, widths)
        return spectra[..., : spectra.shape[-1] // BLOCK_FRAMES * BLOCK_FRAMES]

    def weigh(self, spectra: ComplexArray) -> tuple[FloatArray, FloatArray]:
        """Weights and attentions (B, F, L) from the network."""
        weights, attention = self._bundle.covariance.run([coherence_features(spectra)])
        return weights, attention

    def block_spectra(
        self, spectra: ComplexArray, weights: FloatArray, attention: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Rank-one MUSIC per bin and block.

        Returns
        -------
        power : (B, F * K, A) float32
            Normalised spectra.
        attention : (B, F * K) float32
        dominance : (B,) float32
        """
        covariance = weighted_covariance(spectra, weights, BLOCK_FRAMES)  # (B, F, K, N, N)
        values, vectors = np.linalg.eigh(covariance)
        microphones = spectra.shape[-3]
        # Blocks' principal eigenvectors stand as columns, so that a bin is one matrix product.
        columns = np.swapaxes(vectors[..., -1], -1, -2)  # (B, F, N, K)
        response = np.conj(np.swapaxes(columns, -1, -2)) @ self._steering  # (B, F, K, A)
        power = (response.real**2 + response.imag**2) / np.float32(microphones)
        spectrum = normalise(1 / (np.float32(1 + self._floor) - np.minimum(power, 1)))
        share = values[..., -1] / np.maximum(values.sum(axis=-1), np.finfo(np.float32).tiny)
        dominance = np.clip((share - 1 / microphones) / (1 - 1 / microphones), 1e-4, 1)
        by_block = attention.reshape(*attention.shape[:-1], -1, BLOCK_FRAMES).mean(axis=-1)
        cells = (by_block * dominance**self._dominance_power).astype(np.float32)
        mean = (by_block * dominance).sum(axis=(1, 2)) / np.maximum(by_block.sum(axis=(1, 2)), 1e-9)
        batch, _, _, angles = spectrum.shape
        return spectrum.reshape(batch, -1, angles), cells.reshape(batch, -1), mean


def _select(window: Candidates, confidence: FloatArray, count: int) -> WindowEstimate:
    """The ``count`` most confident candidates, most confident first."""
    found = np.flatnonzero(np.isfinite(window.azimuth))
    order = found[np.argsort(-confidence[found], kind="stable")][:count]
    sources = tuple(
        Source(float(window.azimuth[index]), float(confidence[index])) for index in order
    )
    return WindowEstimate(sources, window.fused)

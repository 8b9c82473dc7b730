"""The `weights` variant: networks weigh cells, covariances of any array form outside of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.covariance import weighted_covariance
from service.doa.features import coherence_features
from service.doa.fusion import normalise
from service.doa.steering import azimuth_grid, steering_vectors
from service.doa.stft import Stft
from service.doa.subspace import eigenvector_power
from service.doa.types import ComplexArray, FloatArray
from service.inference.bundle import Bundle
from service.inference.candidates import Candidates, find_candidates
from service.inference.engine import Engine
from service.inference.results import Source, WindowEstimate

BLOCK_FRAMES = 8


@dataclass(frozen=True, slots=True)
class Analysis:
    """What the search needs of a bundle besides its covariance network."""

    stft: Stft
    first_bin: int
    num_bins: int
    grid_size: int
    floor: float
    """MUSIC's floor, the width of its peaks"""
    dominance_power: float
    """Exponent of the dominance in the attention"""
    window_share: float
    """Attention of a bin's whole window against the sum of its blocks'"""


class CandidateSearch:
    """Windows of one array's audio to candidate sources, before anything is counted."""

    def __init__(self, covariance: Engine, analysis: Analysis, array: MicrophoneArray) -> None:
        self._covariance = covariance
        self._analysis = analysis
        self._bins = slice(analysis.first_bin, analysis.first_bin + analysis.num_bins)
        self._steering = steering_vectors(
            array.positions,
            analysis.stft.frequencies[self._bins],
            azimuth_grid(analysis.grid_size),
        )

    def candidates(self, windows: FloatArray) -> list[Candidates]:
        """Candidate sources of every window (B, N, T) before counting."""
        spectra = self.spectra(windows)
        weights, attention = self.weigh(spectra)
        # One window at a time: its spectra are megabytes and stay in the cache.
        return [
            find_candidates(*self.block_spectra(*window))
            for window in zip(spectra, weights, attention, strict=True)
        ]

    def spectra(self, windows: FloatArray) -> ComplexArray:
        """STFT of the band, cropped or zero-padded to whole blocks: (B, N, F, L) complex64."""
        spectra = self._analysis.stft.transform(windows)[..., self._bins, :]
        missing = -spectra.shape[-1] % BLOCK_FRAMES
        if 0 < missing <= BLOCK_FRAMES // 2 or spectra.shape[-1] < BLOCK_FRAMES:
            widths = [(0, 0)] * (spectra.ndim - 1) + [(0, missing)]
            spectra = np.pad(spectra, widths)
        return spectra[..., : spectra.shape[-1] // BLOCK_FRAMES * BLOCK_FRAMES]

    def weigh(self, spectra: ComplexArray) -> tuple[FloatArray, FloatArray]:
        """Weights and attentions (B, F, L) from the network."""
        weights, attention = self._covariance.run([coherence_features(spectra)])
        return weights, attention

    def block_spectra(
        self, spectra: ComplexArray, weights: FloatArray, attention: FloatArray
    ) -> tuple[FloatArray, FloatArray, float]:
        """Rank-one MUSIC of one window per bin and block.

        Parameters
        ----------
        spectra : (N, F, L) complex64
        weights, attention : (F, L) float32

        Returns
        -------
        cells : (F K, A) float32
            Spectra of F bins in K - 1 blocks and the whole window, each with a maximum of 1.
        cell_attention : (F K,) float32
        dominance : float
            Attention-weighted mean share of the principal eigenvector, 0 in an isotropic field.
        """
        blocks = weighted_covariance(spectra, weights, BLOCK_FRAMES)  # (F, K - 1, N, N)
        # Blocks tell talkers apart; the whole window, their sum, averages most of the noise.
        covariance = np.concatenate([blocks, blocks.sum(axis=1, keepdims=True)], axis=1)
        values, vectors = np.linalg.eigh(covariance)
        microphones = spectra.shape[-3]
        # Blocks' principal eigenvectors stand as columns, so that a bin is one matrix product.
        columns = np.swapaxes(vectors[..., -1], -1, -2)  # (F, N, K)
        power = eigenvector_power(columns, self._steering)  # (F, K, A)
        spectrum = normalise(1 / (np.float32(1 + self._analysis.floor) - np.minimum(power, 1)))
        share = values[..., -1] / np.maximum(values.sum(axis=-1), np.finfo(np.float32).tiny)
        dominance = np.clip((share - 1 / microphones) / (1 - 1 / microphones), 1e-4, 1)
        attended = attention.reshape(len(attention), -1, BLOCK_FRAMES).mean(axis=-1)
        whole = attended.sum(axis=-1, keepdims=True) * np.float32(self._analysis.window_share)
        attended = np.concatenate([attended, whole], axis=1)
        cells = (attended * dominance**self._analysis.dominance_power).astype(np.float32)
        mean = float((attended * dominance).sum() / max(float(attended.sum()), 1e-9))
        return spectrum.reshape(-1, spectrum.shape[-1]), cells.reshape(-1), mean


class WeightsLocalizer:
    """Windows of one array's audio to directions, with a `weights` bundle."""

    def __init__(self, bundle: Bundle, array: MicrophoneArray) -> None:
        self._source_count = bundle.source_count
        self._search = CandidateSearch(bundle.covariance, analysis_of(bundle), array)

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
        candidates = self._search.candidates(windows)
        descriptors = np.stack([window.descriptors for window in candidates])
        count_logits, confidence_logits = self._source_count.run([descriptors])
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


def analysis_of(bundle: Bundle) -> Analysis:
    """The analysis parameters that a `weights` bundle holds."""
    manifest = bundle.manifest
    return Analysis(
        stft=bundle.stft,
        first_bin=manifest.first_bin,
        num_bins=manifest.num_bins,
        grid_size=manifest.grid_size,
        floor=float(bundle.fusion["floor"]),
        dominance_power=float(bundle.fusion["dominance_power"]),
        window_share=float(bundle.fusion["window_share"]),
    )


def _select(window: Candidates, confidence: FloatArray, count: int) -> WindowEstimate:
    """The ``count`` candidates found first, most confident first."""
    found = np.flatnonzero(np.isfinite(window.azimuth))[:count]
    order = found[np.argsort(-confidence[found], kind="stable")]
    sources = tuple(
        Source(float(window.azimuth[index]), float(confidence[index])) for index in order
    )
    return WindowEstimate(sources, window.fused)

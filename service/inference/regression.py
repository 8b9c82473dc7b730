"""The `regression` variant, the paper's: networks give covariance matrices.

A bundle holds one covariance network for any number of sources, and may hold one for every known
number. The number, asked for or counted, chooses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralmusic.errors import BundleCorrupt
from service.doa.array import MicrophoneArray
from service.doa.fusion import attention_fusion, attention_weights, normalise
from service.doa.music import signal_power
from service.doa.peaks import find_peaks
from service.doa.spectrogram import spectrogram_features
from service.doa.steering import azimuth_grid, steering_vectors
from service.doa.types import ComplexArray, FloatArray
from service.inference.bundle import FUSION, Bundle
from service.inference.engine import Engine
from service.inference.results import Source, WindowEstimate, nothing_heard

ANY_COUNT = 0
"""Place of the network for any number of sources; windows without a source take it as well"""


@dataclass(frozen=True, slots=True, eq=False)
class CovarianceModel:
    """A covariance network with the parameters of its spectra's fusion."""

    network: Engine
    floor: FloatArray
    """() float32, MUSIC's"""
    squeeze: FloatArray
    excite: FloatArray

    def covariance(self, features: FloatArray) -> ComplexArray:
        """Covariances (B, F, N, N) complex64 of features (B, 2N, F, L)."""
        (real,) = self.network.run([features])  # (B, F, 2, N, N)
        return real[:, :, 0] + 1j * real[:, :, 1]

    def fused(
        self, covariance: ComplexArray, num_sources: int, steering: ComplexArray
    ) -> FloatArray:
        """Broadband spectrum (A,) of one window's covariances (F, N, N)."""
        _, vectors = np.linalg.eigh(covariance)
        power = signal_power(vectors[..., -num_sources:], steering)
        spectra = normalise(1 / (1 - np.minimum(power, 1) + self.floor))
        return attention_fusion(spectra, attention_weights(spectra, self.squeeze, self.excite))


class RegressionLocalizer:
    """From windows of the bundle's array to directions: count and covariance, EVD, MUSIC, FAF."""

    def __init__(self, bundle: Bundle, array: MicrophoneArray) -> None:
        manifest = bundle.manifest
        self._bundle = bundle
        self._stft = bundle.stft
        self.nothing = nothing_heard(manifest.grid_size, sphere=False)
        self._frames = manifest.stft.frames
        self._bins = slice(manifest.first_bin, manifest.first_bin + manifest.num_bins)
        self._steering = steering_vectors(
            array.positions, self._stft.frequencies[self._bins], azimuth_grid(manifest.grid_size)
        )
        networks = {ANY_COUNT: bundle.covariance, **bundle.covariance_by_count}
        self._models = {count: _model(bundle, count, each) for count, each in networks.items()}

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
        (logits,) = self._bundle.source_count.run([features])
        probabilities = np.exp(logits - logits.max(axis=-1, keepdims=True))
        probabilities /= probabilities.sum(axis=-1, keepdims=True)
        counts = np.minimum(np.argmax(logits, axis=-1), max_sources)
        if num_sources is not None:
            counts[:] = num_sources
        chosen = np.where(np.isin(counts, list(self._models)), counts, ANY_COUNT)
        found: dict[int, WindowEstimate] = {}
        for key in set(chosen.tolist()):
            model, places = self._models[key], np.flatnonzero(chosen == key).tolist()
            for place, matrices in zip(places, model.covariance(features[places]), strict=True):
                found[place] = self._pick(
                    model, matrices[self._bins], int(counts[place]), probabilities[place]
                )
        return [found[place] for place in range(len(features))]

    def _pick(
        self, model: CovarianceModel, covariance: ComplexArray, count: int, chances: FloatArray
    ) -> WindowEstimate:
        subspace = min(max(count, 1), covariance.shape[-1] - 1)
        fused = model.fused(covariance, subspace, self._steering)
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


def _model(bundle: Bundle, count: int, network: Engine) -> CovarianceModel:
    """A network with its arrays of ``FUSION``, whose names end in the count that it is for."""
    ending = "" if count == ANY_COUNT else f"_{count}"
    try:
        floor, squeeze, excite = (
            bundle.fusion[f"{name}{ending}"] for name in ("floor", "squeeze", "excite")
        )
    except KeyError as error:
        raise BundleCorrupt(
            f"{bundle.folder / FUSION} lacks {error}: export the model again"
        ) from error
    return CovarianceModel(network, floor.astype(np.float32), squeeze, excite)

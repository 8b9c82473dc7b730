"""Methods that an evaluation compares, on any array: bundles, classical methods and a peer's.

pyroomacoustics' NormMUSIC is run as its users should run it, with its own circular peak search, in
two bands; in every cell the better band counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from model_export.baselines.pyroom import direction_finder
from model_export.baselines.told import STFT
from model_export.simulation.protocol import SimulatedScene
from neuralmusic.protocol.methods import METHODS, Method
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray
from service.inference.bundle import Bundle, load_bundle
from service.inference.classical import ClassicalLocalizer
from service.inference.localizer import Localizer, localizer_of
from service.recordings.results import DEFAULT_MAX_SOURCES

PEER = "pyroomacoustics NormMUSIC"
BANDS = ((300.0, 3500.0), (100.0, 7900.0))
"""Bands of pyroomacoustics' NormMUSIC, in hertz"""
CLASSICAL: tuple[Method, ...] = tuple(method for method in METHODS if method != "neural")

Answer = Callable[[SimulatedScene, int | None], FloatArray]
"""Azimuths in radians, most confident first, for a scene and its known count or None"""


class Methods:
    """Bundles, loaded from their folders when first needed, and the methods beside them."""

    def __init__(self, folders: Sequence[Path]) -> None:
        self._folders = tuple(folders)
        self._localizers: dict[str, dict[str, Localizer]] = {}
        self._answers: dict[str, dict[str, Answer]] = {}

    @cached_property
    def bundles(self) -> tuple[Bundle, ...]:
        """The loaded bundles, in the order of their folders."""
        return tuple(load_bundle(folder) for folder in self._folders)

    def localizers(self, array: MicrophoneArray) -> dict[str, Localizer]:
        """The localizer of every bundle that fits the array, by the bundle's name."""
        if array.name not in self._localizers:
            self._localizers[array.name] = {
                bundle.manifest.name: localizer_of(bundle, array)
                for bundle in self.bundles
                if bundle.fits(array)
            }
        return self._localizers[array.name]

    def answers(self, array: MicrophoneArray) -> dict[str, Answer]:
        """Every method that can answer for this array, by its name."""
        if array.name not in self._answers:
            localizers = dict(self.localizers(array))
            for method in CLASSICAL:
                localizers[method] = ClassicalLocalizer(method, array)
            self._answers[array.name] = {
                **{name: _localizer_answer(localizer) for name, localizer in localizers.items()},
                **{_band_name(band): _pyroomacoustics(array, band) for band in BANDS},
            }
        return self._answers[array.name]


def keep_better_band(scores: dict[str, dict[str, float]]) -> None:
    """Replace the rows of pyroomacoustics' bands by one: that of the smaller MAAE."""
    bands = [scores.pop(_band_name(band)) for band in BANDS]
    scores[PEER] = min(bands, key=lambda s: s["maae_deg"])


def _localizer_answer(localizer: Localizer) -> Answer:
    def answer(scene: SimulatedScene, known: int | None) -> FloatArray:
        (estimate,) = localizer.estimate(scene.audio[None], known, DEFAULT_MAX_SOURCES)
        return np.array([source.azimuth for source in estimate.sources])

    return answer


def _pyroomacoustics(array: MicrophoneArray, band: tuple[float, float]) -> Answer:
    method = direction_finder("NormMUSIC", array)

    def answer(scene: SimulatedScene, known: int | None) -> FloatArray:
        # It requires a count; where the count is unknown to the others, it is told the truth.
        count = known or len(scene.azimuth)
        spectra = STFT.transform(scene.audio)
        method.locate_sources(spectra, num_src=count, freq_range=list(band))
        azimuth: FloatArray = np.atleast_1d(method.azimuth_recon)
        return azimuth[:count]

    return answer


def _band_name(band: tuple[float, float]) -> str:
    return f"{PEER} {band[0]:.0f}-{band[1]:.0f} Hz"

"""The bundles that the service ships, as methods of the comparison."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np

from model_export.baselines.method import Card, Estimate
from model_export.baselines.network import MAX_TALKERS
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray
from service.inference.bundle import Bundle, load_bundle
from service.inference.localizer import Localizer, localizer_of
from service.inference.registry import EMBEDDED_MODELS

SHIPPED = ("any-array", "paper")


class ShippedBundle:
    """A bundle as a method, run as in the service."""

    counts = True

    def __init__(self, bundle: Bundle) -> None:
        name = bundle.manifest.name
        self.card = Card(name, f"bundle {name}", "hybrid", f"docs/models/{name}.md")
        self.bound = bundle.bound_array() is not None
        """Whether it fits one array only"""
        self.sha256 = bundle.sha256
        """Hash of the manifest, which holds the hashes of the files"""
        self._bundle = bundle
        self._localizers: dict[str, Localizer] = {}

    def localize(
        self, audio: FloatArray, array: MicrophoneArray, num_sources: int | None = None
    ) -> Estimate:
        """Directions of one window; ValueError if the bundle is bound to another array."""
        if not self._bundle.fits(array):
            raise ValueError(f"the bundle {self.card.name} does not fit the array {array.name}")
        if array.name not in self._localizers:
            self._localizers[array.name] = localizer_of(self._bundle, array)
        most = min(MAX_TALKERS, array.num_microphones - 1)
        (found,) = self._localizers[array.name].estimate(audio[None], num_sources, most)
        return Estimate(np.array([source.azimuth for source in found.sources]), found.spectrum)


@cache
def shipped() -> Mapping[str, ShippedBundle]:
    """Shipped bundles by name."""
    return {name: ShippedBundle(load_bundle(EMBEDDED_MODELS / name)) for name in SHIPPED}

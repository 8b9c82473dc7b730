"""The classical methods of the service, and the list of all classical methods."""

from __future__ import annotations

import numpy as np

from model_export.baselines.coherent import Cssm, Waves
from model_export.baselines.frida import Frida
from model_export.baselines.method import Card, Estimate, Method
from model_export.baselines.root_music import RootMusic
from model_export.baselines.told import STFT, ToldMethod
from model_export.baselines.tops import Tops
from neuralmusic.protocol.methods import Method as ServiceName
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray
from service.inference.classical import ClassicalLocalizer

MUSIC = Card(
    "music",
    "MUSIC",
    "classical",
    "Schmidt, 1986, Multiple emitter location and signal parameter estimation",
    "broadband as the arithmetic mean over the bins of 300-3500 Hz",
)
NORM_MUSIC = Card(
    "norm_music",
    "NormMUSIC",
    "classical",
    "Salvati, Drioli, Foresti, 2014, Incoherent frequency fusion for broadband steered response "
    "power algorithms in noisy environments",
    "300-3500 Hz",
)
SRP_PHAT = Card(
    "srp_phat",
    "SRP-PHAT",
    "classical",
    "DiBiase, 2000, A high-accuracy, low-latency technique for talker localization, eq. (5.2)",
    "far field, 300-3500 Hz; the paper's beamforming",
)
GCC_PHAT = Card(
    "gcc_phat",
    "GCC-PHAT",
    "classical",
    "Knapp, Carter, 1976, The generalized correlation method for estimation of time delay, "
    "table I (PHAT)",
    "the pairs' correlations at every azimuth's delays, summed; 300-6000 Hz",
)


class ServiceMethod(ToldMethod[ClassicalLocalizer]):
    """A classical method of the service with a known count."""

    def __init__(self, name: ServiceName) -> None:
        super().__init__()
        self.card = CARDS[name]  # type: ignore[misc]
        self._name = name

    def prepare(self, array: MicrophoneArray) -> ClassicalLocalizer:
        return ClassicalLocalizer(self._name, array, STFT)

    def estimate(
        self, audio: FloatArray, prepared: ClassicalLocalizer, num_sources: int
    ) -> Estimate:
        """The window's highest peaks; ``spectrum`` (360,) has a maximum of 1."""
        (window,) = prepared.estimate(audio[None], num_sources, num_sources)
        azimuth = np.array([source.azimuth for source in window.sources])
        return Estimate(azimuth, window.spectrum)


CARDS = {card.name: card for card in (MUSIC, NORM_MUSIC, SRP_PHAT, GCC_PHAT)}


def classical_methods() -> list[Method]:
    """All classical methods, fresh, in the order of the comparison's tables."""
    return [
        ServiceMethod("music"),
        ServiceMethod("norm_music"),
        ServiceMethod("srp_phat"),
        ServiceMethod("gcc_phat"),
        Tops(),
        Cssm(),
        Waves(),
        Frida(),
        RootMusic(),
    ]

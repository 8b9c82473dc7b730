"""The choice of method and model for a recording or a stream."""

from __future__ import annotations

from neuralmusic.errors import GeometryMismatch, TooManySources
from neuralmusic.protocol.methods import Hemisphere, Method
from service.doa import hemisphere as halves
from service.doa.array import MicrophoneArray
from service.inference.bundle import Bundle
from service.inference.registry import BundleRegistry
from service.inference.results import AudioWarning


def check_num_sources(num_sources: int | None, microphones: int) -> None:
    """Raise TooManySources where the microphones cannot tell that many sources apart."""
    if num_sources is not None and num_sources >= microphones:
        raise TooManySources(
            f"num_sources is {num_sources}, but {microphones} microphones can tell apart "
            f"at most {microphones - 1} sources"
        )


def choose_method(
    method: Method | None, model: str | None, array: MicrophoneArray, registry: BundleRegistry
) -> tuple[Method, Bundle | None]:
    """The method to run and, for `neural`, its bundle.

    Raises
    ------
    UnknownModel
        If no bundle has the model's name, even with a classical method.
    GeometryMismatch
        If the model is bound to another array, or `neural` was requested and no model fits.
    """
    if model is not None:
        registry.get(model)
    if method not in (None, "neural"):
        return method, None
    bundle = registry.for_array(array, model)
    if bundle:
        return "neural", bundle
    if method == "neural":
        raise GeometryMismatch(
            f"no loaded model fits the array {array.name}: leave the method out, or "
            "choose norm_music, music, srp_phat or gcc_phat"
        )
    return "norm_music", None


def method_warnings(
    asked: Method | None, method: Method, bundle: Bundle | None, array: MicrophoneArray
) -> list[AudioWarning]:
    """Warnings about what the chosen method and the array's shape mean for the directions."""
    found = []
    if asked is None and method != "neural":
        detail = f"no loaded model fits the array {array.name}: {method} was used instead"
        found.append(AudioWarning("no_model_for_array", detail))
    elevations = bundle is not None and bundle.manifest.variant == "weights"
    one_side = halves.why_one_side(array, elevations=elevations)
    if one_side is not None:
        found.append(AudioWarning("front_back_ambiguous", one_side))
    return found


def why_no_elevation(
    array: MicrophoneArray, hemisphere: Hemisphere, bundle: Bundle | None
) -> str | None:
    """The reason why answers hold azimuths only; None where they hold elevations."""
    if bundle is not None and bundle.manifest.variant == "regression":
        return f"the model {bundle.manifest.name} searches azimuths only"
    return halves.why_no_elevation(array, hemisphere)

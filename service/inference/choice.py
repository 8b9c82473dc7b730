"""What a recording or a stream is localized with: its channels, the method, the model."""

from __future__ import annotations

from collections.abc import Sequence

from service.doa.array import MicrophoneArray, validate_channel_map
from service.doa.presets import RAW_CHANNELS
from service.errors import ChannelMismatch, GeometryMismatch, TooManySources
from service.inference.bundle import Bundle
from service.inference.registry import BundleRegistry
from service.inference.results import AudioWarning
from service.protocol.methods import Method


def choose_channels(
    channels: int, array: MicrophoneArray, channel_map: Sequence[int] | None
) -> tuple[int, ...]:
    """One channel per microphone of audio with ``channels`` channels.

    Raises
    ------
    InvalidChannelMap
        If the map does not name one distinct channel per microphone.
    ChannelMismatch
        If the audio's channels do not fit, with what to do.
    """
    microphones = array.num_microphones
    if channel_map is not None:
        chosen = validate_channel_map(channel_map, microphones)
        if max(chosen) >= channels:
            raise ChannelMismatch(
                f"channel_map names channel {max(chosen)}, but the audio has {channels} "
                f"channels, 0 to {channels - 1}"
            )
        return chosen
    if channels == microphones:
        return tuple(range(microphones))
    raw = RAW_CHANNELS.get(array.name, {}).get(channels)
    if raw:
        listed = ",".join(map(str, raw))
        advice = (
            f"this device's {channels}-channel firmware has the raw microphones in channels "
            f"{', '.join(map(str, raw))}: pass channel_map={listed} (--channel-map {listed})"
        )
    elif channels > microphones:
        advice = (
            f"pass channel_map (--channel-map) with the {microphones} channels of the raw "
            "microphones"
        )
    else:
        advice = "record all microphones as separate channels, or choose the array that was used"
    raise ChannelMismatch(
        f"the audio has {channels} channel{'s' if channels != 1 else ''}, but the array "
        f"{array.name} has {microphones} microphones: {advice}"
    )


def check_num_sources(num_sources: int | None, microphones: int) -> None:
    """Raise TooManySources where so many microphones cannot tell that many sources apart."""
    if num_sources is not None and num_sources >= microphones:
        raise TooManySources(
            f"num_sources is {num_sources}, but {microphones} microphones can tell apart "
            f"at most {microphones - 1} sources"
        )


def choose_method(
    method: Method | None, model: str | None, array: MicrophoneArray, registry: BundleRegistry
) -> tuple[Method, Bundle | None]:
    """The method that will run and, for `neural`, its bundle.

    Raises
    ------
    UnknownModel
        If no bundle has the model's name; with a classical method, too.
    GeometryMismatch
        If the model is bound to another array, or none fits and `neural` was asked for.
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
            "choose norm_music, music or srp_phat"
        )
    return "norm_music", None


def method_warnings(
    asked: Method | None, method: Method, array: MicrophoneArray
) -> list[AudioWarning]:
    """What the choice of the method and the array's shape mean for the directions."""
    found = []
    if asked is None and method != "neural":
        detail = f"no loaded model fits the array {array.name}: {method} was used instead"
        found.append(AudioWarning("no_model_for_array", detail))
    if array.linear:
        detail = (
            "all microphones lie on one line, seen from above: every direction has a mirror image "
            "behind the line, which is left out"
        )
        found.append(AudioWarning("front_back_ambiguous", detail))
    return found

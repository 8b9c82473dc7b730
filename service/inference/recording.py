"""A whole recording: from a file's blocks to windows, directions, a summary and warnings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import islice

import numpy as np

from service.audio import Recording
from service.doa.array import MicrophoneArray, validate_channel_map
from service.doa.diagnostics import ChannelDiagnostics
from service.doa.presets import RAW_CHANNELS
from service.doa.stft import Stft
from service.doa.types import FloatArray
from service.errors import ChannelMismatch, GeometryMismatch, TooManySources
from service.inference.bundle import Bundle
from service.inference.classical import ClassicalLocalizer
from service.inference.localizer import Localizer, localizer_of
from service.inference.registry import BundleRegistry
from service.inference.results import (
    AudioWarning,
    LocalizeOptions,
    Method,
    RecordingResult,
    WindowEstimate,
    WindowResult,
)
from service.inference.summary import summarise
from service.inference.windows import Window, windows

SILENCE = 1e-9
"""Mean square of -90 dBFS, below the rounding noise of 14 bits: nothing was recorded"""
BATCH_WINDOWS = 4
"""Windows per network call; more gain nothing on one thread and cost memory"""


def localize_recording(
    recording: Recording,
    options: LocalizeOptions,
    registry: BundleRegistry,
    progress: Callable[[float], None] | None = None,
) -> RecordingResult:
    """Localize a recording window by window, in memory bounded by the window.

    Parameters
    ----------
    progress : callable, optional
        Told the share of the recording that is done, in [0, 1].

    Raises
    ------
    DoaError
        If the options do not fit the recording, the array or the models.
    """
    array = options.array
    channel_map = _channel_map(recording, options)
    _check_num_sources(options)
    method, bundle = _choose(options, registry)
    stft = bundle.stft if bundle else Stft()
    localizer = (
        localizer_of(bundle, array, options.noise)
        if bundle
        else ClassicalLocalizer(method, array, stft, options.noise)
    )
    diagnostics = ChannelDiagnostics(stft.sample_rate, array.num_microphones, channel_map)
    blocks = _observed(recording.blocks(channel_map, stft.sample_rate), diagnostics)
    cut = windows(blocks, stft.sample_rate, options.window_s, options.hop_s, stft.n_fft - stft.hop)
    results = []
    while batch := tuple(islice(cut, BATCH_WINDOWS)):
        estimates = _estimate(localizer, batch, options)
        for window, estimate in zip(batch, estimates, strict=True):
            t_end = min(window.start + options.window_s, recording.duration)
            results.append(WindowResult(window.start, t_end, estimate))
        if progress:
            progress(min(1.0, batch[-1].start / recording.duration))
    if progress:
        progress(1.0)
    return RecordingResult(
        method=method,
        model=bundle.identity if bundle else None,
        sample_rate=recording.sample_rate,
        channels=recording.channels,
        duration=recording.duration,
        array=array,
        channel_map=channel_map,
        windows=results,
        summary=summarise(results),
        warnings=_warnings(options, method, array, diagnostics),
    )


def _channel_map(recording: Recording, options: LocalizeOptions) -> tuple[int, ...]:
    """One recording channel per microphone, or ChannelMismatch with what to do."""
    microphones, channels = options.array.num_microphones, recording.channels
    if options.channel_map is not None:
        chosen = validate_channel_map(options.channel_map, microphones)
        if max(chosen) >= channels:
            raise ChannelMismatch(
                f"channel_map names channel {max(chosen)}, but the recording has {channels} "
                f"channels, 0 to {channels - 1}"
            )
        return chosen
    if channels == microphones:
        return tuple(range(microphones))
    raw = RAW_CHANNELS.get(options.array.name, {}).get(channels)
    if raw:
        advice = (
            f"this device's {channels}-channel firmware has the raw microphones in channels "
            f"{', '.join(map(str, raw))}: pass channel_map={','.join(map(str, raw))}"
        )
    elif channels > microphones:
        advice = f"pass channel_map with the {microphones} channels of the raw microphones"
    else:
        advice = "record all microphones as separate channels, or choose the array that was used"
    raise ChannelMismatch(
        f"the recording has {channels} channel{'s' if channels != 1 else ''}, but the array "
        f"{options.array.name} has {microphones} microphones: {advice}"
    )


def _check_num_sources(options: LocalizeOptions) -> None:
    microphones = options.array.num_microphones
    if options.num_sources is not None and options.num_sources >= microphones:
        raise TooManySources(
            f"num_sources is {options.num_sources}, but {microphones} microphones can tell apart "
            f"at most {microphones - 1} sources"
        )


def _choose(options: LocalizeOptions, registry: BundleRegistry) -> tuple[Method, Bundle | None]:
    """The method that will run and, for `neural`, its bundle."""
    if options.model is not None:
        registry.get(options.model)  # an unknown name is an error with a classical method, too
    if options.method not in (None, "neural"):
        return options.method, None
    bundle = registry.for_array(options.array, options.model)
    if bundle:
        return "neural", bundle
    if options.method == "neural":
        raise GeometryMismatch(
            f"no loaded model fits the array {options.array.name}: leave the method out, or "
            "choose norm_music, music or srp_phat"
        )
    return "norm_music", None


def _estimate(
    localizer: Localizer, batch: tuple[Window, ...], options: LocalizeOptions
) -> Iterable[WindowEstimate]:
    """Estimates of a batch; silent windows never reach the localizer's decision."""
    audio = np.stack([window.audio for window in batch])
    most = min(options.max_sources, options.array.num_microphones - 1)
    estimates = localizer.estimate(audio, options.num_sources, most)
    for window, estimate in zip(batch, estimates, strict=True):
        heard = window.audio[:, : max(window.heard, 1)]
        silent = float(np.mean(heard * heard)) < SILENCE
        yield WindowEstimate((), np.zeros_like(estimate.spectrum)) if silent else estimate


def _observed(
    blocks: Iterable[FloatArray], diagnostics: ChannelDiagnostics
) -> Iterator[FloatArray]:
    for block in blocks:
        diagnostics.add(block)
        yield block


def _warnings(
    options: LocalizeOptions,
    method: Method,
    array: MicrophoneArray,
    diagnostics: ChannelDiagnostics,
) -> list[AudioWarning]:
    found = [AudioWarning(f.code, f.detail) for f in diagnostics.findings(array)]
    if options.method is None and method != "neural":
        detail = f"no loaded model fits the array {array.name}: {method} was used instead"
        found.append(AudioWarning("no_model_for_array", detail))
    if array.linear:
        detail = (
            "all microphones lie on one line: every direction has a mirror image behind the line, "
            "which is left out"
        )
        found.append(AudioWarning("front_back_ambiguous", detail))
    return found

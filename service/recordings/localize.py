"""A whole recording: from a file's blocks to windows, directions, a summary and warnings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from neuralmusic.errors import InvalidOption
from service.audio.recording import Recording
from service.doa.diagnostics import ChannelDiagnostics
from service.doa.orientation import Orientation
from service.doa.silence import SILENCE
from service.doa.stft import Stft
from service.doa.types import FloatArray
from service.inference.choice import (
    check_num_sources,
    choose_method,
    method_warnings,
    why_no_elevation,
)
from service.inference.classical import ClassicalLocalizer
from service.inference.geometry import choose_channels
from service.inference.localizer import Localizer, estimate_stretch, localizer_of
from service.inference.registry import BundleRegistry
from service.inference.results import AudioWarning, WindowEstimate
from service.inference.windows import Stretch, stretches, windows
from service.recordings.forked_workers import in_order
from service.recordings.identities import identified
from service.recordings.packed_windows import PackedWindows
from service.recordings.results import (
    SHORTEST_WINDOW_S,
    LocalizeOptions,
    RecordingResult,
    WindowResult,
    too_short,
)
from service.recordings.summary import summarise

STRETCH_WINDOWS = 12
"""Most windows computed at a time: more share little more and cost memory"""
STRETCH_SAMPLES = STRETCH_WINDOWS * 16 * 16_384
"""Most samples computed at a time, all channels together: default windows of 16 microphones; to
bound memory, fewer longer windows or windows of more microphones are computed at a time"""


LENGTH_UNKNOWN = AudioWarning(
    "length_unknown",
    "the header does not say how long the recording is, as of a recorder that writes into a pipe: "
    "it was read to its end, which may not be the recording's",
)


def localize_recording(
    recording: Recording,
    options: LocalizeOptions,
    registry: BundleRegistry,
    progress: Callable[[float], None] | None = None,
    *,
    processes: int = 1,
) -> RecordingResult:
    """Localize a recording window by window, in memory bounded by the window.

    Parameters
    ----------
    progress : callable, optional
        Called with the share of the recording that is done, in [0, 1].
    processes : int
        Processes for the windows of a long recording; the result does not depend on it.

    Raises
    ------
    DoaError
        If the options do not fit the recording, the array or the models.
    WorkerLost
        If one of the processes was killed.
    """
    array = options.array
    channel_map, assumed = choose_channels(recording.channels, array, options.channel_map)
    check_num_sources(options.num_sources, array.num_microphones)
    method, bundle = choose_method(options.method, options.model, array, registry)
    why_not = why_no_elevation(array, options.hemisphere, bundle)
    if options.sphere and why_not:
        raise InvalidOption(f"spectrum=sphere needs an array that tells elevations, but {why_not}")
    stft = bundle.stft if bundle else Stft()
    localizer = (
        localizer_of(bundle, array, options.noise, options.hemisphere)
        if bundle
        else ClassicalLocalizer(method, array, stft, options.noise, options.hemisphere)
    )
    diagnostics = ChannelDiagnostics(stft.sample_rate, array.num_microphones, channel_map)
    blocks = _observed(recording.blocks(channel_map, stft.sample_rate), diagnostics)
    cut = windows(blocks, stft.sample_rate, options.window_s, options.hop_s, stft.n_fft - stft.hop)
    sizes: Counter[int] = Counter()
    of_window = array.num_microphones * round(options.window_s * stft.sample_rate)
    most = min(STRETCH_WINDOWS, max(1, STRETCH_SAMPLES // of_window))
    joined = _counted(stretches(cut, most), sizes)
    shortest = round(SHORTEST_WINDOW_S * stft.sample_rate)
    estimated = in_order(partial(_estimate, localizer, options, shortest), joined, processes)
    results = PackedWindows(options.orientation, spectrum=options.spectrum, sphere=options.sphere)
    for window in identified(_placed(estimated, options, recording.duration, progress)):
        results.append(window)
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
        summary=summarise(results, options.num_sources),
        warnings=[
            *assumed,
            *([LENGTH_UNKNOWN] if recording.open_ended else []),
            *too_short(recording.duration),
            *(AudioWarning(f.code, f.detail) for f in diagnostics.findings(array)),
            *method_warnings(options.method, method, bundle, array),
        ],
        stretches=sizes,
        why_no_elevation=why_not,
    )


def _counted(joined: Iterable[Stretch], sizes: Counter[int]) -> Iterator[Stretch]:
    for stretch in joined:
        sizes[len(stretch.starts)] += 1
        yield stretch


def _estimate(
    localizer: Localizer, options: LocalizeOptions, shortest: int, stretch: Stretch
) -> list[WindowEstimate]:
    """Estimates of a stretch's windows; silent ones have no sources.

    Nor have those with fewer than ``shortest`` samples of sound, unless their number is known: in
    a few frames any noise looks like one source.
    """
    heard = (w[:, : max(n, 1)] for w, n in zip(stretch.windows, stretch.heard, strict=True))
    silent = [float(np.vecdot(each, each).sum()) < SILENCE * each.size for each in heard]
    if options.num_sources is None:
        silent = [s or n < shortest for s, n in zip(silent, stretch.heard, strict=True)]
    nothing = localizer.nothing
    if all(silent):  # an hour of it compresses to nothing and must cost next to nothing
        return [nothing] * len(silent)
    most = min(options.max_sources, options.array.num_microphones - 1)
    estimates = estimate_stretch(localizer, stretch, options.num_sources, most)
    if not options.sphere:  # images are large, and estimates may come from another process
        estimates = [replace(each, sphere=None) for each in estimates]
    return [nothing if s else each for s, each in zip(silent, estimates, strict=True)]


def _placed(
    estimated: Iterable[tuple[Stretch, list[WindowEstimate]]],
    options: LocalizeOptions,
    duration: float,
    progress: Callable[[float], None] | None,
) -> Iterator[WindowResult]:
    """Windows with their times and the sources to report."""
    for stretch, estimates in estimated:
        for start, estimate in zip(stretch.starts, estimates, strict=True):
            t_end = min(start + options.window_s, duration)
            reported = _on_robot(estimate, options.orientation)
            yield WindowResult(start, t_end, reported)
        if progress:
            progress(min(1.0, stretch.starts[-1] / duration))


def _on_robot(estimate: WindowEstimate, orientation: Orientation) -> WindowEstimate:
    """The sources in the robot's frame, without those in excluded sectors."""
    sources = tuple(
        replace(source, azimuth=orientation.on_robot(source.azimuth))
        for source in estimate.sources
        if not orientation.excludes(source.azimuth)
    )
    return replace(estimate, sources=sources)


def _observed(
    blocks: Iterable[FloatArray], diagnostics: ChannelDiagnostics
) -> Iterator[FloatArray]:
    for block in blocks:
        diagnostics.add(block)
        yield block

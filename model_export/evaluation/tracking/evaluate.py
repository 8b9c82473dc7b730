"""Scores of the tracker on simulated streams: the command ``tracking``.

Development speakers serve for tuning, held-out speakers for the document.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.progress import track as progress

from model_export import SAMPLE_RATE
from model_export.datasets.speech import Split
from model_export.evaluation.evaluate import SEEDS
from model_export.evaluation.false_sources import ARRAY
from model_export.evaluation.tracking.recordings import Estimates, real_tracks
from model_export.evaluation.tracking.report import document
from model_export.evaluation.tracking.scenes import CELLS, LEAD_S, noise_streams, simulate_stream
from model_export.evaluation.tracking.scores import Tally, Update, score
from model_export.evaluation.tracking.turning import turning_table
from model_export.simulation.moving import MovingScene
from service.doa.presets import preset
from service.doa.silence import SILENCE
from service.doa.stft import Stft, StreamingStft
from service.doa.tracking import Detection, Track, Tracker, TrackerParameters
from service.doa.types import FloatArray
from service.inference.registry import BundleRegistry
from service.inference.stream import stream_localizer_of
from service.recordings.results import DEFAULT_MAX_SOURCES

INTERVAL_S = 0.1
"""Seconds between results"""
WINDOW_SAMPLES = Stft().num_samples(32)
"""Window of 0.528 s, in which a talker must be heard to count"""

Detections = list[tuple[float, list[Detection]]]
"""Pairs of stream time in seconds and detections"""


def embedded_estimates() -> Estimates:
    """Localize streams with the embedded bundle, as the service does."""
    array = preset(ARRAY)
    bundle = BundleRegistry.load().for_array(array)
    if bundle is None:
        raise FileNotFoundError(f"no embedded bundle fits the array {array.name}")

    def estimates(audio: FloatArray, interval: float) -> Iterator[tuple[float, list[Detection]]]:
        hop = round(interval * SAMPLE_RATE)
        localizer = stream_localizer_of("neural", bundle, array, bundle.stft)
        stft = StreamingStft(bundle.stft, array.num_microphones)
        for end in range(hop, audio.shape[1] + 1, hop):
            localizer.push(stft.push(audio[:, end - hop : end]))
            latest = audio[:, max(0, end - WINDOW_SAMPLES) : end]
            silent = float(np.mean(latest * latest)) < SILENCE
            sources = () if silent else localizer.estimate(None, DEFAULT_MAX_SOURCES).sources
            yield end / SAMPLE_RATE, [Detection(s.azimuth, s.confidence) for s in sources]

    return estimates


@dataclass(frozen=True, slots=True)
class Stream:
    """Detections of one stream and its scene; None where nobody talks."""

    cell: str
    detections: Detections
    scene: MovingScene | None
    least_voiced: int = 1


def simulate_streams(
    speech: Sequence[FloatArray], seed: int, estimates: Estimates, interval: float
) -> Iterator[Stream]:
    """Simulate all streams with talkers, then all without."""
    tasks = [(cell, index) for cell in CELLS for index in range(cell.streams)]
    for cell, index in progress(tasks, description="talkers"):
        scene = simulate_stream(cell, speech, seed, index)
        found = list(estimates(scene.audio, interval))
        yield Stream(cell.name, found, scene, cell.least_voiced)
    for name, audio in progress(noise_streams(seed).items(), description="noises"):
        yield Stream(name, list(estimates(audio, interval)), None)


def follow(stream: Stream, parameters: TrackerParameters | None = None) -> Iterator[Update]:
    """Track a stream; every update has the truth beside the tracks."""
    tracker = Tracker(parameters)
    for time, detections in stream.detections:
        yield _update(stream, time, tracker.update(detections, time))


def untracked(stream: Stream) -> Iterator[Update]:
    """Make each detection a track of its own: the baseline of tracking."""
    number = 0
    for time, detections in stream.detections:
        tracks = []
        for found in detections:
            number += 1
            tracks.append(
                Track(number, found.azimuth, 0.0, 0.0, found.confidence, True, time, time)
            )
        yield _update(stream, time, tracks)


def _update(stream: Stream, time: float, tracks: Sequence[Track]) -> Update:
    if stream.scene is None:
        return Update(time, np.zeros(0), np.zeros(0, dtype=bool), tracks)
    voiced = stream.scene.voiced(time, WINDOW_SAMPLES / SAMPLE_RATE)
    return Update(time, stream.scene.azimuths(time), voiced, tracks)


def tally_streams(
    streams: Iterable[Stream], tracks: Callable[[Stream], Iterable[Update]]
) -> dict[str, Tally]:
    """Scores of every cell."""
    tallies: dict[str, Tally] = {}
    for stream in streams:
        tally = tallies.setdefault(stream.cell, Tally())
        updates = list(tracks(stream))
        score(updates, tally, least_voiced=stream.least_voiced)
        if stream.scene is not None:
            first = next((u.time for u in updates if any(t.active for t in u.tracks)), None)
            onset = LEAD_S + min(_onset(talker.speech) for talker in stream.scene.talkers)
            if first is not None:
                tally.latencies.append(first - onset)
    return tallies


def _onset(speech: FloatArray) -> float:
    """Seconds from the end of the lead to the first sample a tenth as loud as the loudest."""
    lead = round(LEAD_S * SAMPLE_RATE)
    loud = np.abs(speech[lead:]) > 0.1 * np.abs(speech).max()
    return float(np.argmax(loud)) / SAMPLE_RATE


def evaluate(speech: Sequence[FloatArray], split: Split, recordings: Path | None) -> str:
    """``docs/tracking.md``, measured on a split's speech and, if there are any, on recordings."""
    estimates = embedded_estimates()
    real = real_tracks(recordings, estimates, INTERVAL_S) if recordings else {}
    streams = list(simulate_streams(speech, SEEDS[split], estimates, INTERVAL_S))
    tracked = tally_streams(streams, follow)
    turning = turning_table(speech, SEEDS[split])
    return document(tracked, tally_streams(streams, untracked), split, real, turning)

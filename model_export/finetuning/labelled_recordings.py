"""Labelled recordings of one array: decoded, checked, and gated by level for training windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.progress import track

from model_export.finetuning.labels import Segment, Talker, read_labels, segments
from model_export.simulation.scenes import WINDOW_SAMPLES
from model_export.training.task import STFT
from neuralmusic.errors import DoaError
from service.cli.inputs import open_recording, read_channel_map
from service.doa.array import MicrophoneArray
from service.doa.diagnostics import ChannelDiagnostics, Finding
from service.doa.diagnostics.levels import decibels
from service.doa.mirror import into_searched_half
from service.doa.types import BoolArray, FloatArray, IntArray
from service.inference.geometry import choose_channels
from service.inference.results import MAX_SOURCES

FRAME_SAMPLES = 512
"""Frame of the level gate, 32 ms"""
GRAIN_FRAMES = 4
"""Number of consecutive quiet frames that make a grain of noise"""
MIN_CONTRAST = 6.0
"""Least difference in dB of loud and quiet frames; below it the sound is steady, without pauses"""
GATE_RANGE = 25.0
"""Frames this many dB below the loud ones are never above the gate"""
MIN_SOUND = 0.15
"""Share of a window's frames that must hold sound: one short word is enough"""
REFUSED = frozenset({"non_finite", "quiet", "channel_dead", "channels_identical", "clipping"})
"""Findings of the channel diagnostics that make a recording useless; others are warnings"""


@dataclass(frozen=True, slots=True)
class LabelledWindows:
    """Starts of windows with the same talkers."""

    azimuth: FloatArray
    """(M,) radians"""
    starts: IntArray
    """Samples, a frame apart; up to ``last``, windows may also start between them"""
    last: int
    """Start of the segment's last window, in samples"""


@dataclass(frozen=True, slots=True)
class LabelledRecording:
    """One recording of the array with what is known about it."""

    path: Path
    audio: FloatArray
    """(N, T) float32 at 16 kHz; channel n is microphone n"""
    windows: tuple[LabelledWindows, ...]
    """Windows, at least one group, each with at least one start"""
    quiet: IntArray
    """Samples at which a grain of ``GRAIN_FRAMES`` quiet frames starts"""
    warnings: tuple[str, ...]

    @property
    def direction(self) -> int:
        """The first talker's azimuth in whole degrees, by which recordings are held out."""
        return round(float(np.rad2deg(self.windows[0].azimuth[0]))) % 360


def load_recordings(
    folder: Path, array: MicrophoneArray, channel_map: str | None = None
) -> list[LabelledRecording]:
    """Decode and check every labelled recording of a folder.

    Parameters
    ----------
    channel_map : str, optional
        Recording channel of every microphone, such as ``1,2,3,4``; by default all channels, or the
        known layout of the array's firmware.

    Raises
    ------
    FileNotFoundError, ValueError
        If a label or a recording cannot be used; the message names the file and what to do.
    """
    loaded = []
    for path, talkers in track(read_labels(folder).items(), description="reading recordings"):
        try:
            loaded.append(load_recording(path, talkers, array, channel_map))
        except DoaError as error:
            raise ValueError(f"{path}: {error.detail}") from error
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
    return loaded


def load_recording(
    path: Path, talkers: Sequence[Talker], array: MicrophoneArray, channel_map: str | None = None
) -> LabelledRecording:
    """Load one recording, resampled as in the service; raises DoaError or ValueError."""
    with open_recording(path) as recording:
        if recording.channels < array.num_microphones:
            raise ValueError(_too_few(recording.channels, array))
        channels, assumed = choose_channels(
            recording.channels, array, read_channel_map(channel_map)
        )
        diagnostics = ChannelDiagnostics(STFT.sample_rate, len(channels), channels)
        blocks = []
        for block in recording.blocks(channels, STFT.sample_rate):
            diagnostics.add(block)
            blocks.append(block)
    audio = np.concatenate(blocks, axis=1)
    found = segments(talkers, audio.shape[1] / STFT.sample_rate)
    _check_segments(found)
    warnings = (
        *(warning.detail for warning in assumed),
        *_check_findings(diagnostics.findings(array)),
    )
    sounding, quiet = level_gate(audio)
    windows = tuple(filter(_usable, (_windows(segment, sounding, array) for segment in found)))
    if not windows:
        raise ValueError("the labelled parts hold no sound: check the label's times")
    return LabelledRecording(path, audio, windows, _grains(quiet), warnings)


def level_gate(audio: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Whether each frame of ``FRAME_SAMPLES`` holds sound, and whether it is quiet, (K,) bool each.

    The gate lies halfway, in decibels, between the recording's loud and quiet frames, so that it
    adapts to the room's noise. Frames slightly above the quiet ones, in which reverberation decays,
    are neither.
    """
    frames = audio.shape[1] // FRAME_SAMPLES
    blocks = audio[:, : frames * FRAME_SAMPLES].reshape(len(audio), frames, FRAME_SAMPLES)
    level = decibels(np.sqrt(np.mean(blocks**2, axis=(0, 2)) + 1e-20))
    low, high = np.percentile(level, [5, 95])
    if high - low < MIN_CONTRAST:
        return np.ones(frames, dtype=bool), np.zeros(frames, dtype=bool)
    gate = max((low + high) / 2, high - GATE_RANGE)
    return level >= gate, level < min(gate, low + MIN_CONTRAST / 2)


def _too_few(channels: int, array: MicrophoneArray) -> str:
    return (
        f"the recording has {channels} channels, but {array.name} has {array.num_microphones} "
        "microphones: record all of them, or name the array that was used"
    )


def _check_segments(found: Sequence[Segment]) -> None:
    longest = max((segment.end - segment.start for segment in found), default=0.0)
    if longest * STFT.sample_rate < WINDOW_SAMPLES:
        raise ValueError(
            f"too short: the longest part with the same talkers lasts {longest:.2f} s, a window "
            f"takes {WINDOW_SAMPLES / STFT.sample_rate:g} s; record five seconds"
        )
    most = max(len(segment.azimuth) for segment in found)
    if most > MAX_SOURCES:
        raise ValueError(f"{most} talkers are labelled at once, at most {MAX_SOURCES} are possible")


def _check_findings(findings: Sequence[Finding]) -> tuple[str, ...]:
    for finding in findings:
        if finding.code in REFUSED:
            raise ValueError(finding.detail)
    return tuple(finding.detail for finding in findings)


def _windows(segment: Segment, sounding: BoolArray, array: MicrophoneArray) -> LabelledWindows:
    """Starts of the windows inside a segment that hold enough sound."""
    # A line cannot tell front from back; the target is the talker's image in front of it.
    azimuth = into_searched_half(array, np.array(segment.azimuth))
    first = int(np.ceil(segment.start * STFT.sample_rate))
    # A segment ends with the audio or a label's time: rounding must not lose its only window.
    last = round(segment.end * STFT.sample_rate) - WINDOW_SAMPLES
    starts = np.arange(first, last + 1, FRAME_SAMPLES)
    total = np.concatenate([[0], np.cumsum(sounding)])
    begin = starts // FRAME_SAMPLES
    end = np.minimum((starts + WINDOW_SAMPLES) // FRAME_SAMPLES, len(sounding))
    share = (total[end] - total[begin]) / np.maximum(end - begin, 1)
    return LabelledWindows(azimuth, starts[share >= MIN_SOUND], last)


def _usable(windows: LabelledWindows) -> bool:
    return len(windows.starts) > 0


def _grains(quiet: BoolArray) -> IntArray:
    runs = np.lib.stride_tricks.sliding_window_view(quiet, GRAIN_FRAMES).all(axis=-1)
    return np.flatnonzero(runs) * FRAME_SAMPLES

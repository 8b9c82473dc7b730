"""Unlabelled multichannel recordings as training scenes: random windows that are loud enough.

Files are decoded, resampled and checked as in the service, and kept in memory as float16: about
half a gigabyte for an hour of four microphones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from model_export.simulation.scenes import WINDOW_SAMPLES, Scene
from model_export.training.config import TrainingConfig
from model_export.training.task import STFT
from neuralmusic.errors import AudioError
from service.audio.recording import Recording
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray, IntArray
from service.inference.geometry import choose_channels

SUFFIXES = (".wav", ".flac")
GATE_DB = 20.0
"""Windows are cut whose level is at most this far below the recording's loudest window"""
SILENCE_LEVEL = 1e-5
"""RMS against full scale, -100 dB; a recording that is never above it is muted"""
HOP_SAMPLES = 1000
"""Samples between the starts of candidate windows, 1/16 s"""
VALIDATION_FILES = 10
"""One file in this many only validates"""


@dataclass(frozen=True, slots=True)
class RecordedScenes:
    """Windows of recordings, all of the same array; no direction is known."""

    array: MicrophoneArray
    audio: Sequence[FloatArray]
    """Recordings, each (N, T) float16 with a peak of 1"""
    starts: Sequence[IntArray]
    """First samples of the windows that are loud enough, for each recording"""

    @classmethod
    def split(cls, folder: Path, array: MicrophoneArray) -> tuple[Self, Self]:
        """Files to train on and files to validate with; fewer than ten files all do both.

        Raises
        ------
        ValueError
            If there is no WAV or FLAC file, or a file cannot be used; the message names it.
        """
        paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
        if not paths:
            raise ValueError(f"no WAV or FLAC file below {folder}: name the recordings' folder")
        if len(paths) < VALIDATION_FILES:
            scenes = cls.load(paths, array)
            return scenes, scenes
        validation = paths[::VALIDATION_FILES]
        return cls.load(sorted({*paths} - {*validation}), array), cls.load(validation, array)

    @classmethod
    def load(cls, paths: Sequence[Path], array: MicrophoneArray) -> Self:
        """Decode recordings and find their loud windows."""
        audio = [decode(path, array) for path in paths]
        return cls(array, audio, [loud_starts(samples) for samples in audio])

    def scenes(self, rng: np.random.Generator, config: TrainingConfig) -> Iterator[Scene]:
        """An endless supply of windows, uniform over all loud ones."""
        windows = [(file, start) for file, starts in enumerate(self.starts) for start in starts]
        while True:
            file, start = windows[rng.integers(len(windows))]
            window = self.audio[file][:, start : start + WINDOW_SAMPLES].astype(np.float32)
            yield Scene(window, self.array.positions, np.empty(0))


def decode(path: Path, array: MicrophoneArray) -> FloatArray:
    """Decode the array's channels (N, T) float16 at 16 kHz, scaled to a peak of 1.

    Raises
    ------
    ValueError
        If the recording cannot be decoded, lacks a channel for a microphone, is shorter than a
        window or silent.
    """
    try:
        with Recording.open(path) as recording:
            channels, _ = choose_channels(recording.channels, array, None)
            samples = np.concatenate(list(recording.blocks(channels, STFT.sample_rate)), axis=1)
    except AudioError as error:
        raise ValueError(f"{path}: {error}") from error
    if samples.shape[1] < WINDOW_SAMPLES:
        seconds = WINDOW_SAMPLES / STFT.sample_rate
        raise ValueError(f"{path}: shorter than a window of {seconds:.2f} s: remove it")
    if window_levels(samples).max() < SILENCE_LEVEL:
        raise ValueError(f"{path}: silent from beginning to end: remove it")
    # A recording's gain has no meaning, and float16 cannot hold the integers of some formats.
    return (samples / np.abs(samples).max()).astype(np.float16)


def window_levels(samples: FloatArray) -> FloatArray:
    """RMS (W,) over microphones and time of the windows that start every ``HOP_SAMPLES``."""
    power = np.square(samples, dtype=np.float32).mean(axis=0, dtype=np.float64)  # (T,)
    total = np.concatenate([[0.0], np.cumsum(power)])
    starts = np.arange(0, samples.shape[1] - WINDOW_SAMPLES + 1, HOP_SAMPLES)
    mean = (total[starts + WINDOW_SAMPLES] - total[starts]) / WINDOW_SAMPLES
    levels: FloatArray = np.sqrt(np.maximum(mean, 0))
    return levels


def loud_starts(samples: FloatArray) -> IntArray:
    """First samples of the windows within ``GATE_DB`` of the loudest one."""
    levels = window_levels(samples)
    loud: IntArray = np.flatnonzero(levels >= levels.max() * 10 ** (-GATE_DB / 20)) * HOP_SAMPLES
    return loud

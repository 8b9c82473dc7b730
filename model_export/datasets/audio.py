"""Audio files of data sets, decoded and resampled as the service does it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from model_export import SAMPLE_RATE
from model_export.datasets.fault import REMEDY, DatasetError, require
from neuralmusic.errors import DoaError
from service.audio.recording import Recording
from service.doa.types import FloatArray


def read_audio(path: Path, channels: int, take: Sequence[int] | None = None) -> FloatArray:
    """All samples at 16 kHz, whatever the file's rate.

    Parameters
    ----------
    channels : int
        Number of channels that the file must have.
    take : sequence of int, optional
        Channels to read, counted from 0; by default all.

    Returns
    -------
    audio : (N, T) float32

    Raises
    ------
    DatasetError
        If the file is missing, cannot be decoded or has another number of channels.
    """
    require(path, REMEDY)
    try:
        with Recording.open(path) as recording:
            _check_channels(path, recording, channels)
            blocks = recording.blocks(take or range(channels), SAMPLE_RATE)
            return np.concatenate(list(blocks), axis=1)
    except DoaError as error:
        raise DatasetError("audio", path, error.detail) from error


def check_audio(path: Path, channels: int, sample_rate: int | None = None) -> float:
    """Check a file by its header, without decoding samples, and return its duration in seconds.

    Raises
    ------
    DatasetError
        If the file is missing, shorter than its header says, or has another number of channels or
        another sample rate than ``sample_rate`` (None: any rate).
    """
    require(path, REMEDY)
    try:
        with Recording.open(path) as recording:
            _check_channels(path, recording, channels)
            rate, duration = recording.sample_rate, recording.duration
    except DoaError as error:
        raise DatasetError("audio", path, error.detail) from error
    if sample_rate not in (None, rate):
        raise DatasetError(
            "sample_rate",
            path,
            f"has {rate} Hz, expected {sample_rate} Hz: it was resampled, {REMEDY}",
        )
    return duration


def _check_channels(path: Path, recording: Recording, channels: int) -> None:
    if recording.channels != channels:
        raise DatasetError(
            "channels",
            path,
            f"has {recording.channels} channel{'s' if recording.channels > 1 else ''}, expected "
            f"{channels}: a conversion may have mixed or dropped some, {REMEDY}",
        )

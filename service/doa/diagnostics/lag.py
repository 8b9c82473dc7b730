"""Late and inverted channels, by generalized cross-correlation over the excerpt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft

from service.doa.array import MAX_APERTURE, SPEED_OF_SOUND
from service.doa.diagnostics.finding import Finding, channel_list, is_or_are
from service.doa.types import BoolArray, FloatArray

MARGIN_S = 1.5e-4  # two samples at 16 kHz: peaks of reverberant speech wander by one
MAX_LAG_S = 0.1  # a fifth of a segment; later channels share too little of it
INVERTED = 1.2
"""Least ratio of the correlation's trough to its peak: at most 0.7 on 120 good recordings of bare
arrays and rigid spheres, at least 1.4 with a channel inverted"""
PEAK_OVER_SPREAD = 8.0  # a peak among thousands of lags of noise reaches 4 to 5


@dataclass(frozen=True, slots=True)
class Alignment:
    """Delay and polarity of N channels against the first one."""

    lags: FloatArray
    """(N,) seconds, positive where late; NaN where the channels share too little sound to tell"""
    inverted: BoolArray
    """(N,) whether the sound has the other sign"""


def alignment(segments: Sequence[FloatArray], sample_rate: int) -> Alignment:
    """The alignment of the channels of segments (N, T) float32 at ``sample_rate`` hertz."""
    length = max(segment.shape[-1] for segment in segments)
    n_fft = scipy.fft.next_fast_len(2 * length, real=True)
    cross = np.zeros((segments[0].shape[0], n_fft // 2 + 1), dtype=np.complex64)
    for segment in segments:
        spectra = scipy.fft.rfft(segment, n_fft, axis=-1)
        product = spectra * np.conj(spectra[0])
        cross += product / np.maximum(np.abs(product), np.finfo(np.float32).tiny)
    frequency = scipy.fft.rfftfreq(n_fft, 1 / sample_rate)
    cross[:, (frequency < 200) | (frequency > 6000)] = 0  # hum, and a band that few recordings hold
    correlation = scipy.fft.irfft(cross, n_fft, axis=-1)
    reach = min(round(MAX_LAG_S * sample_rate), length // 2)
    around = np.concatenate([correlation[:, -reach:], correlation[:, : reach + 1]], axis=-1)
    inverted = -around.min(axis=-1) > INVERTED * around.max(axis=-1)
    around[inverted] *= -1
    peak = around.max(axis=-1)
    spread = np.maximum(around.std(axis=-1), np.finfo(np.float32).tiny)
    known = peak > PEAK_OVER_SPREAD * spread
    lags = (around.argmax(axis=-1) - reach) / sample_rate
    return Alignment(np.where(known, lags, np.nan), inverted & known)


def polarity_findings(inverted: BoolArray, names: Sequence[int]) -> list[Finding]:
    """``channel_inverted`` for the channels (N,) whose sign is not that of most others."""
    if not inverted.any():
        return []
    flipped = ~inverted if 2 * np.count_nonzero(inverted) > len(inverted) else inverted
    channels = tuple(name for name, flag in zip(names, flipped, strict=True) if flag)
    others = tuple(name for name, flag in zip(names, flipped, strict=True) if not flag)
    either = ", or they are" if 2 * len(channels) == len(names) else ""
    detail = (
        f"{channel_list(channels)} {is_or_are(channels)} inverted against {channel_list(others)}"
        f"{either}: the sound has the other sign there, which makes directions wrong; swap the two "
        f"wires of the microphone, or multiply the samples by -1"
    )
    return [Finding("channel_inverted", detail, channels)]


def lag_findings(
    segments: Sequence[FloatArray], sample_rate: int, distances: FloatArray, names: Sequence[int]
) -> list[Finding]:
    """Findings about channels whose lag no direction of sound explains.

    Parameters
    ----------
    segments : list of (N, T) float32
    sample_rate : int
        Hertz.
    distances : (N, N) float
        Metres between the microphones; ``MAX_APERTURE`` where the array is unknown.
    names : sequence of int
        Recording channels.
    """
    if not segments or len(names) < 2:
        return []
    lags = alignment(segments, sample_rate).lags
    # Only lags behind channel 0 itself are compared with a distance: with several sources, the
    # peaks of two other channels may belong to different ones and their difference to none.
    excess = np.abs(lags) > distances[0] / SPEED_OF_SOUND + MARGIN_S  # NaN is never in excess
    late = [int(index) for index in np.flatnonzero(excess)]
    if not late:
        return []
    if len(names) > 2 and len(late) == len(names) - 1:
        return [_finding(names[0], -float(np.median(lags[1:])))]
    others = float(np.nanmedian(np.delete(lags, late)))
    return [_finding(names[index], float(lags[index]) - others) for index in late]


def _finding(channel: int, lag: float) -> Finding:
    detail = (
        f"channel {channel} is {abs(lag) * 1000:.2f} ms {'late' if lag > 0 else 'early'} against "
        f"the other channels, more than sound needs across the array: capture all channels by one "
        f"device, and check the array's size and the file's sample rate"
    )
    return Finding("channel_late", detail, (channel,))


def unknown_distances(count: int) -> FloatArray:
    """(N, N) the largest distances that an array may have."""
    return np.full((count, count), MAX_APERTURE)

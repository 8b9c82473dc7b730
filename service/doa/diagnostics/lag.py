"""Channels later than any sound can be, by generalized cross-correlation over the excerpt."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.fft

from service.doa.array import MAX_APERTURE, SPEED_OF_SOUND
from service.doa.diagnostics.finding import Finding
from service.doa.types import FloatArray

MARGIN_S = 1.5e-4  # two samples at 16 kHz: peaks of reverberant speech wander by one
MAX_LAG_S = 0.1  # a fifth of a segment; later channels share too little of it
PEAK_OVER_SPREAD = 8.0  # a peak among thousands of lags of noise reaches 4 to 5


def channel_lags(segments: Sequence[FloatArray], sample_rate: int) -> FloatArray:
    """Lag of every channel behind the first one, in seconds.

    Parameters
    ----------
    segments : list of (N, T) float32
    sample_rate : int
        Hertz.

    Returns
    -------
    lags : (N,) float64
        Positive where late; NaN where the channels share too little sound to tell.
    """
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
    peak = around.max(axis=-1)
    spread = np.maximum(around.std(axis=-1), np.finfo(np.float32).tiny)
    lags = (around.argmax(axis=-1) - reach) / sample_rate
    return np.where(peak > PEAK_OVER_SPREAD * spread, lags, np.nan)


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
    lags = channel_lags(segments, sample_rate)
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

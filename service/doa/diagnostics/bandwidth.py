"""Audio whose spectrum ends far below half the sample rate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.doa.diagnostics.finding import Finding
from service.doa.stft import Stft
from service.doa.types import FloatArray

CLIFF = 20.0  # dB; a long-term spectrum of speech or noise falls by a few dB over this span
NEARLY = 6.0  # dB
LOWEST_EDGE = 1000.0  # Hz; an end below it is a tone or rumble rather than a sample rate
HIGHEST_EDGE = 0.75  # of Nyquist: anti-aliasing filters of honest recordings begin above it
SILENT_POWER = 1e-14  # full scale squared per bin; less is the same as nothing


def spectrum_edge(segments: Sequence[FloatArray], sample_rate: int) -> float | None:
    """Frequency in hertz at which the spectrum ends, or None where it does not end early.

    Parameters
    ----------
    segments : list of (N, T) float32
    sample_rate : int
        Hertz.
    """
    stft = Stft(sample_rate, 512, 256)
    usable = [segment for segment in segments if segment.shape[-1] >= stft.n_fft]
    if not usable:
        return None
    power = np.mean(
        [np.mean(np.abs(stft.transform(segment)) ** 2, axis=(0, 2)) for segment in usable], axis=0
    )
    level = 10 * np.log10(power / stft.n_fft**2 + SILENT_POWER)
    return _cliff(level[:-4], stft.frequencies[:-4])  # the last bins are the converter's filter


def _cliff(level: FloatArray, frequencies: FloatArray) -> float | None:
    # The highest level above each bin: a single line up there means that the spectrum goes on.
    above = np.maximum.accumulate(level[::-1])[::-1]
    drops = np.zeros(len(level))
    inside = (frequencies >= LOWEST_EDGE) & (frequencies <= HIGHEST_EDGE * frequencies[-1])
    bins = np.flatnonzero(inside)
    low, high = (0.8 * bins).astype(int), (0.95 * bins).astype(int) + 1
    total = np.concatenate([[0.0], np.cumsum(level, dtype=np.float64)])
    mean = (total[high] - total[low]) / (high - low)
    drops[bins] = mean - above[np.ceil(1.1 * bins).astype(int) + 1]
    if drops.max() < CLIFF:
        return None
    # Every place within the span sees the cliff; the lowest that sees nearly all of it is its top.
    return float(frequencies[np.argmax(drops > drops.max() - NEARLY)])


def bandwidth_findings(segments: Sequence[FloatArray], sample_rate: int) -> list[Finding]:
    """``band_limited`` where the spectrum ends far below half the sample rate."""
    edge = spectrum_edge(segments, sample_rate)
    if edge is None:
        return []
    detail = (
        f"there is no sound above {edge / 1000:.1f} kHz, though a sample rate of {sample_rate} Hz "
        f"reaches {sample_rate / 2000:g} kHz: the audio was recorded or sent at a lower rate; "
        f"directions get coarser without the upper band"
    )
    return [Finding("band_limited", detail)]

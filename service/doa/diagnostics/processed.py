"""Channels that are not microphones of the array: a device's processed or playback channel.

The levels of one small array's microphones rise and fall together: the difference of two channels'
levels in a band stays the same from moment to moment. A channel after beamforming, noise
suppression or automatic gain, or one with other content, follows a level of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.doa.diagnostics.finding import Finding, channel_list, is_or_are
from service.doa.stft import Stft
from service.doa.types import ComplexArray, FloatArray, IntArray

FRAME_S = 0.064
BANDS = ((300.0, 800.0), (800.0, 1600.0), (1600.0, 3200.0), (3200.0, 7000.0))
"""Bands in hertz. Each is judged by itself and the median counts, so a filter or cover before one
microphone, which is the same at all times, makes no difference"""
MIN_FRAMES = 60
FLOOR = 1e-12
"""Power per bin that counts as zero: rounding of 16-bit audio"""
MIN_SPREAD = 2.0
"""Least standard deviation in dB of a foreign channel's level difference to every other channel"""
SPREAD_RATIO = 2.0
"""Least ratio of that deviation to the largest between two of the other channels"""
WIDER = 1.5
"""Least excess in dB of a processed channel's range from pauses to loud moments: beamformers and
noise suppression lower the noise. A microphone with more noise of its own also has a level of its
own, but a smaller range."""
FOREIGN_SPREAD = 6.0
"""Standard deviation in dB from which a channel is foreign whatever its pauses are"""
SHARED_NOISE = 0.07
"""Excess of a beam's coherence in the pauses with every other channel, over the largest of two
others: a beam holds the noise of each of its microphones, which is not coherent between them"""
NOISE_BAND = (3200.0, 7000.0)
"""Band in hertz; below it noise of the room is coherent between neighbouring microphones"""


@dataclass(frozen=True, slots=True)
class LevelUnity:
    """How closely the levels of N channels move together."""

    spread: FloatArray
    """(N, N) standard deviations of level differences in dB"""
    range: FloatArray
    """(N,) dB from the quiet to the loud moments"""
    coherence: FloatArray
    """(N, N) magnitude of the coherence in the quiet moments of ``NOISE_BAND``"""


def level_unity(segments: Sequence[FloatArray], sample_rate: int) -> LevelUnity | None:
    """Compare levels from frame to frame; None where there are too few frames.

    Parameters
    ----------
    segments : list of (N, T) float32
    sample_rate : int
        Hertz.
    """
    n_fft = 1 << round(np.log2(FRAME_S * sample_rate))
    stft = Stft(sample_rate, n_fft, n_fft)
    usable = [segment for segment in segments if segment.shape[-1] >= n_fft]
    if not usable or sum(stft.num_frames(segment.shape[-1]) for segment in usable) < MIN_FRAMES:
        return None
    spectra = np.concatenate([stft.transform(segment) for segment in usable], axis=-1)
    power = spectra.real**2 + spectra.imag**2  # (N, F, L)
    spreads, ranges = [], []
    for low, high in BANDS:
        band = (stft.frequencies >= low) & (stft.frequencies < high)
        if not band.any():
            continue
        level = 10 * np.log10(power[:, band].mean(axis=1) / n_fft + FLOOR)  # (N, L)
        spreads.append(np.std(level[:, None] - level[None], axis=-1))
        moments = np.argsort(np.median(level, axis=0))
        few = max(1, len(moments) // 6)
        loud, quiet = level[:, moments[-few:]], level[:, moments[:few]]
        ranges.append(loud.mean(axis=-1) - quiet.mean(axis=-1))
    band = (stft.frequencies >= NOISE_BAND[0]) & (stft.frequencies < NOISE_BAND[1])
    level = np.median(power[:, band].mean(axis=1), axis=0)
    quiet = np.argsort(level)[: max(1, len(level) // 6)]
    return LevelUnity(
        np.median(spreads, axis=0),
        np.median(ranges, axis=0),
        _coherence(spectra[:, band][:, :, quiet]),
    )


def _coherence(spectra: ComplexArray) -> FloatArray:
    """(N, N) root mean square over bins of the coherence of spectra (N, F, L)."""
    by_bin = np.swapaxes(spectra, 0, 1)  # (F, N, L)
    cross = by_bin @ np.conj(np.swapaxes(by_bin, -1, -2))
    power = np.maximum(np.einsum("fnn->fn", cross).real, FLOOR)  # its square still fits float32
    squared = np.abs(cross) ** 2 / (power[:, :, None] * power[:, None])
    coherence: FloatArray = np.sqrt(squared.mean(axis=0))
    return coherence


def foreign_channel(unity: LevelUnity) -> int | None:
    """The index of the one channel that follows a level of its own, or None."""
    count = len(unity.range)
    if count < 3:
        return None  # of two, either may be the foreign one
    for index in range(count):
        rest = np.delete(np.arange(count), index)
        own, others = _against(unity.spread, index, rest)
        shared, usual = _against(unity.coherence, index, rest)
        wider = float(unity.range[index] - unity.range[rest].max())
        moves = own >= max(MIN_SPREAD, SPREAD_RATIO * others)
        beam = own > others and shared >= usual + SHARED_NOISE
        if (wider >= WIDER and (moves or beam)) or (moves and own >= FOREIGN_SPREAD):
            return index
    return None


def _against(pairs: FloatArray, index: int, rest: IntArray) -> tuple[float, float]:
    """The least of the channel's pairs, and the largest of the pairs of the rest."""
    others = pairs[np.ix_(rest, rest)][np.triu_indices(len(rest), 1)]
    return float(pairs[index, rest].min()), float(others.max())


def processed_findings(
    segments: Sequence[FloatArray], sample_rate: int, names: Sequence[int]
) -> list[Finding]:
    """``channel_processed`` where one channel is not a raw microphone."""
    unity = level_unity(segments, sample_rate)
    index = None if unity is None else foreign_channel(unity)
    if unity is None or index is None:
        return []
    rest = np.delete(np.arange(len(names)), index)
    own, usual = _against(unity.spread, index, rest)
    others = [name for other, name in enumerate(names) if other != index]
    detail = (
        f"channel {names[index]} is not a microphone like the others: its level moves by "
        f"{own:.1f} dB against {channel_list(others)}, which "
        f"{is_or_are(others)} within {usual:.1f} dB of each "
        f"other. Devices deliver a processed channel and one of the playback beside the raw "
        f"microphones: name the raw ones with channel_map; if it is one, check its microphone"
    )
    return [Finding("channel_processed", detail, (names[index],))]

"""Levels of every channel, counted sample by sample, and findings from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.doa.diagnostics.finding import Finding, channel_list, is_or_are
from service.doa.types import BoolArray, FloatArray, IntArray

FULL_SCALE = 0.999  # of 1.0: 16-bit audio ends at 32767/32768, and resampling blurs the edge
CLIPPED_SHARE = 5e-4  # one sample in two thousand; single clipped peaks do not move directions
DEAD_BELOW = 40.0  # dB; gains of one array's microphones differ by a few dB, never by this much
OFFSET_LIMIT = 0.02  # of full scale; converters of working arrays stay below a tenth of it
SILENCE = 1e-6  # of full scale, -120 dBFS: below the last bit of 16-bit audio


@dataclass(frozen=True, slots=True)
class ChannelLevels:
    """Levels of N channels over a whole recording."""

    rms: FloatArray
    """(N,) dBFS without the offset; -inf for a constant channel"""
    peak: FloatArray
    """(N,) dBFS; -inf for zeros"""
    clipped: FloatArray
    """(N,) share of the samples at full scale"""
    offset: FloatArray
    """(N,) mean, as a share of full scale"""
    non_finite: IntArray
    """(N,) count of samples that are NaN or infinite; they count as zeros elsewhere"""


class LevelMeter:
    """Sums over blocks of audio that give the levels."""

    def __init__(self, num_channels: int) -> None:
        self._count = 0
        self._sum = np.zeros(num_channels)
        self._squares = np.zeros(num_channels)
        self._peak = np.zeros(num_channels)
        self._clipped = np.zeros(num_channels, dtype=np.int64)
        self._non_finite = np.zeros(num_channels, dtype=np.int64)

    def add(self, block: FloatArray) -> FloatArray:
        """Count a block (N, T); return it with zeros where it is not finite."""
        if block.shape[-1] == 0:
            return block
        peak = np.abs(block).max(axis=-1)  # not finite where a sample is not
        if not np.isfinite(peak).all():
            finite = np.isfinite(block)
            self._non_finite += np.count_nonzero(~finite, axis=-1)
            block = np.where(finite, block, np.float32(0.0))
            peak = np.abs(block).max(axis=-1)
        exact = block.astype(np.float64)
        self._count += block.shape[-1]
        self._sum += exact.sum(axis=-1)
        self._squares += np.vecdot(exact, exact)
        self._peak = np.maximum(self._peak, peak)
        if (peak >= FULL_SCALE).any():
            self._clipped += np.count_nonzero(np.abs(block) >= FULL_SCALE, axis=-1)
        return block

    def levels(self) -> ChannelLevels:
        """The levels of the audio so far."""
        count = max(self._count, 1)
        mean = self._sum / count
        # Rounding leaves a constant channel with a little power, below the last bit.
        variance = np.maximum(self._squares / count - mean**2, 0.0)
        deviation = np.sqrt(np.where(variance < SILENCE**2, 0.0, variance))
        return ChannelLevels(
            rms=decibels(deviation),
            peak=decibels(self._peak),
            clipped=self._clipped / count,
            offset=mean,
            non_finite=self._non_finite.copy(),
        )


def _flagged(flags: BoolArray, names: Sequence[int]) -> tuple[int, ...]:
    return tuple(name for name, flag in zip(names, flags, strict=True) if flag)


def decibels(amplitude: FloatArray) -> FloatArray:
    """20 log10, -inf for zeros."""
    with np.errstate(divide="ignore"):
        level: FloatArray = 20 * np.log10(amplitude)
    return level


def dead_channels(levels: ChannelLevels) -> tuple[int, ...]:
    """Indices of channels that are constant, or far below the median of the other ones.

    A recording whose channels are all silent has no dead channel: it is quiet.
    """
    rms = levels.rms
    if not np.isfinite(rms).any():
        return ()
    dead = []
    for index in range(rms.size):
        others = np.median(np.maximum(np.delete(rms, index), -200.0)) if rms.size > 1 else -200.0
        if not np.isfinite(rms[index]) or rms[index] < others - DEAD_BELOW:
            dead.append(index)
    return tuple(dead)


def level_findings(levels: ChannelLevels, names: Sequence[int]) -> list[Finding]:
    """Dead, clipped, off-centre and non-finite channels; ``names`` are the recording channels."""
    return [
        *_non_finite(levels, names),
        *_dead(levels, names),
        *_clipping(levels, names),
        *_offset(levels, names),
    ]


def _non_finite(levels: ChannelLevels, names: Sequence[int]) -> list[Finding]:
    channels = _flagged(levels.non_finite > 0, names)
    if not channels:
        return []
    detail = (
        f"{int(levels.non_finite.sum())} samples of {channel_list(channels)} are NaN or infinite: "
        f"find the program that wrote them; a stream takes them as 0, a recording is refused"
    )
    return [Finding("non_finite", detail, channels)]


def _dead(levels: ChannelLevels, names: Sequence[int]) -> list[Finding]:
    dead = dead_channels(levels)
    channels = tuple(names[i] for i in dead)
    if not channels:
        return []
    constant = not np.isfinite(levels.rms[list(dead)]).any()
    how = "silent" if constant else f"more than {DEAD_BELOW:g} dB below the other channels"
    detail = (
        f"{channel_list(channels)} {is_or_are(channels)} {how}: check the microphone and its "
        f"cable, and that channel_map does not name a playback channel"
    )
    return [Finding("channel_dead", detail, channels)]


def _clipping(levels: ChannelLevels, names: Sequence[int]) -> list[Finding]:
    channels = _flagged(levels.clipped >= CLIPPED_SHARE, names)
    if not channels:
        return []
    detail = (
        f"{channel_list(channels)} {is_or_are(channels)} clipped, up to "
        f"{levels.clipped.max():.2%} of the samples are at full scale: lower the recording gain"
    )
    return [Finding("clipping", detail, channels)]


def _offset(levels: ChannelLevels, names: Sequence[int]) -> list[Finding]:
    channels = _flagged(np.abs(levels.offset) > OFFSET_LIMIT, names)
    if not channels:
        return []
    detail = (
        f"{channel_list(channels)} {is_or_are(channels)} off centre by up to "
        f"{np.abs(levels.offset).max():.1%} of full scale (DC offset): directions are hardly "
        f"affected, but the converter or its coupling is faulty"
    )
    return [Finding("dc_offset", detail, channels)]

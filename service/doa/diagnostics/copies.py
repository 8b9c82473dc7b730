"""Channels that hold the same signal twice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.doa.diagnostics.finding import Finding, channel_list
from service.doa.types import FloatArray

COPY_RESIDUAL = 3e-4
"""Largest 1 - correlation^2 of a copy, -35 dB: a gain on quiet 16-bit audio leaves a third"""
ROUNDING = 2 / 32768
"""Largest RMS difference between a channel and its copy, from rounding to 16 bits; noises of two
microphones differ by more, even where a sound reaches both at the same time"""


def copied_groups(segments: Sequence[FloatArray], ignored: Sequence[int]) -> list[tuple[int, ...]]:
    """Groups of channel indices whose signals agree up to a gain.

    Parameters
    ----------
    segments : list of (N, T) float32
    ignored : sequence of int
        Channels to leave out, the dead ones.

    Returns
    -------
    groups : list of tuple of int
        Groups of two or more channels, ascending.
    """
    # Differences of samples emphasise high frequencies. Mains hum and rumble, whose wavelengths
    # are long against the array, are equal in all channels of a good recording.
    steps = np.concatenate([np.diff(segment, axis=-1) for segment in segments], axis=-1)
    gram = steps.astype(np.float64) @ steps.T.astype(np.float64)
    power = np.maximum(np.diag(gram), 1e-30)
    residual = 1.0 - gram**2 / (power[:, None] * power[None, :])
    rest = residual * np.minimum(power[:, None], power[None, :]) / steps.shape[-1]
    copies = (residual < COPY_RESIDUAL) & (rest < ROUNDING**2)
    groups: list[tuple[int, ...]] = []
    free = [index for index in range(power.size) if index not in ignored]
    while free:
        first, *others = free
        group = [first, *(other for other in others if copies[first, other])]
        if len(group) > 1:
            groups.append(tuple(group))
        free = [index for index in others if index not in group]
    return groups


def copy_findings(groups: Sequence[tuple[int, ...]], names: Sequence[int]) -> list[Finding]:
    """One finding per group."""
    findings = []
    for group in groups:
        channels = tuple(names[index] for index in group)
        detail = (
            f"{channel_list(channels)} hold the same signal: record the raw microphones, "
            f"not a mono or processed stream copied to several channels"
        )
        findings.append(Finding("channels_identical", detail, channels))
    return findings

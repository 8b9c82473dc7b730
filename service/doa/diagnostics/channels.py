"""The diagnostics of one recording, fed block by block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuralmusic.errors import ChannelMismatch
from service.doa.array import MicrophoneArray
from service.doa.diagnostics.bandwidth import bandwidth_findings
from service.doa.diagnostics.copies import copied_groups, copy_findings
from service.doa.diagnostics.excerpt import Excerpt
from service.doa.diagnostics.finding import Finding
from service.doa.diagnostics.levels import (
    ChannelLevels,
    LevelMeter,
    dead_channels,
    level_findings,
)
from service.doa.diagnostics.sound import sound_findings
from service.doa.types import FloatArray

QUIET = 1e-6
"""Power of the loudest half second below which audio is quiet: -60 dBFS, 30 dB above the rounding
of 16-bit audio"""


@dataclass(frozen=True, slots=True)
class DiagnosticReport:
    """Levels, findings, and why the order and the delays of the channels were not checked."""

    levels: ChannelLevels
    findings: tuple[Finding, ...]
    unchecked: str | None
    """Reason why the sound was not compared with the array; None where it was"""


class ChannelDiagnostics:
    """Finds the faults of N channels of audio; memory does not grow with the recording.

    Parameters
    ----------
    sample_rate : int
        Hertz.
    num_channels : int
    channel_map : sequence of int, optional
        Recording channel of each of the N channels, named in findings; 0 to N - 1 by default.
    """

    def __init__(
        self, sample_rate: int, num_channels: int, channel_map: Sequence[int] | None = None
    ) -> None:
        self._sample_rate = sample_rate
        self._names = tuple(range(num_channels) if channel_map is None else channel_map)
        self._meter = LevelMeter(num_channels)
        self._excerpt = Excerpt(sample_rate, num_channels)

    def add(self, block: FloatArray) -> None:
        """Add the next block of audio (N, T) float32 of any length."""
        self._excerpt.add(self._meter.add(block))

    def levels(self) -> ChannelLevels:
        """Levels of the audio so far."""
        return self._meter.levels()

    def findings(self, array: MicrophoneArray | None = None) -> list[Finding]:
        """All findings so far; without an array, its geometry is not checked.

        Raises
        ------
        ChannelMismatch
            If the array has another number of microphones.
        """
        return list(self.report(array).findings)

    def report(self, array: MicrophoneArray | None = None) -> DiagnosticReport:
        """Levels and findings, and why the geometry was not checked, if it was not."""
        count = len(self._names)
        if array is not None and array.num_microphones != count:
            raise ChannelMismatch(
                f"{count} channels cannot be compared with the {array.num_microphones} "
                f"microphones of {array.name}: choose the channels with channel_map"
            )
        levels = self.levels()
        findings = level_findings(levels, self._names)
        segments = self._excerpt.segments()
        if self._excerpt.loudest() < QUIET:
            findings.append(quiet_finding(self._excerpt.loudest(), levels))
            return DiagnosticReport(levels, tuple(findings), "the recording is too quiet")
        dead = dead_channels(levels)
        copied = copied_groups(segments, dead)
        findings += copy_findings(copied, self._names)
        if dead or copied:
            findings += bandwidth_findings(segments, self._sample_rate)
            return DiagnosticReport(levels, tuple(findings), "first repair dead or copied channels")
        more, unchecked = sound_findings(segments, self._sample_rate, self._names, array)
        return DiagnosticReport(levels, (*findings, *more), unchecked)


def quiet_finding(power: float, levels: ChannelLevels) -> Finding:
    """The finding ``quiet`` for audio whose loudest half second has the power ``power``."""
    if power == 0.0 and not np.isfinite(levels.rms).any():
        return Finding("quiet", "the recording is silent: check that the right device recorded")
    level = f"{10 * np.log10(power):.0f} dBFS" if power > 0 else "nothing"
    return Finding(
        "quiet",
        f"the loudest half second has {level}: raise the recording gain or come closer, "
        f"rounding noise hides directions",
    )

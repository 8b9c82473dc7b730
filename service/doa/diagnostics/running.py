"""The diagnostics of a stream: cheap for every block, checked now and then, each fault told once.

Levels cover the last seconds, so a channel that dies after an hour is seen at once. Sound is
compared with the array at the beginning, when a wrong set-up shows, and rarely later.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence

import numpy as np

from neuralmusic.errors import ChannelMismatch
from service.doa.array import MicrophoneArray
from service.doa.diagnostics.channels import QUIET, quiet_finding
from service.doa.diagnostics.copies import copied_groups, copy_findings
from service.doa.diagnostics.excerpt import SEGMENT_S, Excerpt
from service.doa.diagnostics.finding import Finding, FindingCode
from service.doa.diagnostics.levels import DEAD_BELOW, LevelMeter, dead_channels, level_findings
from service.doa.diagnostics.sound import sound_findings
from service.doa.types import FloatArray

FIRST_LEVELS_S = 2.0
LEVELS_EVERY_S = 5.0
QUIET_AFTER_S = 10.0
SOUND_CHECKS_S = (10.0, 20.0, 40.0, 80.0)
"""Seconds with sound, at the stream's beginning, after which the sound is checked"""
SOUND_EVERY_S = 300.0
"""Seconds with sound between later checks, each on an excerpt of its own"""
REPEAT_S = 60.0
RECENT_SEGMENTS = 4
MAX_BLOCKS = 60
"""Most blocks of direct sound in one comparison of four microphones with the array"""
MIN_BLOCKS = 40
"""Most blocks with many microphones, where each takes longer"""
RECOVERS: frozenset[FindingCode] = frozenset({"channel_dead", "channels_identical"})
"""Faults that are reported again as soon as they return"""


class RunningDiagnostics:
    """Finds the faults of the N channels of a stream; memory does not grow.

    One thread may call ``add`` and ``due`` while another is in ``check``.

    Parameters
    ----------
    sample_rate : int
        Hertz.
    channel_map : sequence of int
        The stream's channel of each of the N channels, named in findings.
    array : MicrophoneArray, optional
        Without it, geometry is not checked.

    Raises
    ------
    ChannelMismatch
        If the array has another number of microphones.
    """

    def __init__(
        self, sample_rate: int, channel_map: Sequence[int], array: MicrophoneArray | None = None
    ) -> None:
        if array is not None and array.num_microphones != len(channel_map):
            raise ChannelMismatch(
                f"{len(channel_map)} channels cannot be compared with the "
                f"{array.num_microphones} microphones of {array.name}"
            )
        self._sample_rate = sample_rate
        self._names = tuple(channel_map)
        self._array = array
        self._max_blocks = max(MIN_BLOCKS, 4 * MAX_BLOCKS // max(4, len(self._names)))
        self._lock = threading.Lock()
        self._meter = LevelMeter(len(self._names))
        self._excerpt = Excerpt(sample_rate, len(self._names))
        self._gathered: list[FloatArray] = []
        """Blocks that the meter and the excerpt have not seen: they take whole segments, to save
        calls"""
        self._gathered_samples = 0
        self._samples = 0  # of audio; whole numbers, since sums of seconds drift
        self._sounding_samples = 0  # of audio with sound
        self._next_levels = FIRST_LEVELS_S
        self._next_sound = SOUND_CHECKS_S[0]
        self._reported: dict[tuple[FindingCode, int | None], float] = {}

    def add(self, block: FloatArray) -> None:
        """Add the next block (N, T) float32 of any length; samples may be NaN or infinite.

        The block is kept for a while and must not be changed.
        """
        if block.shape[-1] == 0:
            return
        with self._lock:
            self._gathered.append(block)
            self._gathered_samples += block.shape[-1]
            self._samples += block.shape[-1]
            if self._gathered_samples >= SEGMENT_S * self._sample_rate:
                self._take_in()

    def due(self) -> bool:
        """Whether enough audio has come since the last check for another one."""
        return self._heard >= self._next_levels or self._sounding >= self._next_sound

    def check(self) -> list[Finding]:
        """Faults that were not reported in the last ``REPEAT_S`` seconds of audio.

        Most checks read only levels; those that compare the sound with the array take a tenth of a
        second.
        """
        with self._lock:
            self._take_in()
            now = self._heard
            levels = self._meter.levels()
            segments = self._excerpt.segments()
            loudest = self._excerpt.loudest()
            levels_due, sound_due = now >= self._next_levels, self._sounding >= self._next_sound
            if levels_due:
                self._meter = LevelMeter(len(self._names))
                self._next_levels = now + LEVELS_EVERY_S
            if sound_due:
                self._schedule_sound()
        findings: list[Finding] = []
        dead = dead_channels(levels)
        copied = [] if loudest < QUIET else copied_groups(segments[-RECENT_SEGMENTS:], dead)
        if levels_due:
            findings += level_findings(levels, self._names)
            findings += copy_findings(copied, self._names)
            if loudest < QUIET and now >= QUIET_AFTER_S:
                findings.append(quiet_finding(loudest, levels))
            self._forget(findings)
        if sound_due and not (dead or copied):
            # A channel that was dead for a while is in some segments and not in others.
            alive = [segment for segment in segments if _alive(segment)]
            found, _ = sound_findings(
                alive, self._sample_rate, self._names, self._array, self._max_blocks
            )
            findings += found
        return [finding for finding in findings if self._is_new(finding, now)]

    def _take_in(self) -> None:
        """Pass the gathered blocks to the meter and the excerpt."""
        if not self._gathered:
            return
        clean = self._meter.add(np.concatenate(self._gathered, axis=-1))
        self._excerpt.add(clean)
        if float(np.median(np.var(clean, axis=-1))) > QUIET:
            self._sounding_samples += self._gathered_samples
        self._gathered.clear()
        self._gathered_samples = 0

    @property
    def _heard(self) -> float:
        """Seconds of audio."""
        return self._samples / self._sample_rate

    @property
    def _sounding(self) -> float:
        """Seconds of audio with sound."""
        return self._sounding_samples / self._sample_rate

    def _schedule_sound(self) -> None:
        """Schedule the next check of the sound; later checks get only newer audio."""
        later = [seconds for seconds in SOUND_CHECKS_S if seconds > self._sounding]
        if later:
            self._next_sound = later[0]
            return
        self._next_sound = self._sounding + SOUND_EVERY_S
        self._excerpt = Excerpt(self._sample_rate, len(self._names))

    def _forget(self, findings: Sequence[Finding]) -> None:
        """Forget faults that are gone, so that they are reported as soon as they return."""
        present = {key for finding in findings for key in _keys(finding)}
        for key in list(self._reported):
            if key[0] in RECOVERS and key not in present:
                del self._reported[key]

    def _is_new(self, finding: Finding, now: float) -> bool:
        """Whether one of the finding's channels was not reported lately; marks it as reported."""
        keys = _keys(finding)
        new = any(now - self._reported.get(key, -REPEAT_S) >= REPEAT_S for key in keys)
        if new:
            self._reported.update(dict.fromkeys(keys, now))
        return new


def _alive(segment: FloatArray) -> bool:
    """Whether all channels of a segment (N, T) hold sound."""
    power = np.var(segment, axis=-1)
    return bool(power.min() > 10 ** (-DEAD_BELOW / 10) * np.median(power))


def _keys(finding: Finding) -> list[tuple[FindingCode, int | None]]:
    """Keys per channel: a fault that spreads to another channel is new, one that shrinks is not."""
    if not finding.channels:
        return [(finding.code, None)]
    return [(finding.code, channel) for channel in finding.channels]

"""Faults of a multichannel recording, found from its samples alone.

Task: name the faults that make directions wrong without any error: dead, copied, clipped, late
or swapped channels, the wrong scale, too little level or bandwidth.

Conventions
-----------
Channels are reported by their number in the recording, from 0, through the channel map. Levels are
decibels relative to full scale (dBFS): 20 log10 of an amplitude, so a full-scale sine has an RMS of
-3 dBFS. A finding needs evidence far outside of what good recordings show: silence is better than a
false alarm.

An order of channels that turns or mirrors the array as a whole cannot be found. A square whose
channels are rotated by one is the same square turned by 90 degrees and fits any sound as well as
the right order; only a sound from a known direction tells them apart. For the same reason a late
channel of a flat array may look the same as another one that is early.

Contents
--------
``ChannelDiagnostics`` takes a recording block by block in bounded memory and gives findings.
``RunningDiagnostics`` does so for an endless stream and reports new findings.
``levels`` counts samples, ``excerpt`` keeps the loud seconds, ``copies``, ``sound``, ``bandwidth``,
``processed``, ``lag``, ``cells``, ``fit``, ``geometry`` and ``diffuse`` look at that excerpt.
"""

from service.doa.diagnostics.channels import ChannelDiagnostics, DiagnosticReport
from service.doa.diagnostics.finding import Finding, FindingCode
from service.doa.diagnostics.levels import ChannelLevels, LevelMeter
from service.doa.diagnostics.running import RunningDiagnostics

__all__ = [
    "ChannelDiagnostics",
    "ChannelLevels",
    "DiagnosticReport",
    "Finding",
    "FindingCode",
    "LevelMeter",
    "RunningDiagnostics",
]

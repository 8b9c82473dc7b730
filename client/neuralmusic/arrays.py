"""Microphone arrays that clients may name instead of sending positions.

Conventions
-----------
Row n is raw microphone n in the order in which the device delivers its raw channels, from 0.
Positions are metres in the array frame (x forward, y left, z up) about the array's centre. Most
makers define no front, so each preset keeps its source's axes as they are where these are
right-handed, and a comment says what lies at +x. A preset therefore agrees with results of the
source's own tools; ``yaw_deg`` turns a mounted array to the robot's front.

To add one, append an ``ArrayPreset`` to ``PRESETS`` whose ``source`` names the document, and
check it in the tests against a fact from a second document. A drawing seen from below or with y
downwards is mirrored: its microphones run clockwise where the numbers look counter-clockwise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import combinations
from types import MappingProxyType

from neuralmusic.errors import UnknownArray

Position = tuple[float, float, float]


@dataclass(frozen=True)
class ArrayPreset:
    """A microphone array with a name."""

    name: str
    positions_m: tuple[Position, ...]
    """Metres, ``(x, y, z)`` per microphone"""
    source: str
    """Document that the positions are from"""

    @property
    def aperture_m(self) -> float:
        """Largest distance between two microphones in metres."""
        return max(math.dist(first, second) for first, second in combinations(self.positions_m, 2))


def preset(name: str) -> ArrayPreset:
    """The preset of this name, or UnknownArray with the known names."""
    try:
        return PRESETS[name]
    except KeyError:
        raise UnknownArray(_unknown(name)) from None


def _unknown(name: str) -> str:
    shown = name[:40]  # the name comes from a client and may be of any length
    close = get_close_matches(shown.lower().replace("_", "-"), PRESETS, n=1, cutoff=0.5)
    suggestion = f"did you mean {close[0]!r}? " if close else ""
    return f"no array preset is called {shown!r}: {suggestion}the presets are {', '.join(PRESETS)}"


def _ring(
    radius: float, first_azimuth_deg: float, count: int, *, clockwise: bool = False
) -> tuple[Position, ...]:
    """Positions evenly on a level circle, from above counter-clockwise or clockwise."""
    step = (-360.0 if clockwise else 360.0) / count
    azimuths = [math.radians(first_azimuth_deg + step * index) for index in range(count)]
    return tuple(_level(radius * math.cos(angle), radius * math.sin(angle)) for angle in azimuths)


def _after_centre(ring: tuple[Position, ...]) -> tuple[Position, ...]:
    """Positions of a ring whose centre microphone is channel 0."""
    return (_level(0.0, 0.0), *ring)


def _level_mm(points: Sequence[tuple[float, float]]) -> tuple[Position, ...]:
    """Positions in metres of points (x, y) in millimetres at height 0."""
    return tuple(_level(x / 1000, y / 1000) for x, y in points)


def _level(x: float, y: float) -> Position:
    """A position as clients should read it: 0.02285, not 0.022850000000000002, and no -0.0."""
    return round(x, 6) + 0.0, round(y, 6) + 0.0, 0.0


_ARRAYS = (
    ArrayPreset(
        "respeaker-usb-4mic-v2",
        # +x lies midway between raw microphones 1 and 4, +y midway between 1 and 2.
        _level_mm([(22.85, 22.85), (-22.85, 22.85), (-22.85, -22.85), (22.85, -22.85)]),
        "ReSpeaker Mic Array v2.0 (USB 4 Mic Array): 45.7 mm square as in the NeuralMUSIC paper's "
        "code; order and size agree with Seeed's respeaker/usb_4_mic_array odas.cfg (radius 32 mm)",
    ),
    ArrayPreset(
        "respeaker-4mic-hat",
        # +x is microphone 3. Seeed's example code measures the diagonal as 81 to 81.3 mm.
        _ring(0.0405, 180, 4, clockwise=True),
        "ReSpeaker 4-Mics Pi HAT: Seeed's respeaker/mic_array odas.cfg",
    ),
    ArrayPreset(
        "respeaker-6mic-circular",
        # +x is microphone 5. voice-engine uses 92.18 mm across, 0.4 mm less than here.
        _ring(0.0463, 120, 6),
        "ReSpeaker 6-Mic Circular Array kit for Raspberry Pi: ODAS configuration "
        "respeaker_6_mic_array.cfg by introlab (R = 46.3 mm)",
    ),
    ArrayPreset(
        "respeaker-core-v2",
        # Six microphones, unlike the 7-microphone board that stacks on the first ReSpeaker Core
        # ("respeaker-mic-array-v1"). +x is microphone 5.
        _ring(0.0463, 120, 6),
        "ReSpeaker Core v2.0: same geometry as the 6-Mic Circular Array according to voice-engine "
        "(by a ReSpeaker developer); positions from ODAS respeaker_6_mic_array.cfg by introlab",
    ),
    ArrayPreset(
        "respeaker-mic-array-v1",
        # Raw firmware only. +x is the fifth microphone of the ring.
        _after_centre(_ring(0.032, 120, 6)),
        "ReSpeaker Mic Array v1 (USB 6+1): ODAS configuration respeaker.cfg by introlab; Seeed's "
        "respeaker/mic_array gives 64 mm across",
    ),
    ArrayPreset(
        "xmos-xcore-7mic",
        # +x is the fifth microphone of the ring.
        _after_centre(_ring(0.043, 240, 6, clockwise=True)),
        "XMOS xCORE Microphone Array XK-USB-MIC-UF216: ODAS configuration xmos.cfg by introlab; "
        "no positions by XMOS were found",
    ),
    ArrayPreset(
        "xvf3800-4mic",
        # +x lies midway between raw microphones 0 and 1. The reSpeaker Flex has a smaller square.
        _level_mm([(33, -33), (33, 33), (-33, 33), (-33, -33)]),
        "reSpeaker XVF3800 USB 4-Mic Array: AEC_MIC_ARRAY_GEO as printed in Seeed's wiki, page "
        "respeaker_xvf3800_introduction; that z points up is assumed",
    ),
    ArrayPreset(
        "minidsp-uma8",
        # +x lies midway between MIC2 and MIC3 of the ring, +y is MIC1.
        _after_centre(_ring(0.043, 90, 6, clockwise=True)),
        "miniDSP UMA-8 with raw firmware: ODAS configuration minidsp.cfg by introlab, rounded "
        "there to 1 mm; no positions by miniDSP were found",
    ),
    ArrayPreset(
        "matrix-creator",
        # +x lies midway between M7 and M8.
        _ring(0.0525, -67.5, 8, clockwise=True),
        "MATRIX Creator: MATRIX Labs' matrix-creator-hal microphone_array_location.h, the ring "
        "that its table is rounded from; that z points up is assumed, as ODAS does",
    ),
    ArrayPreset(
        "matrix-voice",
        # No microphone lies at +x; the nearest are M5 at 20 and M6 at -31 degrees.
        _level_mm(
            [
                (0.00, 0.00),
                (-38.13, 3.58),
                (-20.98, 32.04),
                (11.97, 36.38),
                (35.91, 13.32),
                (32.81, -19.77),
                (5.00, -37.97),
                (-26.57, -27.58),
            ]
        ),
        "MATRIX Voice: MATRIX Labs' matrix-creator-hal microphone_array_location.h and "
        "documentation; that z points up is assumed, as ODAS does",
    ),
    ArrayPreset(
        "av163-circle8",
        # +x is the fifth microphone, in the data set's own axes.
        _ring(0.1, 180, 8),
        "AV16.3 corpus (Lathoud et al., MLMI 2004), either array about its own centre: radius "
        "10 cm; order as in the NeuralMUSIC paper's code",
    ),
)

PRESETS: Mapping[str, ArrayPreset] = MappingProxyType({array.name: array for array in _ARRAYS})
"""Presets by name"""

RAW_CHANNELS: Mapping[str, Mapping[int, tuple[int, ...]]] = MappingProxyType(
    {
        # Seeed's usb_4_mic_array README: 0 processed, 1 to 4 raw, 5 playback.
        "respeaker-usb-4mic-v2": MappingProxyType({6: (1, 2, 3, 4)}),
        # Seeed's wiki: the first six channels are microphones, the last two playback.
        "respeaker-6mic-circular": MappingProxyType({8: (0, 1, 2, 3, 4, 5)}),
        # Seeed's wiki: six microphones and two loopbacks; voice-engine reads them in this order.
        "respeaker-core-v2": MappingProxyType({8: (0, 1, 2, 3, 4, 5)}),
        # ODAS maps the first seven of eight; in Seeed's mic_array the ring is 1 to 6 of eight.
        "respeaker-mic-array-v1": MappingProxyType({8: (0, 1, 2, 3, 4, 5, 6)}),
        "xmos-xcore-7mic": MappingProxyType({8: (0, 1, 2, 3, 4, 5, 6)}),
        # Seeed's firmware README counts from 1: processed on 1 and 2, raw on 3 to 6 by default.
        "xvf3800-4mic": MappingProxyType({6: (2, 3, 4, 5)}),
        # ODAS maps the first seven of eight; the eighth is a spare input without a microphone.
        "minidsp-uma8": MappingProxyType({8: (0, 1, 2, 3, 4, 5, 6)}),
    }
)
"""Recording channels, from 0, of a preset's raw microphones, by the recording's channel count.

Only for devices whose firmware delivers more channels than the array has microphones.
"""

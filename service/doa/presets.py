"""Microphone arrays that clients may name instead of sending positions.

Conventions
-----------
Row n is raw microphone n in the order in which the device delivers its raw channels, from 0.
Positions are metres in the array frame (x forward, y left, z up) about the array's centre. Most
makers define no front, so each preset keeps its source's axes as they are where these are
right-handed, and a comment says what lies at +x. A preset therefore agrees with results of the
source's own tools; a mounted array is turned to the robot's front with ``MicrophoneArray.rotated``.

To add one, append a ``MicrophoneArray`` to ``PRESETS`` whose ``source`` names the document, and
check it in the tests against a fact from a second document. A drawing seen from below or with y
downwards is mirrored: its microphones run clockwise where the numbers look counter-clockwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from types import MappingProxyType

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray
from service.errors import UnknownArray


def preset(name: str) -> MicrophoneArray:
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
) -> FloatArray:
    """Positions (count, 3) evenly on a level circle, from above counter-clockwise or clockwise."""
    step = (-360.0 if clockwise else 360.0) / count
    azimuth = np.deg2rad(first_azimuth_deg + step * np.arange(count))
    unit = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(count)], axis=-1)
    return _whole_micrometres(radius * unit)


def _after_centre(ring: FloatArray) -> FloatArray:
    """Positions (N + 1, 3) of a ring (N, 3) whose centre microphone is channel 0."""
    return np.concatenate([np.zeros((1, 3)), ring])


def _level_mm(points: Sequence[tuple[float, float]]) -> FloatArray:
    """Positions (N, 3) in metres of points (x, y) in millimetres at height 0."""
    return _whole_micrometres(np.array([(x, y, 0.0) for x, y in points]) / 1000)


def _whole_micrometres(positions: FloatArray) -> FloatArray:
    """Positions as clients should read them: 0.02285, not 0.022850000000000002, and no -0.0."""
    rounded: FloatArray = np.round(positions, 6) + 0.0
    return rounded


_ARRAYS = (
    MicrophoneArray(
        "respeaker-usb-4mic-v2",
        # +x lies midway between raw microphones 1 and 4, +y midway between 1 and 2.
        _level_mm([(22.85, 22.85), (-22.85, 22.85), (-22.85, -22.85), (22.85, -22.85)]),
        "ReSpeaker Mic Array v2.0 (USB 4 Mic Array): 45.7 mm square as in the NeuralMUSIC paper's "
        "code; order and size agree with Seeed's respeaker/usb_4_mic_array odas.cfg (radius 32 mm)",
    ),
    MicrophoneArray(
        "respeaker-4mic-hat",
        # +x is microphone 3. Seeed's example code measures the diagonal as 81 to 81.3 mm.
        _ring(0.0405, 180, 4, clockwise=True),
        "ReSpeaker 4-Mics Pi HAT: Seeed's respeaker/mic_array odas.cfg",
    ),
    MicrophoneArray(
        "respeaker-6mic-circular",
        # +x is microphone 5. voice-engine uses 92.18 mm across, 0.4 mm less than here.
        _ring(0.0463, 120, 6),
        "ReSpeaker 6-Mic Circular Array kit for Raspberry Pi: ODAS configuration "
        "respeaker_6_mic_array.cfg by introlab (R = 46.3 mm)",
    ),
    MicrophoneArray(
        "respeaker-core-v2",
        # Six microphones, unlike the 7-microphone board that stacks on the first ReSpeaker Core
        # ("respeaker-mic-array-v1"). +x is microphone 5.
        _ring(0.0463, 120, 6),
        "ReSpeaker Core v2.0: same geometry as the 6-Mic Circular Array according to voice-engine "
        "(by a ReSpeaker developer); positions from ODAS respeaker_6_mic_array.cfg by introlab",
    ),
    MicrophoneArray(
        "respeaker-mic-array-v1",
        # Raw firmware only. +x is the fifth microphone of the ring.
        _after_centre(_ring(0.032, 120, 6)),
        "ReSpeaker Mic Array v1 (USB 6+1): ODAS configuration respeaker.cfg by introlab; Seeed's "
        "respeaker/mic_array gives 64 mm across",
    ),
    MicrophoneArray(
        "xmos-xcore-7mic",
        # +x is the fifth microphone of the ring.
        _after_centre(_ring(0.043, 240, 6, clockwise=True)),
        "XMOS xCORE Microphone Array XK-USB-MIC-UF216: ODAS configuration xmos.cfg by introlab; "
        "no positions by XMOS were found",
    ),
    MicrophoneArray(
        "xvf3800-4mic",
        # +x lies midway between raw microphones 0 and 1. The reSpeaker Flex has a smaller square.
        _level_mm([(33, -33), (33, 33), (-33, 33), (-33, -33)]),
        "reSpeaker XVF3800 USB 4-Mic Array: AEC_MIC_ARRAY_GEO as printed in Seeed's wiki, page "
        "respeaker_xvf3800_introduction; that z points up is assumed",
    ),
    MicrophoneArray(
        "minidsp-uma8",
        # +x lies midway between MIC2 and MIC3 of the ring, +y is MIC1.
        _after_centre(_ring(0.043, 90, 6, clockwise=True)),
        "miniDSP UMA-8 with raw firmware: ODAS configuration minidsp.cfg by introlab, rounded "
        "there to 1 mm; no positions by miniDSP were found",
    ),
    MicrophoneArray(
        "matrix-creator",
        # +x lies midway between M7 and M8.
        _ring(0.0525, -67.5, 8, clockwise=True),
        "MATRIX Creator: MATRIX Labs' matrix-creator-hal microphone_array_location.h, the ring "
        "that its table is rounded from; that z points up is assumed, as ODAS does",
    ),
    MicrophoneArray(
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
    MicrophoneArray(
        "av163-circle8",
        # +x is the fifth microphone, in the data set's own axes.
        _ring(0.1, 180, 8),
        "AV16.3 corpus (Lathoud et al., MLMI 2004), either array about its own centre: radius "
        "10 cm; order as in the NeuralMUSIC paper's code",
    ),
)

PRESETS: Mapping[str, MicrophoneArray] = MappingProxyType({array.name: array for array in _ARRAYS})
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


def raw_channels(array: MicrophoneArray, channels: int) -> tuple[int, ...] | None:
    """The raw microphones among the channels of a preset's firmware; None where unknown.

    An array with a preset's name and number of microphones is that device, calibrated or turned.
    """
    device = PRESETS.get(array.name)
    if device is None or device.num_microphones != array.num_microphones:
        return None
    return RAW_CHANNELS.get(array.name, {}).get(channels)

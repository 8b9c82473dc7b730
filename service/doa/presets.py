"""The array presets of ``neuralmusic.arrays``, for the numerics."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from neuralmusic import arrays
from service.doa.array import MicrophoneArray

PRESETS: Mapping[str, MicrophoneArray] = MappingProxyType(
    {
        name: MicrophoneArray(name, np.array(found.positions_m), found.source)
        for name, found in arrays.PRESETS.items()
    }
)
"""Every preset by its name."""


def preset(name: str) -> MicrophoneArray:
    """The preset of this name, or UnknownArray with the known names."""
    return PRESETS[arrays.preset(name).name]


def raw_channels(array: MicrophoneArray, channels: int) -> tuple[int, ...] | None:
    """The raw microphones among the channels of a preset's firmware; None where unknown.

    An array with a preset's name and number of microphones is that device, calibrated or turned.
    """
    device = PRESETS.get(array.name)
    if device is None or device.num_microphones != array.num_microphones:
        return None
    return arrays.RAW_CHANNELS.get(array.name, {}).get(channels)

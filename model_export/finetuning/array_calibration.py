"""Array calibration: true positions of the microphones, learned from sounds of known directions.

The `weights` network sees no geometry, so training it cannot correct microphones that are not where
the array's description has them, or an array that is mounted slightly turned. The fused spectrum is
differentiable in the steering delays, hence in the positions.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from service.doa.array import SPEED_OF_SOUND, MicrophoneArray
from service.doa.types import FloatArray


class ArrayCalibration(nn.Module):
    """Offsets (N, 3) in metres from an array's nominal positions.

    Steering vectors are those of horizontal directions, so heights never change. Microphones on a
    line, as seen from above, stay on it: off it, they would seem to tell its two sides apart.
    """

    nominal: Tensor
    allowed: Tensor
    """(3, 3) projector onto the directions in which microphones may move"""

    def __init__(self, array: MicrophoneArray) -> None:
        super().__init__()
        self._array = array
        self.register_buffer("nominal", torch.from_numpy(array.positions.copy()).float())
        self.register_buffer("allowed", torch.from_numpy(_movable(array)).float())
        self.offsets = nn.Parameter(torch.zeros_like(self.nominal))

    def delays(self, azimuth: Tensor) -> Tensor:
        """Differentiable ``training.task.steering_delays`` (N, A) in seconds at azimuths (A,)."""
        positions = self.nominal + self.offsets @ self.allowed
        centred = positions - positions.mean(0)
        directions = torch.stack([azimuth.cos(), azimuth.sin(), torch.zeros_like(azimuth)])
        return centred @ directions / SPEED_OF_SOUND

    def array(self) -> MicrophoneArray:
        """The calibrated array, with its nominal centre, rounded to micrometres."""
        offsets = self.offsets.detach().double() @ self.allowed.double()
        moved = self._array.positions + (offsets - offsets.mean(0)).numpy()
        name = f"{self._array.name.removesuffix('-calibrated')}-calibrated"
        return MicrophoneArray(name, moved.round(6), "calibrated by fine-tuning")


def _movable(array: MicrophoneArray) -> FloatArray:
    """(3, 3) projector onto the horizontal plane, or onto the line of a linear array."""
    if not array.linear:
        return np.diag([1.0, 1.0, 0.0])
    axis = np.append(array.axis, 0.0)
    return np.outer(axis, axis)

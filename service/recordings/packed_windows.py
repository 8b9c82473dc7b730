"""The windows of a whole recording, packed: an hour has seven thousand of them."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from typing import overload

import numpy as np

from service.doa.orientation import ALIGNED, Orientation
from service.doa.types import FloatArray
from service.inference.results import Source, WindowEstimate
from service.recordings.results import WindowResult

_HEAD = struct.Struct("<dd")
_SOURCE = struct.Struct("<ddqf")
NOBODY = -1
"""Stands for a source without an id"""
NO_SPECTRUM: FloatArray = np.empty(0, dtype=np.float32)


class PackedWindows(Sequence[WindowResult]):
    """Windows in time order; one with two sources takes 113 bytes.

    Parameters
    ----------
    orientation : Orientation
        Turns the spectra when they are read; sources are given in the robot's frame.
    spectrum : bool
        Whether to keep the spectra: 700 to 1,500 bytes a window.
    sphere : bool
        Whether to keep the images of the sphere: 10 kB a window.
    """

    def __init__(
        self, orientation: Orientation = ALIGNED, *, spectrum: bool = True, sphere: bool = False
    ) -> None:
        self._orientation = orientation
        self._windows: list[bytes] = []
        self._spectra: list[FloatArray] | None = [] if spectrum else None
        self._spheres: list[FloatArray | None] | None = [] if sphere else None

    def append(self, window: WindowResult) -> None:
        """Add the next window: sources in the robot's frame, spectrum in the array's."""
        head = _HEAD.pack(window.t_start, window.t_end)
        sources = (
            _SOURCE.pack(
                each.azimuth,
                each.confidence,
                NOBODY if each.id is None else each.id,
                math.nan if each.elevation is None else each.elevation,
            )
            for each in window.estimate.sources
        )
        self._windows.append(head + b"".join(sources))
        if self._spectra is not None:
            self._spectra.append(window.estimate.spectrum.copy())
        if self._spheres is not None:
            self._spheres.append(window.estimate.sphere)

    def __len__(self) -> int:
        return len(self._windows)

    @overload
    def __getitem__(self, index: int) -> WindowResult: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[WindowResult]: ...

    def __getitem__(self, index: int | slice) -> WindowResult | Sequence[WindowResult]:
        if isinstance(index, slice):
            return [self[place] for place in range(*index.indices(len(self)))]
        packed = self._windows[index]
        sources = tuple(
            Source(
                azimuth,
                confidence,
                None if track == NOBODY else track,
                None if math.isnan(elevation) else elevation,
            )
            for azimuth, confidence, track, elevation in _SOURCE.iter_unpack(packed[_HEAD.size :])
        )
        t_start, t_end = _HEAD.unpack_from(packed)
        estimate = WindowEstimate(sources, self._spectrum(index), self._sphere(index))
        return WindowResult(t_start, t_end, estimate)

    def __iter__(self) -> Iterator[WindowResult]:
        return (self[index] for index in range(len(self)))

    def _spectrum(self, index: int) -> FloatArray:
        if self._spectra is None:
            return NO_SPECTRUM
        return self._orientation.spectrum_on_robot(self._spectra[index])

    def _sphere(self, index: int) -> FloatArray | None:
        image = None if self._spheres is None else self._spheres[index]
        return None if image is None else self._orientation.sphere_on_robot(image)

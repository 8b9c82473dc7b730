"""pyroomacoustics' direction finders on our arrays, framing and grid."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pyroomacoustics as pra
import scipy.linalg

from model_export.baselines.told import STFT
from service.doa.array import SPEED_OF_SOUND, MicrophoneArray
from service.doa.steering import azimuth_grid


def direction_finder(name: str, array: MicrophoneArray, **options: Any) -> Any:
    """The library's finder of this name for sources in the array's plane.

    ``name`` is one of ``pyroomacoustics.doa.algorithms``; the grid is ``azimuth_grid()``.
    ``locate_sources`` takes spectra (N, F, L) of ``STFT``.
    """
    return build(pra.doa.algorithms[name], array, **options)


def build(finder: Any, array: MicrophoneArray, **options: Any) -> Any:
    """Build a finder from one of the library's classes, or from a subclass of ours."""
    # Centred, since focusing relies on phases relative to the array's centre.
    centred = array.positions - array.positions.mean(axis=0)
    return finder(
        centred.T,
        STFT.sample_rate,
        STFT.n_fft,
        c=SPEED_OF_SOUND,
        n_grid=len(azimuth_grid()),
        dim=2,
        **options,
    )


@contextmanager
def quiet() -> Iterator[None]:
    """Suppress warnings of divisions by zero and of badly conditioned systems.

    The library runs into both where a direction fits perfectly, and continues with infinity.
    """
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", scipy.linalg.LinAlgWarning)
        warnings.simplefilter("ignore", RuntimeWarning)
        yield

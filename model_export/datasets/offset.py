"""The unpublished angle between a data set's zero and its array's.

SLoClas and AFPILD annotate directions in a frame of the room and do not say how the array stood in
it. One constant is learned from training items; learning it on the test set would bias the score.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from model_export.datasets.item import DatasetItem
from service.doa.array import MicrophoneArray
from service.doa.scoring import circular_error
from service.doa.types import FloatArray

Localize = Callable[[FloatArray, MicrophoneArray], float]
"""Estimates one azimuth in radians from audio (N, T) at 16 kHz"""


def learn_offset(items: Iterable[DatasetItem], localize: Localize) -> float:
    """Radians in [0, 2 pi) to add to annotated azimuths so that they are in the array's frame.

    The offset is the circular median of estimate less annotation, which is robust to a minority of
    wrong estimates. Items with more than one source, or with one that moves, are refused.

    Raises
    ------
    ValueError
        If an item is not in the training split, or there are no items.
    """
    differences = []
    for item in items:
        if item.metadata["split"] != "train":
            raise ValueError(
                f"the offset is learned on training items, not on {item.metadata['split']!r}"
            )
        if item.directions.azimuth.shape != (1, 1):
            raise ValueError("the offset is learned on items with one source that stays")
        estimate = localize(item.audio, item.array)
        differences.append(estimate - float(item.directions.azimuth[0, 0]))
    if not differences:
        raise ValueError("the offset needs at least one training item")
    return circular_median(np.array(differences))


def circular_median(angles: FloatArray) -> float:
    """The angle in [0, 2 pi) with the least mean distance on the circle to angles (K,), radians.

    The best point of a grid of one degree decides where the circle is cut open; the ordinary median
    of the unwrapped angles is then the circular one.
    """
    grid = np.deg2rad(np.arange(360))
    nearest = grid[np.argmin([circular_error(angles, centre).mean() for centre in grid])]
    unwrapped = (angles - nearest + np.pi) % (2 * np.pi) - np.pi
    return float((nearest + np.median(unwrapped)) % (2 * np.pi))

"""The constant offset: found despite wrong estimates and a wrap, on training items only."""

from __future__ import annotations

import numpy as np
import pytest

from model_export.datasets.item import DatasetItem, Directions
from model_export.datasets.offset import circular_median, learn_offset
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

pytestmark = pytest.mark.torch


def item(
    array: MicrophoneArray, annotated: float, heard: float, split: str = "train"
) -> DatasetItem:
    """An item whose audio is the answer of its estimator, in degrees."""
    audio = np.full((array.num_microphones, 1), np.deg2rad(heard), np.float32)
    directions = Directions.constant(np.deg2rad(annotated))
    return DatasetItem(audio, array, directions, {"split": split})


def read_off(audio: FloatArray, array: MicrophoneArray) -> float:
    return float(audio[0, 0])


def test_a_minority_of_wrong_estimates_does_not_matter(square: MicrophoneArray) -> None:
    rng = np.random.default_rng(0)
    annotated = rng.uniform(0, 360, 101)
    heard = (annotated + 137.0 + rng.normal(0, 2.0, 101)) % 360
    heard[:30] = rng.uniform(0, 360, 30)
    items = [item(square, a, h) for a, h in zip(annotated, heard, strict=True)]
    assert np.rad2deg(learn_offset(items, read_off)) == pytest.approx(137.0, abs=1.0)


@pytest.mark.parametrize(
    ("angles", "median"), [([358, 359, 1, 2, 170], 1), ([350, 356, 2], 356), ([90], 90)]
)
def test_the_median_over_the_wrap(angles: list[float], median: float) -> None:
    assert np.rad2deg(circular_median(np.deg2rad(angles))) == pytest.approx(median)


def test_test_items_teach_nothing(square: MicrophoneArray) -> None:
    with pytest.raises(ValueError, match="training items, not on 'test'"):
        learn_offset([item(square, 0, 0), item(square, 0, 0, "test")], read_off)
    with pytest.raises(ValueError, match="at least one"):
        learn_offset([], read_off)


def test_only_one_source_that_stays(square: MicrophoneArray) -> None:
    audio = np.zeros((4, 1), np.float32)
    two = DatasetItem(audio, square, Directions.constant([0.0, 1.0]), {"split": "train"})
    with pytest.raises(ValueError, match="one source that stays"):
        learn_offset([two], read_off)

"""HOTA of hand-made tracks, against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from model_export.evaluation.tracking.hota import Moment, hota


def moments(*tracks: dict[int, float]) -> list[Moment]:
    """A talker at 50 degrees, and tracks by id in degrees."""
    return [
        Moment([0], np.deg2rad([50.0]), list(found), np.deg2rad(list(found.values())))
        for found in tracks
    ]


def test_a_perfect_track_is_one_and_none_is_zero() -> None:
    assert hota(moments(*[{1: 50.0}] * 6)) == pytest.approx(1.0)
    assert hota(moments(*[{}] * 6)) == 0.0
    assert hota([Moment([], np.zeros(0), [], np.zeros(0))]) == 1.0


def test_an_error_of_half_the_cutoff_counts_at_half_of_the_similarities() -> None:
    assert hota(moments(*[{1: 64.9}] * 6)) == pytest.approx(10 / 19, abs=1e-9)


def test_another_id_half_way_halves_the_association() -> None:
    """Every pair shares half of the talker's moments: sqrt(1 * 0.5)."""
    assert hota(moments(*[{1: 50.0}] * 4, *[{2: 50.0}] * 4)) == pytest.approx(np.sqrt(0.5))


def test_a_false_track_beside_halves_the_detection() -> None:
    assert hota(moments(*[{1: 50.0, 2: 200.0}] * 5)) == pytest.approx(np.sqrt(0.5))

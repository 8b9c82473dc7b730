"""Scores against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.doa.scoring import (
    DetectionCounts,
    circular_error,
    count_accuracy,
    detection,
    evaluate,
    maae,
    match,
    ospa,
)

ANGLES = st.lists(st.floats(0, 6.28), min_size=1, max_size=4).map(np.array)


def rad(*degrees: float) -> np.ndarray:
    return np.deg2rad(np.array(degrees))


def test_the_short_way_round() -> None:
    assert np.rad2deg(circular_error(rad(359), rad(1))) == pytest.approx(2)
    assert np.rad2deg(circular_error(rad(10), rad(200))) == pytest.approx(170)


def test_matching_minimises_the_total() -> None:
    # Greedy would take 100-102 first and leave 100 degrees for the other pair.
    pairs = match(rad(100, 0), rad(102, 98))
    assert sum(np.rad2deg(e) for _, _, e in pairs) == pytest.approx(2 + 98)
    assert np.rad2deg(maae(rad(350, 90), rad(92, 10))) == pytest.approx((20 + 2) / 2)


def test_a_missing_estimate_costs_a_random_guess() -> None:
    assert np.rad2deg(maae(rad(10), rad(10, 200))) == pytest.approx(45)
    assert np.rad2deg(maae(rad(), rad(10))) == pytest.approx(90)


def test_f1_by_hand() -> None:
    found = detection(rad(10, 100, 250), rad(12, 130), float(rad(5)[0]))
    assert found == DetectionCounts(hits=1, false_alarms=2, misses=1)
    assert found.f1 == pytest.approx(2 / 5)
    assert detection(rad(), rad(), 0.1).f1 == 1.0


def test_ospa_by_hand() -> None:
    # One pair 4 degrees apart, one unmatched at the cut-off of 30 degrees, over two.
    assert np.rad2deg(ospa(rad(10, 90), rad(14))) == pytest.approx((4 + 30) / 2)
    assert ospa(rad(), rad()) == 0.0
    assert np.rad2deg(ospa(rad(), rad(5))) == pytest.approx(30)


@given(ANGLES, ANGLES, ANGLES)
def test_ospa_is_a_metric(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    assert ospa(a, b) == pytest.approx(ospa(b, a))
    assert ospa(a, a) == pytest.approx(0, abs=1e-9)
    assert ospa(a, c) <= ospa(a, b) + ospa(b, c) + 1e-9


@given(ANGLES, st.randoms())
def test_order_does_not_matter(truth: np.ndarray, random: object) -> None:
    shuffled = truth.copy()
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    assert maae(shuffled, truth) == pytest.approx(0, abs=1e-9)


def test_evaluate_collects_everything() -> None:
    scores = evaluate([rad(10), rad(), rad(100, 200)], [rad(13), rad(), rad(100)])
    assert scores["maae_deg"] == pytest.approx(1.5)
    assert scores["count_accuracy"] == pytest.approx(2 / 3)
    assert scores["f1_5deg"] == pytest.approx(4 / 5)
    assert scores["ospa_deg"] == pytest.approx((3 + 0 + 15) / 3)


def test_shares_of_answers_and_of_talkers() -> None:
    windows = [
        (rad(5, 90), rad(0)),  # right, and a false alarm
        (rad(90, 5), rad(0)),  # the right one is not the one that the method is surest of
        (rad(), rad(0)),  # unanswered
        (rad(355, 200), rad(3, 100)),  # one of two talkers is missed
    ]
    scores = evaluate([found for found, _ in windows], [truth for _, truth in windows])
    assert scores["within_10deg"] == pytest.approx(2 / 4)
    assert scores["missed_talkers"] == pytest.approx(2 / 5)
    assert scores["unanswered"] == pytest.approx(1 / 4)
    assert scores["count_accuracy"] == pytest.approx(1 / 4)


def test_bad_input_is_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        maae(np.array([np.nan]), rad(1))
    with pytest.raises(ValueError, match="without sources"):
        maae(rad(1), rad())
    with pytest.raises(ValueError, match="at least one window"):
        count_accuracy([], [])

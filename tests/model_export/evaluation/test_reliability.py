"""Confidences against the truth, on reports made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from model_export.evaluation.reliability import Reliability, judged, reliability
from service.inference.results import Source


def source(azimuth_deg: float, confidence: float) -> Source:
    return Source(float(np.deg2rad(azimuth_deg)), confidence)


def test_a_report_is_right_once_per_talker() -> None:
    truth = [[np.cos(a), np.sin(a), 0.0] for a in np.deg2rad([2.0, 200.0])]
    reports = judged([source(355, 0.9), source(8, 0.8), source(120, 0.7)], np.array(truth))
    assert reports == [(0.9, False), (0.8, True), (0.7, False)]


def test_a_report_at_the_wrong_elevation_is_wrong() -> None:
    above = np.array([[np.cos(0.5), 0.0, np.sin(0.5)]])
    reports = judged([source(0, 0.9), Source(0.0, 0.8, elevation=0.45)], above)
    assert reports == [(0.9, False), (0.8, True)]


def test_the_error_is_the_distance_of_confidence_and_truth_in_every_bin() -> None:
    reports = [(0.95, True)] * 8 + [(0.95, False)] * 2 + [(0.55, True)] * 5 + [(1.0, True)] * 5
    found = reliability(reports, scenes=12)
    assert [(b.low, b.high, b.sources) for b in found.bins] == [(0.5, 0.6, 5), (0.9, 1.0, 15)]
    assert [b.share_right for b in found.bins] == pytest.approx([1.0, 13 / 15])
    gaps = 5 * (1 - 0.55) + 15 * abs((10 * 0.95 + 5) / 15 - 13 / 15)
    assert found.calibration_error == pytest.approx(gaps / 20)
    assert "20 sources reported in 12 scenes" in found.section()
    assert "| 0.5 to 0.6 | 5 | 0.550 | 1.000 |" in found.section()


def test_nothing_reported_is_no_error() -> None:
    assert reliability([], scenes=3) == Reliability(3, 0.0, [])

"""The summary of a recording."""

from __future__ import annotations

import numpy as np
import pytest

from service.inference.results import Source, WindowEstimate
from service.recordings.results import WindowResult
from service.recordings.summary import summarise


def window(*azimuths_deg: float, confidence: float = 0.8) -> WindowResult:
    sources = tuple(Source(float(np.deg2rad(a)) % (2 * np.pi), confidence) for a in azimuths_deg)
    return WindowResult(0.0, 1.0, WindowEstimate(sources, np.zeros(360)))


def test_two_talkers_with_their_shares() -> None:
    found = summarise([window(44), window(46, 200), window(45), window()])
    assert [round(np.rad2deg(s.azimuth)) for s in found] == [45, 200]
    assert [s.share for s in found] == [pytest.approx(1.0), pytest.approx(1 / 3)]
    assert found[0].confidence == pytest.approx(0.8)


def test_a_bound_keeps_the_most_confident_over_the_whole_recording() -> None:
    """Two talkers of which one is heard at a time are two without the bound."""
    windows = [window(45, confidence=0.4)] * 6 + [window(200, confidence=0.9)] * 4
    windows += [window(300, confidence=0.95)] * 2  # surest, but hardly ever
    assert len(summarise(windows)) == 3
    assert [round(np.rad2deg(s.azimuth)) for s in summarise(windows, 2)] == [45, 200]
    assert [round(np.rad2deg(s.azimuth)) for s in summarise(windows, 1)] == [200]


def test_a_talker_in_front_of_the_seam_is_one_talker() -> None:
    (only,) = summarise([window(358), window(2), window(0)])
    assert np.rad2deg(only.azimuth) % 360 == pytest.approx(0, abs=0.5) or only.azimuth > 6.27


def test_outliers_are_left_out() -> None:
    found = summarise([window(90)] * 19 + [window(250)])
    assert [round(np.rad2deg(s.azimuth)) for s in found] == [90]


def test_silence_has_no_summary() -> None:
    assert summarise([window(), window()]) == []


def test_sources_without_confidence_still_count() -> None:
    (only,) = summarise([window(120, confidence=0.0)])
    assert np.rad2deg(only.azimuth) == pytest.approx(120, abs=0.5)

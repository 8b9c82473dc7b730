"""Directions and times as the command line words them."""

from __future__ import annotations

import numpy as np
import pytest

from neuralmusic.cli.words import clock, degrees, sector
from service.cli.directions import stretches
from service.inference.results import Source, WindowEstimate
from service.recordings.results import WindowResult


@pytest.mark.parametrize(
    ("azimuth_deg", "shown", "words"),
    [
        (0, "0°", "front"),
        (359.8, "0°", "front"),
        (90, "90°", "left"),
        (200, "200°", "back"),
        (225, "225°", "back right"),
        (315, "315°", "front right"),
    ],
)
def test_directions_in_words(azimuth_deg: float, shown: str, words: str) -> None:
    azimuth = float(np.deg2rad(azimuth_deg))
    assert (degrees(azimuth), sector(azimuth)) == (shown, words)


@pytest.mark.parametrize(
    ("seconds", "shown"), [(3.04, "0:03.0"), (59.97, "1:00.0"), (3723.5, "1:02:03.5")]
)
def test_times_in_words(seconds: float, shown: str) -> None:
    assert clock(seconds) == shown


def test_windows_with_the_same_sources_are_one_stretch() -> None:
    heard = [(0.5, 181), (359, 182), (1, 180), (), (), (90,)]
    windows = [
        WindowResult(
            0.5 * index,
            0.5 * index + 1.0,
            WindowEstimate(
                tuple(Source(float(np.deg2rad(a)), 0.9) for a in azimuths), np.ones(360)
            ),
        )
        for index, azimuths in enumerate(heard)
    ]
    merged = stretches(windows)
    assert [(s.t_start, s.t_end, len(s.windows)) for s in merged] == [
        (0.0, 1.5, 3),
        (1.5, 2.5, 2),
        (2.5, 3.5, 1),
    ]

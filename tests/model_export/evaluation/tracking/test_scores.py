"""Scores of hand-made tracks over time."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from model_export.evaluation.tracking.scenes import CELLS, TrackingCell
from model_export.evaluation.tracking.scores import Tally, Update, score
from service.doa.scoring import circular_error
from service.doa.tracking import Track


def track(track_id: int, azimuth_deg: float, *, active: bool = True) -> Track:
    return Track(track_id, np.deg2rad(azimuth_deg) % (2 * np.pi), 0.0, 0.0, 1.0, active, 0.0, 0.0)


def stream(
    truth_deg: list[list[float]], tracks: list[list[Track]], voiced: list[list[bool]] | None = None
) -> list[Update]:
    voiced = voiced or [[True] * len(azimuths) for azimuths in truth_deg]
    return [
        Update(0.1 * index, np.deg2rad(azimuths), np.array(talks, dtype=bool), found)
        for index, (azimuths, talks, found) in enumerate(
            zip(truth_deg, voiced, tracks, strict=True)
        )
    ]


def scores(updates: list[Update], least_voiced: int = 1) -> dict[str, float]:
    tally = Tally()
    score(updates, tally, least_voiced=least_voiced)
    return tally.scores()


def test_perfect_tracks() -> None:
    found = scores(stream([[10.0, 100.0]] * 5, [[track(1, 12), track(2, 96)]] * 5))
    assert found == pytest.approx(
        {
            "identity_switches": 0,
            "false_tracks_per_minute": 0,
            "count_right": 1,
            "ospa_deg": 3,
            "missed_share": 0,
            "matched_error_deg": 3,
            "hota": (17 + np.sqrt(1 / 3)) / 19,
        }
    )


def test_a_swap_of_two_is_two_switches_and_a_new_id_is_one() -> None:
    truth = [[0.0, 90.0]] * 4
    swapped = [[track(1, 0), track(2, 90)]] * 2 + [[track(2, 0), track(1, 90)]] * 2
    assert scores(stream(truth, swapped))["identity_switches"] == 2
    renamed = [[track(1, 0), track(2, 90)]] * 2 + [[track(1, 0), track(3, 90)]] * 2
    assert scores(stream(truth, renamed))["identity_switches"] == 1


def test_an_id_that_crosses_with_its_talker_is_no_switch() -> None:
    places = np.arange(-40, 41, 5.0)
    truth = [[place, -place] for place in places]
    tracks = [[track(1, place + 2), track(2, 3 - place)] for place in places]
    assert scores(stream(truth, tracks))["identity_switches"] == 0
    bounced = [[track(1, -abs(place)), track(2, abs(place))] for place in places]
    assert scores(stream(truth, bounced))["identity_switches"] == 2


def test_a_pause_and_its_end_under_another_id_is_a_switch() -> None:
    truth, voiced = [[50.0]] * 6, [[True], [True], [False], [False], [True], [True]]
    tracks = [[track(1, 50)]] * 2 + [[]] * 2 + [[track(2, 50)]] * 2
    found = scores(stream(truth, tracks, voiced))
    assert (found["identity_switches"], found["count_right"]) == (1, 1)


def test_tracks_of_nobody_are_false_once_each() -> None:
    tracks = [[track(1, 0), track(2, 120)]] * 30 + [[track(1, 0), track(3, 200)]] * 31
    found = scores(stream([[0.0]] * 61, tracks))
    assert found["false_tracks_per_minute"] == pytest.approx(20)
    assert found["count_right"] == 0
    assert scores(stream([[]] * 61, [[track(4, 0)]] * 61)) == pytest.approx(
        {"identity_switches": 0, "false_tracks_per_minute": 10, "hota": 0}
    )


def test_who_pauses_may_be_reported_or_not() -> None:
    truth, voiced = [[0.0, 90.0]] * 2, [[True, False]] * 2
    found = scores(stream(truth, [[track(1, 0), track(2, 90)], [track(1, 0)]], voiced))
    assert (found["count_right"], found["ospa_deg"], found["missed_share"]) == (1, 0, 0)


def test_coasting_tracks_are_not_scored() -> None:
    found = scores(stream([[0.0]] * 2, [[track(1, 0), track(2, 90, active=False)]] * 2))
    assert (found["count_right"], found["false_tracks_per_minute"]) == (1, 0)


def test_missed_is_farther_than_ten_degrees() -> None:
    found = scores(stream([[0.0, 90.0]] * 2, [[track(1, 9), track(2, 101)]] * 2))
    assert found["missed_share"] == pytest.approx(0.5)


def test_updates_with_too_few_voiced_talkers_do_not_count() -> None:
    voiced = [[True, True], [True, False]]
    tally = Tally()
    score(stream([[0.0, 90.0]] * 2, [[track(1, 0)]] * 2, voiced), tally, least_voiced=2)
    assert (tally.updates, tally.count_right, tally.missed, tally.voiced) == (1, 0, 1, 2)


def test_who_returns_after_a_silence_should_have_the_same_id() -> None:
    silence = 26
    truth, voiced = [[50.0]] * (silence + 8), [[True]] * 4 + [[False]] * silence + [[True]] * 4
    for last, same in ((1, 1), (2, 0)):
        tracks = [[track(1, 50)]] * 4 + [[]] * silence + [[]] + [[track(last, 50)]] * 3
        tally = Tally()
        score(stream(truth, tracks, voiced), tally)
        assert (tally.returns, tally.same_ids) == (1, same)
    tally = Tally()
    score(stream(truth, [[track(1, 50)]] * 4 + [[]] * (silence + 4), voiced), tally)
    assert (tally.returns, tally.same_ids) == (1, 0)


@pytest.mark.parametrize("cell", [cell for cell in CELLS if cell.bars], ids=lambda cell: cell.name)
def test_the_paths_are_what_the_cell_says(cell: TrackingCell) -> None:
    times = np.arange(0, cell.seconds, 0.01)
    for seed in range(5):
        arcs = [part.path for part in cell.parts(np.random.default_rng(seed))]
        if len(arcs) == 1:
            steps = np.angle(np.exp(1j * np.diff(arcs[0].azimuth(times))))
            speeds = np.abs(np.rad2deg(steps)) / 0.01
            assert speeds == pytest.approx(np.full_like(speeds, speeds[0]))
            assert 15 <= speeds[0] <= 40
            continue
        apart = np.rad2deg(np.angle(np.exp(1j * (arcs[0].azimuth(times) - arcs[1].azimuth(times)))))
        if cell.least_voiced == 2:
            assert f"{abs(apart[0]):.0f}°" in cell.name
            assert np.ptp(apart) == pytest.approx(0, abs=1e-9)
        else:
            near = np.abs(apart) < 5
            assert abs(apart[0]) > 85
            assert np.count_nonzero(np.diff(near.astype(int)) == 1) == 1
            assert 2.3 < times[near].mean() < 4.2


def test_the_parts_are_what_the_cell_says() -> None:
    named = {cell.name.split(",")[0]: cell for cell in CELLS if not cell.bars}
    for seed in range(5):
        rng = np.random.default_rng(seed)
        (moving,) = named["one moves 30° in silence"].parts(rng)
        (first, begin), (end, _) = moving.turns
        before, after = moving.path.azimuth(np.array([first, end])).tolist()
        assert circular_error(np.array(before), np.array(after)) == pytest.approx(np.deg2rad(30))
        assert moving.path.azimuth(np.array(begin)) == pytest.approx(before)
        (resting,) = named["one pauses for 3 to 10 s"].parts(rng)
        assert 3 <= resting.turns[1][0] - resting.turns[0][1] <= 10
        one, other = named["two take turns"].parts(rng)
        turns = sorted([*one.turns, *other.turns])
        assert all(end < begin for (_, end), (begin, _) in pairwise(turns))
        still, walker = named["one walks behind a talker"].parts(rng)
        assert walker.path.distance > still.path.distance

"""The tracker against simulated talkers whose paths, pauses and numbers are known."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.doa.kalman import angles, direction
from service.doa.peaks import circular_difference
from service.doa.scoring import circular_error, match
from service.doa.tracking import Detection, Track, Tracker, TrackerParameters
from service.doa.types import FloatArray

ERROR = math.radians(2.5)
Path = Callable[[float], float | None]
"""Seconds to radians, None in a pause"""
Heard = list[tuple[float, list[Detection]]]


def still(azimuth_deg: float) -> Path:
    return lambda time: math.radians(azimuth_deg)


def moving(azimuth_deg: float, velocity_deg: float) -> Path:
    return lambda time: math.radians(azimuth_deg + velocity_deg * time)


def paused(path: Path, begin: float, end: float) -> Path:
    return lambda time: None if begin <= time < end else path(time)


def heard(
    paths: Sequence[Path],
    interval: float,
    seconds: float,
    seed: int = 1,
    *,
    missed: float = 0.1,
    resolution_deg: float = 10.0,
) -> Heard:
    """Detections whose errors last for 0.2 s, as overlapping windows give them.

    Talkers closer than the resolution are heard as one in the middle between them.
    """
    rng = np.random.default_rng(seed)
    kept = math.exp(-interval / 0.2)
    errors = ERROR * rng.standard_normal(len(paths))
    updates: Heard = []
    for time in np.arange(round(seconds / interval)) * interval:
        errors = kept * errors + ERROR * math.sqrt(1 - kept**2) * rng.standard_normal(len(paths))
        azimuths = [path(float(time)) for path in paths]
        missing = rng.random(len(paths)) < missed
        found = [
            azimuth + error
            for azimuth, error, lost in zip(azimuths, errors, missing, strict=True)
            if azimuth is not None and not lost
        ]
        if len(found) == 2 and circular_error(
            np.array(found[0]), np.array(found[1])
        ) < math.radians(resolution_deg):
            found = [found[0] - circular_difference(found[0], found[1]) / 2]
        detections = [Detection(a % (2 * math.pi), 0.95 - 0.01 * k) for k, a in enumerate(found)]
        updates.append((float(time), detections))
    return updates


def track(
    updates: Heard, parameters: TrackerParameters | None = None
) -> list[tuple[float, tuple[Track, ...]]]:
    tracker = Tracker(parameters)
    return [(time, tracker.update(detections, time)) for time, detections in updates]


def ids(tracked: Sequence[tuple[float, tuple[Track, ...]]]) -> set[int]:
    return {found.id for _, tracks in tracked for found in tracks}


def nearest(tracks: Sequence[Track], azimuth: float) -> Track:
    return min(tracks, key=lambda t: abs(circular_difference(t.azimuth, azimuth)))


def test_one_who_walks_past_overhead_keeps_the_id() -> None:
    tracker, rng = Tracker(), np.random.default_rng(5)
    found = []
    for step in range(80):
        height = math.radians(10 + 2 * step)  # from 10 degrees in front up and over to the back
        azimuth, elevation = angles(direction(0.0, height))
        error = rng.normal(0, math.radians(2), 2)
        spread = error[0] / max(math.cos(elevation), 0.05)
        heard = Detection(azimuth + spread, 0.95, elevation + error[1])
        found.extend(tracker.update([heard], 0.1 * step))
    assert {track.id for track in found} == {1}
    assert found[-1].elevation == pytest.approx(math.pi - height, abs=math.radians(8))
    assert abs(circular_difference(found[-1].azimuth, math.pi)) < math.radians(15)


def test_two_above_each_other_are_two() -> None:
    tracker = Tracker()
    for step in range(30):
        heard = [Detection(1.0, 0.9, elevation) for elevation in (-0.5, 0.5)]
        tracks = tracker.update(heard, 0.1 * step)
    assert [track.id for track in tracks] == [1, 2]
    assert sorted(track.elevation or 0.0 for track in tracks) == pytest.approx(
        [-0.5, 0.5], abs=0.02
    )


@given(st.integers(0, 20), st.floats(0, 2 * np.pi))
@settings(max_examples=20, deadline=None)
def test_rotating_all_detections_rotates_all_tracks(seed: int, angle: float) -> None:
    updates = heard([still(80), moving(200, 20), moving(320, -15)], 0.1, 4.0, seed)
    rotated = [
        (time, [replace(d, azimuth=d.azimuth + angle) for d in detections])
        for time, detections in updates
    ]
    for (_, before), (_, after) in zip(track(updates), track(rotated), strict=True):
        assert [t.id for t in after] == [t.id for t in before]
        for one, other in zip(before, after, strict=True):
            assert circular_difference(other.azimuth, one.azimuth + angle) == pytest.approx(
                0, abs=1e-6
            )
            assert other.confidence == pytest.approx(one.confidence)


@given(st.integers(0, 20), st.randoms(use_true_random=False))
@settings(max_examples=20, deadline=None)
def test_the_order_of_detections_means_nothing(seed: int, shuffler: object) -> None:
    updates = heard([still(80), moving(200, 20), moving(320, -15)], 0.1, 3.0, seed)
    shuffled = []
    for time, detections in updates:
        copy = list(detections)
        shuffler.shuffle(copy)  # type: ignore[attr-defined]
        shuffled.append((time, copy))
    assert track(updates) == track(shuffled)


@pytest.mark.parametrize("interval", [0.02, 0.05, 0.1, 0.2, 0.5])
def test_talkers_are_counted_alike_at_every_interval(interval: float) -> None:
    paths = [paused(still(30), 2.0, 2.6), moving(150, 12), still(290)]
    tracked = track(heard(paths, interval, 6.0))
    assert ids(tracked) == {1, 2, 3}
    time, tracks = tracked[-1]
    truth = np.array([path(time) for path in paths])
    pairs = match(np.array([t.azimuth for t in tracks]), truth)
    assert len(pairs) == 3
    assert all(error < math.radians(8) for _, _, error in pairs)


@pytest.mark.parametrize("interval", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("velocity_deg", [15.0, 30.0, 50.0])
def test_crossing_talkers_keep_their_ids(velocity_deg: float, interval: float) -> None:
    """Both at the same speed, from 60 degrees on one side to 60 degrees on the other."""
    kept, runs = 0, 20
    for seed in range(runs):
        paths = [moving(-60, velocity_deg), moving(60, -velocity_deg)]
        tracked = track(heard(paths, interval, 120 / velocity_deg, seed))
        quarter, end = tracked[len(tracked) // 4], tracked[-1]
        followed = [
            nearest(tracks, path(time) or 0.0).id if tracks else None
            for time, tracks in (quarter, end)
            for path in paths
        ]
        kept += followed[:2] == followed[2:] and len(ids(tracked)) == 2
    assert kept >= 0.9 * runs


@pytest.mark.parametrize("interval", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("pause", [0.5, 1.0])
def test_an_id_survives_a_pause(pause: float, interval: float) -> None:
    tracked = track(heard([paused(still(100), 3.0, 3.0 + pause)], interval, 6.0))
    assert ids(tracked) == {1}
    end = 3.0 + pause
    assert all(t.active for time, tracks in tracked for t in tracks if time < 3.1 or time > end + 1)
    before_it_ends = [tracks for time, tracks in tracked if time < end - 0.01][-1]
    assert [t.active for t in before_it_ends] == [False]


def test_a_talker_who_stops_is_gone_after_three_seconds() -> None:
    tracked = track(heard([paused(still(100), 3.0, 9.0)], 0.1, 7.0))
    assert all(not tracks for time, tracks in tracked if time > 6.0)
    assert all(tracks for time, tracks in tracked if 0.5 < time < 4.0)


@pytest.mark.parametrize(("pause", "same"), [(3.0, True), (6.0, True), (10.0, True), (14.0, False)])
def test_who_goes_on_at_the_old_place_has_the_old_id(pause: float, same: bool) -> None:
    tracked = track(heard([paused(still(100), 3.0, 3.0 + pause)], 0.1, 6.0 + pause))
    assert ids(tracked) == ({1} if same else {1, 2})
    assert tracked[-1][1][0].born == pytest.approx(tracked[0][0] if same else 3.0 + pause, abs=0.5)


def test_those_who_take_turns_keep_their_ids() -> None:
    first = paused(paused(still(20), 5.0, 10.0), 15.0, 20.0)
    second = paused(paused(still(70), 0.0, 5.3), 9.7, 15.3)
    tracked = track(heard([first, second], 0.1, 20.0))
    assert ids(tracked) == {1, 2}
    for time, tracks in tracked:
        for path, talker in ((first, 1), (second, 2)):
            azimuth = path(time)
            if azimuth is not None and path(time - 1.0) is not None and time > 1:
                assert nearest([t for t in tracks if t.active], azimuth).id == talker


@pytest.mark.parametrize(("moved_deg", "same"), [(25.0, True), (60.0, False)])
def test_who_moves_in_silence_keeps_the_id_if_not_far(moved_deg: float, same: bool) -> None:
    def path(time: float) -> float:
        return math.radians(40 + (moved_deg if time > 4.0 else 0.0))

    tracked = track(heard([paused(path, 3.0, 7.0)], 0.1, 9.0))
    assert ids(tracked) == ({1} if same else {1, 2})


def test_the_nearest_of_the_silent_ones_goes_on() -> None:
    paths = [paused(still(20), 2.0, 9.0), paused(still(50), 2.0, 6.0)]
    tracked = track(heard(paths, 0.1, 11.0))
    assert ids(tracked) == {1, 2}
    talkers = {nearest(tracked[15][1], math.radians(a)).id: a for a in (20, 50)}
    for track_now in tracked[-1][1]:
        place = math.radians(talkers[track_now.id])
        assert abs(circular_difference(track_now.azimuth, place)) < math.radians(8)


def test_a_coasting_track_slows_down() -> None:
    tracked = track(heard([paused(moving(0, 30), 3.0, 9.0)], 0.1, 5.0))
    speeds = [tracks[0].velocity for time, tracks in tracked if time > 3.3 and tracks]
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[-1] < 0.3 * speeds[0]


@given(st.lists(st.floats(1e-3, 2.0), min_size=1, max_size=30))
def test_silence_gives_no_track(steps: list[float]) -> None:
    tracker = Tracker()
    assert all(tracker.update([], float(time)) == () for time in np.cumsum(steps))


def test_isolated_unsure_detections_give_no_track() -> None:
    rng = np.random.default_rng(4)
    tracker = Tracker()
    for step in range(1200):
        clutter = [Detection(rng.uniform(0, 2 * np.pi), rng.uniform(0.2, 0.6))]
        assert tracker.update(clutter if rng.random() < 0.1 else [], 0.1 * step) == ()


def test_unsure_detections_that_repeat_become_a_track() -> None:
    tracker = Tracker()
    counts = [len(tracker.update([Detection(1.0, 0.65)], 0.1 * step)) for step in range(10)]
    assert counts[0] == 0
    assert counts[-1] == 1


@pytest.mark.parametrize("confidence", [0.87, 0.95])
def test_a_sure_detection_is_a_track_within_one_more_update(confidence: float) -> None:
    tracker = Tracker()
    tracker.update([], 1.0)
    tracker.update([Detection(1.0, confidence)], 1.1)
    assert len(tracker.update([Detection(1.0, confidence)], 1.2)) == 1


def test_at_a_stream_s_begin_one_sure_detection_is_not_enough() -> None:
    """Noise begins there as well, and a tenth of a second is all that was heard."""
    assert Tracker().update([Detection(1.0, 0.95)], 0.1) == ()
    assert len(Tracker().update([Detection(1.0, 0.95)], 3.0)) == 1
    tracker = Tracker()
    tracker.update([Detection(1.0, 0.95)], 0.1)
    assert len(tracker.update([Detection(1.0, 0.95)], 0.2)) == 1


@given(st.floats(-20, 20) | st.sampled_from([-1e-17, -1e-300, 2 * math.pi, 4 * math.pi]))
def test_azimuths_are_within_one_turn(azimuth: float) -> None:
    (found,) = Tracker().update([Detection(azimuth, 0.99)], 1.0)
    assert 0 <= found.azimuth < 2 * math.pi
    assert circular_difference(found.azimuth, azimuth) == pytest.approx(0, abs=1e-9)


def test_a_refused_update_changes_nothing() -> None:
    tracker = Tracker()
    tracker.update([Detection(1.0, 0.95)], 1.0)
    with pytest.raises(ValueError, match="finite"):
        tracker.update([Detection(math.nan, 0.9)], 5.0)
    assert [t.id for t in tracker.update([Detection(1.0, 0.95)], 1.1)] == [1]


@pytest.mark.parametrize("velocity_deg", [35.0, -35.0])
def test_who_walks_leaves_no_track_in_its_wake(velocity_deg: float) -> None:
    """A window holds syllables of half a second: the oldest came from 18 degrees behind."""
    rng = np.random.default_rng(7)
    tracker = Tracker()
    for step in range(50):
        now = math.radians(velocity_deg) * 0.1 * step
        heard_at = [now, now - math.radians(velocity_deg) / 2] if rng.random() < 0.4 else [now]
        detections = [Detection(a + ERROR * rng.standard_normal() / 2, 0.95) for a in heard_at]
        tracks = tracker.update(detections, 1 + 0.1 * step)
        assert len(tracks) == 1 or step < 8
    assert [t.id for t in tracks] == [1]


@pytest.mark.parametrize("velocity_deg", [25.0, -25.0])
def test_a_track_passes_the_seam(velocity_deg: float) -> None:
    paths = [moving(-velocity_deg * 2, velocity_deg)]
    tracked = track(heard(paths, 0.1, 4.0))
    assert ids(tracked) == {1}
    for time, tracks in tracked[10:]:
        assert 0 <= tracks[0].azimuth < 2 * np.pi
        assert circular_difference(tracks[0].azimuth, paths[0](time) or 0.0) == pytest.approx(
            0, abs=math.radians(12)
        )


def test_two_tracks_of_one_talker_merge_into_the_older() -> None:
    """Two talkers walk together and are heard as one from then on."""

    def second(time: float) -> float:
        return math.radians(60 - min(time, 2.5) * 20)

    tracked = track(heard([still(10), second], 0.1, 8.0, resolution_deg=14))
    assert ids(tracked[:10]) == {1, 2}
    assert [t.id for t in tracked[-1][1]] == [1]


def test_there_are_never_more_tracks_than_allowed() -> None:
    rng = np.random.default_rng(5)
    tracker = Tracker(TrackerParameters(most_tracks=5))
    for step in range(200):
        directions = (rng.permutation(12) * 30.0)[:8]
        detections = [Detection(math.radians(d), rng.uniform(0.6, 0.99)) for d in directions]
        assert len(tracker.update(detections, 0.1 * step)) <= 5


def test_no_id_is_given_to_two() -> None:
    tracker = Tracker()
    seen: list[int] = []
    for talker in range(4):
        for step in range(5):
            tracks = tracker.update([Detection(talker * 1.0, 0.95)], 10.0 * talker + 0.1 * step)
        seen += [t.id for t in tracks]
        if talker == 1:
            tracker.reset()
    assert seen == [1, 2, 3, 4]


def test_a_gap_in_time_only_predicts_further() -> None:
    tracker = Tracker()
    for step in range(10):
        (before,) = tracker.update([Detection(1.0, 0.95)], 1 + 0.1 * step)
    (after,) = tracker.update([Detection(1.0, 0.95)], 2.6)
    assert (before.id, after.id) == (1, 1)


def test_what_is_no_stream_is_refused() -> None:
    tracker = Tracker()
    tracker.update([], 1.0)
    tracker.update([], 1.0)
    with pytest.raises(ValueError, match="backwards"):
        tracker.update([], 0.9)
    with pytest.raises(ValueError, match="finite"):
        tracker.update([], math.nan)
    with pytest.raises(ValueError, match="confidence"):
        tracker.update([Detection(0.0, 1.5)], 2.0)
    tracker.reset()
    assert tracker.update([], 0.0) == ()


def test_the_velocity_makes_up_for_late_detections() -> None:
    """Windows see where a talker was; the report says where it is."""
    late = TrackerParameters()
    velocity = math.radians(30)
    updates = [
        (0.1 * k, [Detection((velocity * (0.1 * k - late.lag_s)) % (2 * np.pi), 0.95)])
        for k in range(40)
    ]
    errors: dict[float, FloatArray] = {}
    for lag in (0.0, late.lag_s):
        tracked = track(updates, replace(late, lag_s=lag))
        found = np.array([tracks[0].azimuth for _, tracks in tracked[10:]])
        errors[lag] = circular_error(found, velocity * np.array([t for t, _ in tracked[10:]]))
    assert errors[late.lag_s].mean() < 0.5 * errors[0.0].mean()

"""Rotations and poses against scipy's, which is independent of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation as Reference
from scipy.spatial.transform import Slerp

from service.doa.pose import MOST_POSES, Pose, PoseTrack, Rotation, mean_rotation

turns = st.tuples(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
Angles = tuple[float, float, float]


def reference(angles: Angles) -> Reference:
    return Reference.from_euler("ZYX", angles)


@given(turns, turns)
def test_rotations_are_those_of_ros(first: Angles, second: Angles) -> None:
    one, other = Rotation.of_angles(*first), Rotation.of_angles(*second)
    np.testing.assert_allclose(one.matrix, reference(first).as_matrix(), atol=1e-9)
    both = reference(second) * reference(first)
    np.testing.assert_allclose(other.after(one).matrix, both.as_matrix(), atol=1e-9)
    assert one.angle == pytest.approx(reference(first).magnitude(), abs=1e-6)
    assert one.angles == pytest.approx(first, abs=1e-6)
    np.testing.assert_allclose(one.after(one.inverse).matrix, np.eye(3), atol=1e-9)


@given(turns, st.tuples(*[st.floats(-1, 1)] * 3), st.floats(0, 1))
def test_the_way_between_two_rotations_is_the_shortest(
    first: Angles, change: Angles, share: float
) -> None:
    begin = reference(first)
    end = begin * Reference.from_rotvec(change)
    expected = Slerp([0, 1], Reference.concatenate([begin, end]))(share)
    one, other = (Rotation(*np.roll(rotation.as_quat(), 1).tolist()) for rotation in (begin, end))
    np.testing.assert_allclose(one.towards(other, share).matrix, expected.as_matrix(), atol=1e-7)


def test_a_yaw_is_what_a_tilted_head_is_turned_by() -> None:
    for yaw in (-2.0, 0.0, 1.0):
        assert Rotation.of_angles(yaw).yaw == pytest.approx(yaw)
        assert Rotation.of_angles(yaw, 0.3).yaw == pytest.approx(yaw, abs=0.02)


def track(velocity: float, rate: float = 50.0, seconds: float = 2.0) -> PoseTrack:
    poses = PoseTrack()
    for step in range(round(seconds * rate)):
        poses.add(Pose(step / rate, Rotation.of_angles(velocity * step / rate)))
    return poses


def test_poses_are_interpolated_in_any_order() -> None:
    poses = PoseTrack()
    for time in (0.4, 0.0, 0.8, 0.2):
        poses.add(Pose(time, Rotation.of_angles(3.0 * time)))
    for time in (0.1, 0.37, 0.61):
        assert poses.at(time).yaw == pytest.approx(3.0 * time)
    assert poses.at(-5.0).yaw == pytest.approx(0.0)


def test_a_turn_goes_on_for_a_moment_and_is_held() -> None:
    poses = track(2.0)
    newest = 1.98
    assert poses.at(newest + 0.05).yaw == pytest.approx(2.0 * (newest + 0.05))
    assert poses.at(newest + 60).yaw == pytest.approx(2.0 * (newest + 0.1))
    single = PoseTrack()
    single.add(Pose(1.0, Rotation.of_angles(0.7)))
    assert single.at(9.0).yaw == pytest.approx(0.7)


def test_noise_of_single_poses_averages_out() -> None:
    rng, poses = np.random.default_rng(1), PoseTrack()
    for step in range(200):
        noisy = 1.0 + math.radians(4) * rng.standard_normal()
        poses.add(Pose(step / 100, Rotation.of_angles(noisy)))
    times = np.arange(20, 180) / 100
    single = np.std([poses.at(time).yaw for time in times])
    assert np.std([poses.around(time, 0.128).yaw for time in times]) < 0.6 * single


def test_the_mean_does_not_mind_signs_of_quaternions() -> None:
    one = Rotation.of_angles(0.4)
    other = Rotation(*(-value for value in Rotation.of_angles(0.6)))
    assert mean_rotation([one, other]).matrix == pytest.approx(Rotation.of_angles(0.5).matrix)


def test_poses_are_bounded() -> None:
    poses = PoseTrack()
    for step in range(MOST_POSES + 10):
        poses.add(Pose(float(step), Rotation.of_angles(0.1)))
    assert poses.at(0.0) == poses.at(10.0)
    assert len(poses._poses) == MOST_POSES

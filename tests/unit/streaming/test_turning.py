"""Streams of a head that turns: talkers who stand still are one source in the world."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from service.doa.array import MicrophoneArray
from service.doa.steering import unit_vectors
from service.doa.types import FloatArray
from service.streaming.poses import STALE_S

from .conftest import Driver, NewSession, pcm, start
from .test_session_results import off

RATE = 16000
HOP = 320
SPEED_OF_SOUND = 343.0
Yaw = Callable[[FloatArray], FloatArray]
"""Seconds to degrees"""


def heard_while_turning(array: MicrophoneArray, azimuth_deg: float, yaw: Yaw) -> FloatArray:
    """(N, T): three seconds of noise in bursts from one direction, on an array that turns."""
    rng, length, finer = np.random.default_rng(3), 3 * RATE, 8
    bursts = np.repeat(rng.uniform(0.1, 1.0, length // 800), 800) * rng.standard_normal(length)
    spectrum = np.fft.rfft(bursts)
    spectrum[np.fft.rfftfreq(length, 1 / RATE) > 5000] = 0
    sound = finer * np.fft.irfft(spectrum, finer * length)
    times = np.arange(length) / RATE
    towards = unit_vectors(np.deg2rad(azimuth_deg - yaw(times)))  # (T, 3) in the array's frame
    arrival = times + array.positions @ towards.T / SPEED_OF_SOUND
    audio = np.interp(arrival * RATE * finer, np.arange(len(sound)), sound)
    return 0.05 * audio + 1e-4 * rng.standard_normal(audio.shape)


def turning(driver: Driver, audio: FloatArray, yaw: Yaw, **changes: Any) -> list[dict[str, Any]]:
    """Results of a stream in which a pose comes before every 20 ms of audio."""
    driver.send(start(**changes))
    for begin in range(0, audio.shape[1], HOP):
        now = float(yaw(np.array(begin / RATE)))
        driver.send({"type": "pose", "t": begin / RATE, "yaw_deg": now})
        driver.audio(pcm(audio[:, begin : begin + HOP]))
    return [found for found in driver.all("result") if found["t_end"] > 0.8]


@pytest.mark.parametrize("method", ["neural", "norm_music"])
@pytest.mark.parametrize("velocity", [60.0, -180.0])
def test_who_stands_still_has_one_id_and_direction_in_the_world(
    new_session: NewSession, square: MicrophoneArray, velocity: float, method: str
) -> None:
    def yaw(time: FloatArray) -> FloatArray:
        return 30 + velocity * time

    audio = heard_while_turning(square, 250.0, yaw)
    found = turning(new_session(), audio, yaw, method=method, output={"frame": "world"})
    sources = [source for result in found for source in result["sources"]]
    assert len(found) == 22
    assert len(sources) >= (22 if method == "neural" else 15)
    assert {source["id"] for source in sources} == {1}
    wrong = [off(source["azimuth_deg"], 250.0) for source in sources]
    assert max(wrong) < (4 if method == "neural" else 12)
    assert found[-1]["pose"]["yaw_deg"] % 360 == pytest.approx((30 + 3 * velocity) % 360, abs=0.2)


def test_the_robot_s_frame_turns_with_it(new_session: NewSession, square: MicrophoneArray) -> None:
    def yaw(time: FloatArray) -> FloatArray:
        return 90 * time

    audio = heard_while_turning(square, 100.0, yaw)
    output = {"yaw_deg": 0.0, "exclude_deg": [[200, 250]], "include": ["spectrum"]}
    for result in turning(new_session(), audio, yaw, output=output):
        place = (100 - 90 * result["t_end"]) % 360
        for source in result["sources"]:
            assert off(source["azimuth_deg"], place) < 6
        assert bool(result["sources"]) or 190 < place < 260
        assert off(float(np.argmax(result["spectrum"])), place) < 8


def test_a_mounted_array_s_yaw_comes_before_the_pose(
    new_session: NewSession, square: MicrophoneArray
) -> None:
    """The array is turned by 90 degrees on a head that is turned by the pose."""

    def yaw(time: FloatArray) -> FloatArray:
        return 120 * time

    audio = heard_while_turning(square, 300.0, lambda time: yaw(time) + 90)
    for frame, turn in (("world", 0.0), ("robot", 120.0)):
        output = {"yaw_deg": 90.0, "frame": frame, "include": ["spectrum"]}
        for result in turning(new_session(), audio, yaw, output=output):
            expected = 300.0 - turn * result["t_end"]
            assert [off(s["azimuth_deg"], expected) < 5 for s in result["sources"]] == [True]
            assert off(float(np.argmax(result["spectrum"])), expected) < 8


def test_a_head_that_nods_hears_where_the_talker_is(
    new_session: NewSession, plane_waves: Any
) -> None:
    """Poses as quaternions; the talker is at the height of a head that looks 40 degrees down."""
    array = MicrophoneArray("tetrahedron", 0.03 * preset_tetrahedron())
    audio = plane_waves(array, [0.0], seconds=1.5)
    nod = np.deg2rad(40) / 2
    driver = new_session()
    driver.send(
        start(
            array={"positions_m": array.positions.tolist(), "name": "tetrahedron"},
            output={"frame": "world"},
        )
    )
    quaternion = [0.0, 2 * np.sin(nod), 0.0, 2 * np.cos(nod)]
    driver.send({"type": "pose", "quaternion_xyzw": quaternion})
    driver.audio(pcm(audio))
    sources = driver.all("result")[-1]["sources"]
    assert [source["elevation_deg"] for source in sources] == [pytest.approx(-40, abs=3)]
    assert driver.all("result")[-1]["pose"]["pitch_deg"] == pytest.approx(40, abs=0.01)


def preset_tetrahedron() -> FloatArray:
    return np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])


def test_still_poses_change_nothing(new_session: NewSession, square: MicrophoneArray) -> None:
    audio = heard_while_turning(square, 70.0, np.zeros_like)
    plain = new_session()
    plain.send(start())
    plain.audio(pcm(audio))
    posed = turning(new_session(), audio, lambda time: np.full_like(time, 20.0))
    before = [result["sources"] for result in plain.all("result") if result["t_end"] > 0.8]
    assert [
        [(source["azimuth_deg"], source["confidence"]) for source in sources] for sources in before
    ] == [
        [
            (pytest.approx(source["azimuth_deg"], abs=0.02), source["confidence"])
            for source in r["sources"]
        ]
        for r in posed
    ]


def test_poses_that_stay_away_are_told_once(
    new_session: NewSession, square: MicrophoneArray
) -> None:
    driver = new_session()
    driver.send(start(method="norm_music"))
    silence = pcm(np.zeros((4, RATE)))
    driver.send({"type": "pose", "yaw_deg": 5})
    for _ in range(4):
        driver.audio(silence)
    driver.send({"type": "pose", "yaw_deg": 5})
    driver.audio(silence)
    warned = [w for w in driver.all("warning") if w["code"] == "pose_stale"]
    assert len(warned) == 1
    assert f"{STALE_S:g} s" in warned[0]["detail"]


def test_capture_times_place_poses_and_need_headers(
    new_session: NewSession, square: MicrophoneArray
) -> None:
    driver = new_session()
    driver.send(start())
    driver.send({"type": "pose", "capture_time_ns": 5, "yaw_deg": 1})
    assert driver.all("error")[-1]["code"] == "message_invalid"
    assert "seq_time" in driver.all("error")[-1]["detail"]


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"t": 1.0, "capture_time_ns": 3}, "not both"),
        ({"yaw_deg": 3.0, "quaternion_xyzw": [0.0, 0, 0, 1]}, "not both"),
        ({"quaternion_xyzw": [0.0, 0, 0, 0]}, "no rotation"),
        ({"quaternion_xyzw": [0.0, 0, 1]}, "quaternion_xyzw"),
    ],
)
def test_what_is_no_pose_is_refused(
    new_session: NewSession, fields: dict[str, Any], said: str
) -> None:
    driver = new_session()
    driver.send(start())
    driver.send({"type": "pose", **fields})
    assert said in driver.all("error")[-1]["detail"]

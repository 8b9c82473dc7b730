"""The session as a state machine: order of messages, limits, overload, gaps, bad input."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from neuralmusic.protocol.close_codes import CloseCode
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.stft import Stft
from service.doa.types import FloatArray
from service.doa.whitening import learn_noise
from service.inference.noise_store import NoiseStore
from service.streaming.pipeline import StreamPipeline
from service.streaming.reporter import SessionLimits

from .conftest import NewSession, pcm, start

RATE = 16000
CLASSICAL = start(method="norm_music")
SECOND = pcm(0.01 * np.random.default_rng(0).standard_normal((4, RATE)))


def stamped(sequence: int, captured_ns: int, audio: bytes) -> bytes:
    return struct.pack("<IIq", 0, sequence, captured_ns) + audio


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [
        ({"array": {"name": "no-such-array"}}, "array_unknown", "no-such-array"),
        ({"array": {"positions_m": [[0, 0, 0], [4, 0, 0]]}}, "geometry_invalid", "centimetres"),
        ({"array": {"name": None}}, "option_invalid", "positions_m"),
        ({"array": {"name": "a\nb"}}, "option_invalid", "printable"),
        ({"audio": {"channels": 2}}, "channel_mismatch", "2 channels"),
        ({"client": "-x"}, "message_invalid", "start.client"),
        ({"client": ".hidden"}, "message_invalid", "start.client"),
        ({"channel_map": [0, 1, 2, 9]}, "channel_mismatch", "channel 9"),
        ({"channel_map": [0, 1, 2, 2]}, "channel_map_invalid", "twice"),
        (
            {"channel_map": [0, 1, 2, 3], "array": {"channel_map": [3, 2, 1, 0]}},
            "channel_map_invalid",
            "in the start and in its array",
        ),
        ({"audio": {"sample_rate": 2_000_000}}, "message_invalid", "start.audio.sample_rate"),
        ({"audio": {"encoding": "mp3"}}, "message_invalid", "pcm_s16le"),
        ({"model": "nobody"}, "model_unknown", "nobody"),
        ({"output": {"num_sources": 4}}, "too_many_sources", "at most 3"),
        ({"output": {"colour": 1}}, "message_invalid", "start.output.colour"),
        ({"output": {"exclude_deg": [[10, 370]]}}, "message_invalid", "exclude_deg"),
    ],
)
def test_a_start_that_cannot_be_is_refused_with_what_to_do(
    changes: dict[str, Any], code: str, words: str, new_session: NewSession
) -> None:
    driver = new_session()
    driver.send(start(**changes))
    error = driver.last
    assert (error["type"], error["code"], error["close_code"]) == ("error", code, 4400)
    assert words in error["detail"]
    assert not error["retryable"]
    assert driver.session.close_code == CloseCode.INVALID_MESSAGE


@pytest.mark.parametrize(
    ("data", "code", "close_code", "words"),
    [
        (b"RIFF\x00\x00\x00\x00WAVEfmt " + bytes(16), "message_invalid", 4400, "WAV"),
        (b"fLaC" + bytes(28), "message_invalid", 4400, "FLAC"),
        (bytes(7), "message_invalid", 4400, "8 bytes"),
        (bytes(262_152), "message_too_big", 1009, "262144"),
    ],
)
def test_audio_that_cannot_be_is_refused_with_what_to_do(
    data: bytes, code: str, close_code: int, words: str, new_session: NewSession
) -> None:
    driver = new_session()
    driver.send(CLASSICAL)
    driver.audio(data, 300_000)
    assert (driver.last["code"], driver.last["close_code"]) == (code, close_code)
    assert words in driver.last["detail"]


def test_audio_before_start_closes_with_1003(new_session: NewSession) -> None:
    driver = new_session()
    driver.audio(bytes(8))
    assert (driver.last["code"], driver.last["close_code"]) == ("audio_before_start", 1003)


@pytest.mark.parametrize("bomb", ["[" * 30_000, '{"a":' * 9_000, '{"type":"' + "x" * 60_000 + '"}'])
def test_json_bombs_are_one_sentence(bomb: str, new_session: NewSession) -> None:
    driver = new_session()
    driver.send(bomb)
    assert driver.last["code"] == "message_invalid"
    assert len(driver.last["detail"]) < 300


def test_a_message_of_more_than_64_kib_is_too_big(new_session: NewSession) -> None:
    driver = new_session()
    driver.send(" " * 65_537)
    assert (driver.last["code"], driver.last["close_code"]) == ("message_too_big", 1009)


def test_the_oldest_audio_is_dropped_and_said_so(new_session: NewSession) -> None:
    driver = new_session(eager=False)
    driver.send(CLASSICAL)
    driver.work()
    for _ in range(5):
        driver.audio(SECOND)
    assert driver.session.buffered_s <= 0.6
    driver.work()
    warning = driver.all("warning")[0]
    assert warning["code"] == "audio_dropped"
    driver.send({"type": "stop"})
    driver.work()
    summary = driver.only("summary")
    results = driver.all("result")
    assert summary["dropped_s"] + 0.1 * len(results) == pytest.approx(5, abs=0.1)
    assert results[-1]["t_end"] == pytest.approx(5)
    assert [r["t_end"] for r in results] == sorted(r["t_end"] for r in results)


def test_a_file_loses_nothing(new_session: NewSession) -> None:
    driver = new_session(eager=False)
    driver.send(start(method="norm_music", overflow="block"))
    driver.work()
    sent = 0
    for _ in range(40):
        if not driver.session.wants_audio:
            driver.work()
        driver.audio(SECOND[:16_000])
        sent += 16_000
    assert driver.session.buffered_s < 1.0
    driver.send({"type": "stop"})
    driver.work()
    summary = driver.only("summary")
    assert (summary["dropped_s"], summary["audio_s"]) == (0, pytest.approx(sent / 8 / RATE))
    assert summary["results"] == round(sent / 8 / RATE * 10)


def test_lost_messages_are_a_gap_and_results_carry_the_capture_time(
    new_session: NewSession,
) -> None:
    driver = new_session()
    driver.send(start(method="norm_music", audio={"header": "seq_time"}))
    base, frames = 1_700_000_000_000_000_000, 800
    for index in (0, 1, 2, 3, 8, 9):
        captured = base + index * 50_000_000
        driver.audio(stamped(index, captured, SECOND[: 8 * frames]), 10_000)
    gap = driver.only("warning")
    assert (gap["code"], gap["duration_ms"]) == ("audio_gap", 200)
    assert "4 messages" in gap["detail"]
    for result in driver.all("result"):
        assert result["capture_time_ns"] == pytest.approx(base + result["t_end"] * 1e9, abs=2e6)
    assert driver.all("result")[-1]["t_end"] == pytest.approx(0.5)


def test_sequence_numbers_wrap(new_session: NewSession) -> None:
    driver = new_session()
    driver.send(start(method="norm_music", audio={"header": "seq_time"}))
    for index, sequence in enumerate([2**32 - 2, 2**32 - 1, 0, 1]):
        driver.audio(stamped(sequence, index * 50_000_000, SECOND[:6400]), 10_000)
    assert not driver.all("warning")


@pytest.mark.parametrize("first", [-(2**63), 2**63 - 1 - 50_000_000])
def test_capture_times_stay_within_their_64_bits(new_session: NewSession, first: int) -> None:
    driver = new_session()
    driver.send(start(method="norm_music", audio={"header": "seq_time"}))
    for index in range(8):
        captured = min(first + index * 50_000_000, 2**63 - 1)
        driver.audio(stamped(index, captured, SECOND[:6400]), 10_000)
    times = [result["capture_time_ns"] for result in driver.all("result")]
    assert times
    assert all(-(2**63) <= time < 2**63 for time in times)


@pytest.mark.parametrize("value", [np.nan, np.inf, 3e38, 1e-40])
@pytest.mark.parametrize("method", ["neural", "norm_music", "srp_phat"])
def test_one_sample_that_is_none_does_not_deafen_a_stream(
    new_session: NewSession,
    square: MicrophoneArray,
    plane_waves: Any,
    value: float,
    method: str,
) -> None:
    speech = np.ascontiguousarray(plane_waves(square, [70.0], seconds=2.0).T, "<f4")
    speech[6000, 1] = value
    driver = new_session()
    driver.send(start(method=method, audio={"encoding": "pcm_f32le"}))
    for at in range(0, len(speech), 4000):
        driver.audio(speech[at : at + 4000].tobytes(), 70_000)
    last = driver.all("result")[-1]
    assert last["t_end"] == pytest.approx(2.0)
    assert abs(last["sources"][0]["azimuth_deg"] - 70) < 6


def test_a_long_gap_begins_anew_and_time_goes_on(
    new_session: NewSession, square: MicrophoneArray, plane_waves: Any
) -> None:
    speech: FloatArray = plane_waves(square, [70.0, 200.0], seconds=2.0)
    first, second = plane_waves(square, [70.0]), plane_waves(square, [200.0])
    assert speech.shape[1] == 2 * RATE
    driver = new_session()
    driver.send(start(audio={"header": "seq_time"}))
    driver.audio(stamped(0, 0, pcm(first[:, :8000])), 70_000)
    driver.audio(stamped(1, 500_000_000, pcm(first[:, 8000:16_000])), 70_000)
    driver.audio(stamped(9, 30_000_000_000, pcm(second[:, :8000])), 70_000)
    before, after = driver.all("result")[-6], driver.all("result")[-1]
    assert before["t_end"] == pytest.approx(1.0)
    assert after["t_end"] == pytest.approx(30.5)
    (source,) = after["sources"]
    assert abs(source["azimuth_deg"] - 200) < 6
    assert source["id"] > before["sources"][0]["id"]


@pytest.mark.parametrize("rate", [16_000, 44_100, 48_000])
def test_gaps_lose_no_time_at_any_rate(rate: int, new_session: NewSession) -> None:
    """The audio that the resampler holds at a gap is lost; its time is not."""
    piece = pcm(0.01 * np.random.default_rng(1).standard_normal((4, rate // 50)))
    driver = new_session()
    audio = {"header": "seq_time", "sample_rate": rate}
    driver.send(start(method="norm_music", audio=audio, overflow="block"))
    behind = []
    for index in range(8):  # half a second of sound, half a second of nothing
        for number in range(50 * index, 50 * index + 25):
            driver.audio(stamped(number, number * 20_000_000, piece), 50_000)
        last = driver.all("result")[-1]
        behind.append(index + 0.5 - last["t_end"])
        assert last["capture_time_ns"] / 1e9 == pytest.approx(last["t_end"], abs=1e-3)
    assert behind == pytest.approx([behind[0]] * 8, abs=0.011)  # results come every 100 ms
    assert max(behind) < 0.15


def test_an_idle_session_times_out_and_pings_keep_it(new_session: NewSession) -> None:
    driver = new_session(SessionLimits(idle_timeout_s=5))
    driver.send(CLASSICAL)
    for _ in range(4):
        driver.now += 4
        driver.send({"type": "ping", "id": 1})
        driver.session.tick(driver.now)
    assert driver.session.state == "running"
    driver.now += 6
    driver.session.tick(driver.now)
    assert (driver.last["code"], driver.last["close_code"]) == ("timeout", 4408)


def test_a_client_that_never_speaks_times_out(new_session: NewSession) -> None:
    driver = new_session(SessionLimits(idle_timeout_s=5))
    driver.session.tick(5.1)
    assert driver.last["close_code"] == 4408


def test_a_session_has_a_longest_duration(new_session: NewSession) -> None:
    driver = new_session(SessionLimits(max_session_s=10))
    driver.send(CLASSICAL)
    driver.now = 10.1
    driver.audio(SECOND[:800])
    driver.session.tick(driver.now)
    assert (driver.last["code"], driver.last["close_code"]) == ("session_limit", 4410)


def test_draining_answers_for_what_came_before(new_session: NewSession) -> None:
    driver = new_session(eager=False)
    driver.send(CLASSICAL)
    driver.work()
    driver.audio(SECOND[: 8 * 4000])
    driver.session.drain()
    driver.work()
    assert driver.all("result")[-1]["t_end"] == pytest.approx(0.25)
    summary, closing = driver.messages[-2:]
    assert summary["type"] == "summary"
    assert (closing["code"], closing["close_code"]) == ("draining", 1012)


@pytest.mark.parametrize("how", ["stop", "flush after it", "drain"])
def test_what_comes_after_a_stop_is_not_of_the_session(how: str, new_session: NewSession) -> None:
    driver = new_session(eager=False)
    driver.send(CLASSICAL)
    driver.work()
    driver.audio(SECOND[: 8 * 4000])
    if how == "drain":
        driver.session.drain()
    else:
        driver.send({"type": "stop"})
    if how == "flush after it":
        driver.send({"type": "flush"})
    while driver.session.state == "running":
        work = driver.session.take_work()
        assert work is not None
        driver.audio(SECOND)  # while the last steps are under way
        outcome = driver.host.perform(work)
        assert outcome is not None
        driver.session.work_done(outcome, driver.now)
    assert driver.only("summary")["audio_s"] == 0.25
    assert not driver.all("flushed")


def test_an_update_is_held_to_the_array(new_session: NewSession) -> None:
    driver = new_session()
    pair = [[0.0, 0.05, 0.0], [0.0, -0.05, 0.0]]
    driver.send(
        start(method="music", audio={"channels": 2}, array={"positions_m": pair, "name": None})
    )
    driver.audio(SECOND[:16_000])
    driver.send({"type": "update", "output": {"num_sources": 2}})
    assert driver.last["code"] == "too_many_sources"
    assert "2 microphones" in driver.last["detail"]
    assert driver.session.close_code == driver.last["close_code"]


def test_the_noise_of_another_array_is_not_used_and_the_client_is_told(
    new_session: NewSession, store: NoiseStore
) -> None:
    silence = 0.001 * np.random.default_rng(0).standard_normal((4, 4 * RATE))
    other = preset("respeaker-4mic-hat")
    store.put("rover", learn_noise([silence.astype(np.float32)], other, Stft()))
    driver = new_session()
    driver.send(start(method="norm_music", client="rover"))
    ready = driver.only("ready")
    assert ready["noise"] is None
    warning = driver.only("warning")
    assert warning["code"] == "noise_mismatch"
    assert warning["detail"].endswith("it is not used")


def test_control_messages_that_wait_are_bounded(new_session: NewSession) -> None:
    driver = new_session(eager=False)
    driver.send(CLASSICAL)
    for _ in range(1001):
        driver.send({"type": "update", "output": {"max_sources": 2}})
    assert driver.last["code"] == "message_invalid"
    assert "1000 control messages" in driver.last["detail"]


def test_ten_thousand_tiny_messages_are_ordinary_audio(new_session: NewSession) -> None:
    driver = new_session()
    driver.send(CLASSICAL)
    driver.audio(SECOND[:80_000], 8)
    assert len(driver.all("result")) == 6
    assert not driver.all("warning")


def test_a_failing_pipeline_is_an_internal_error_and_no_traceback_for_the_client(
    new_session: NewSession, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = new_session()
    driver.send(CLASSICAL)

    def fail(*_: Any, **__: Any) -> None:
        raise ZeroDivisionError("secret")

    monkeypatch.setattr(StreamPipeline, "step", fail)
    driver.audio(SECOND)
    assert (driver.last["code"], driver.last["close_code"]) == ("internal", 1011)
    assert "secret" not in driver.last["detail"]
    assert "ZeroDivisionError" in caplog.text


def test_stats_come_every_five_seconds_of_audio(new_session: NewSession) -> None:
    driver = new_session()
    driver.send(CLASSICAL)
    for _ in range(11):
        driver.audio(SECOND)
    assert [stats["audio_s"] for stats in driver.all("stats")] == pytest.approx([5, 10], abs=0.1)
    assert driver.messages[0]["type"] == "ready"


def test_faults_of_channels_are_warned_of_once(
    new_session: NewSession, square: MicrophoneArray, plane_waves: Any
) -> None:
    audio = plane_waves(square, [70.0], seconds=8.0)
    audio[2] = 0.0
    driver = new_session()
    driver.send(
        start(
            method="norm_music",
            audio={"encoding": "pcm_f32le", "channels": 6},
            channel_map=[1, 2, 3, 4],
        )
    )
    six = np.zeros((audio.shape[1], 6), "<f4")
    six[:, 1:5] = audio.T
    six[8000, 4] = np.nan
    driver.audio(six.tobytes(), 48_000)
    warnings = {warning["code"]: warning["channels"] for warning in driver.all("warning")}
    assert warnings == {"channel_dead": [3], "non_finite": [4]}
    assert len(driver.all("warning")) == 2
    assert len(driver.all("result")) == 80

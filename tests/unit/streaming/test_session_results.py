"""What a stream answers, against sounds whose directions are known by construction."""

from __future__ import annotations

import errno
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray
from service.inference.noise_store import NoiseStore
from service.streaming.session import JOB_BYTES
from service.streaming.work import Advance

from .conftest import Driver, NewSession, pcm, start

RATE = 16000


def results(driver: Driver) -> list[dict[str, Any]]:
    """The results without the fields that depend on time."""
    kept = ("t_start", "t_end", "sources", "why_no_source", "final", "spectrum")
    return [{key: r.get(key) for key in kept} for r in driver.all("result")]


def azimuths(result: dict[str, Any]) -> list[float]:
    return [source["azimuth_deg"] for source in result["sources"] if source["active"]]


def off(first: float, second: float) -> float:
    return abs((first - second + 180) % 360 - 180)


@pytest.fixture(scope="module")
def speech(square: MicrophoneArray, plane_waves: Any) -> FloatArray:
    """Two seconds from 70 degrees."""
    audio: FloatArray = plane_waves(square, [70.0], seconds=2.0)
    return audio


@pytest.mark.parametrize("method", ["neural", "norm_music", "music", "srp_phat"])
def test_every_method_finds_the_talker(
    method: str, new_session: NewSession, speech: FloatArray
) -> None:
    driver = new_session()
    driver.send(start(method=method))
    driver.audio(pcm(speech))
    found = driver.all("result")
    assert [round(1000 * result["t_end"]) for result in found] == list(range(100, 2001, 100))
    heard = [result for result in found if azimuths(result)]
    assert len(heard) > 12
    assert all(off(azimuth, 70) < 6 for result in heard for azimuth in azimuths(result))
    assert driver.only("ready")["method"] == method


def test_a_bound_model_streams_too(new_session: NewSession, speech: FloatArray) -> None:
    driver = new_session()
    driver.send(start(model="paper", output={"num_sources": 1, "interval_ms": 500}))
    driver.audio(pcm(speech))
    assert driver.only("ready")["model"]["variant"] == "regression"
    assert off(azimuths(driver.all("result")[-1])[0], 70) < 15


def test_no_more_talkers_are_reported_than_are_known_to_be_there(
    new_session: NewSession, square: MicrophoneArray, plane_waves: Any
) -> None:
    """The talkers take turns, so that both are tracked at the same time."""
    turns = [plane_waves(square, [a], seconds=0.8, seed=s) for s in range(3) for a in (70, 200)]
    audio = pcm(np.concatenate(turns, axis=1))
    most = []
    for output in ({}, {"num_sources": 1}):
        driver = new_session()
        driver.send(start(output=output))
        driver.audio(audio)
        heard = [len(result["sources"]) for result in driver.all("result")]
        assert sum(heard) > 30
        most.append(max(heard))
    assert most == [2, 1]


def test_a_stream_without_audio_has_no_lag(new_session: NewSession) -> None:
    driver = new_session()
    driver.now = 45_000.0
    driver.send(start())
    driver.send({"type": "stop"})
    assert driver.only("result")["lag_ms"] == 0
    assert driver.only("result")["why_no_source"] == "warming_up"


@settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    sizes=st.lists(st.integers(1, 4000), min_size=1, max_size=12),
    rate=st.sampled_from([16000, 48000]),
    eager=st.booleans(),
)
def test_any_split_of_the_same_audio_gives_the_same_results(
    new_session: NewSession, speech: FloatArray, sizes: list[int], rate: int, eager: bool
) -> None:
    data = pcm(speech[:, : rate // 2])
    options = start(audio={"sample_rate": rate}, overflow="block", output={"include": ["spectrum"]})
    whole, parts = new_session(), new_session(eager=eager)
    for driver in (whole, parts):
        driver.send(options)
        driver.work()
    whole.audio(data, 64_000)
    position, index = 0, 0
    while position < len(data):
        size = 8 * sizes[index % len(sizes)]
        parts.audio(data[position : position + size], size)
        position, index = position + size, index + 1
    for driver in (whole, parts):
        driver.send({"type": "stop"})
        driver.work()
    expected, found = results(whole), results(parts)
    assert len(expected) >= 5
    for first, second in zip(expected, found, strict=True):
        spectra = np.array(first.pop("spectrum")), np.array(second.pop("spectrum"))
        assert np.abs(spectra[0] - spectra[1]).max() < 2e-3
        assert first == second or _close(first, second)


def _close(first: dict[str, Any], second: dict[str, Any]) -> bool:
    """Equal up to the resampler's rounding."""
    if (first["t_end"], first["why_no_source"]) != (second["t_end"], second["why_no_source"]):
        return False
    pairs = zip(first["sources"], second["sources"], strict=True)
    return all(
        a["id"] == b["id"] and off(a["azimuth_deg"], b["azimuth_deg"]) < 0.1 for a, b in pairs
    )


@pytest.mark.parametrize("interval", [20, 50, 100, 330, 1000])
def test_results_come_every_interval(
    interval: int, new_session: NewSession, speech: FloatArray
) -> None:
    driver = new_session()
    driver.send(start(method="norm_music", output={"interval_ms": interval}))
    driver.audio(pcm(speech))
    times = [result["t_end"] for result in driver.all("result")]
    assert times == pytest.approx(np.arange(1, 2000 // interval + 1) * interval / 1000)


def test_a_talker_is_reported_within_150_ms_of_the_first_sound(
    new_session: NewSession, square: MicrophoneArray, plane_waves: Any
) -> None:
    """Onsets out of sensor noise, wherever they fall between two results; one may take longer."""
    latencies = []
    for trial in range(15):
        onset = 1.0 + 0.02 * (trial % 5)
        sound = 1e-4 * np.random.default_rng(3).standard_normal((4, 2 * RATE)).astype(np.float32)
        begin = round(onset * RATE)
        speech = plane_waves(square, [200.0], snr_db=60, seed=trial)[:, : 2 * RATE - begin]
        sound[:, begin : begin + speech.shape[1]] += speech
        driver = new_session()
        driver.send(start())
        driver.audio(pcm(sound), 640)
        heard = [result for result in driver.all("result") if result["sources"]]
        latencies.append(heard[0]["t_end"] - onset)
        assert off(heard[0]["sources"][0]["azimuth_deg"], 200) < 10
    latencies.sort()
    assert latencies[-2] <= 0.15 + 1e-9
    assert latencies[-1] <= 0.2 + 1e-9


def test_silence_and_sensor_noise_give_no_source(new_session: NewSession) -> None:
    driver = new_session()
    driver.send(start())
    driver.audio(bytes(2 * RATE * 8))
    driver.audio(pcm(0.003 * np.random.default_rng(0).standard_normal((4, 3 * RATE))))
    found = driver.all("result")
    assert len(found) == 50
    assert not any(result["sources"] for result in found)
    assert {result["why_no_source"] for result in found[:20]} == {"silence"}
    assert {result["why_no_source"] for result in found[30:]} <= {"no_direction", "unconfirmed"}


@pytest.mark.parametrize("rate", [RATE, 3 * RATE])
@pytest.mark.parametrize(
    ("encoding", "dtype", "scale"),
    [("pcm_s24le", "<i4", 2**31 - 1), ("pcm_s32le", "<i4", 2**31 - 1), ("pcm_f32le", "<f4", 1.0)],
)
def test_every_encoding_gives_what_16_bits_give(
    encoding: str,
    dtype: str,
    scale: float,
    rate: int,
    new_session: NewSession,
    square: MicrophoneArray,
    plane_waves: Any,
) -> None:
    first = plane_waves(square, [70.0], seconds=1.0, rate=rate)
    values = np.round(first.T.astype(np.float64) * scale) if dtype == "<i4" else first.T
    raw = np.ascontiguousarray(values.astype(dtype)).view(np.uint8).reshape(-1, 4)
    data = raw[:, 1:].tobytes() if encoding == "pcm_s24le" else raw.tobytes()
    drivers = []
    for each, payload in ((encoding, data), ("pcm_s16le", pcm(first))):
        driver = new_session()
        audio = {"encoding": each, "sample_rate": rate}
        driver.send(start(audio=audio, method="norm_music"))
        driver.audio(payload, 48_000)
        drivers.append(driver)
    ours, reference = (d.all("result")[-1]["sources"][0]["azimuth_deg"] for d in drivers)
    assert off(ours, reference) < 0.05


def test_the_raw_channels_of_a_six_channel_device(
    new_session: NewSession, speech: FloatArray
) -> None:
    six = np.zeros((6, RATE), np.float32)
    six[0], six[1:5] = speech[2, :RATE], speech[:, :RATE]
    assumed, mapped = new_session(), new_session()
    assumed.send(start(audio={"channels": 6}))
    mapped.send(start(audio={"channels": 6}, channel_map=[1, 2, 3, 4]))
    for driver in (assumed, mapped):
        driver.audio(pcm(six), 12_000)
        assert driver.only("ready")["channel_map"] == [1, 2, 3, 4]
        assert off(azimuths(driver.all("result")[-1])[0], 70) < 6
    assert assumed.only("warning")["code"] == "channel_map_assumed"
    assert not mapped.all("warning")


def test_yaw_turns_azimuths_vectors_and_spectra_and_sectors_are_the_robots(
    new_session: NewSession, speech: FloatArray
) -> None:
    turned, excluded = new_session(), new_session()
    turned.send(start(output={"yaw_deg": 30.0, "include": ["spectrum"]}))
    excluded.send(start(output={"yaw_deg": 30.0, "exclude_deg": [[90, 110]]}))
    for driver in (turned, excluded):
        driver.audio(pcm(speech))
    source = turned.all("result")[-1]["sources"][0]
    assert off(source["azimuth_deg"], 100) < 6
    angle = np.deg2rad(source["azimuth_deg"])
    assert source["unit_vector"] == pytest.approx([np.cos(angle), np.sin(angle), 0], abs=1e-4)
    assert source["elevation_deg"] is None
    assert off(float(np.argmax(turned.all("result")[-1]["spectrum"])), 100) < 6
    assert not any(result["sources"] for result in excluded.all("result"))
    assert excluded.all("result")[-1]["why_no_source"] == "excluded"


def test_an_update_counts_from_its_place_in_the_audio(
    new_session: NewSession, speech: FloatArray
) -> None:
    driver = new_session(eager=False)
    driver.send(start(overflow="block"))
    data = pcm(speech)
    driver.audio(data[: len(data) // 2])
    driver.send({"type": "update", "output": {"interval_ms": 500, "yaw_deg": -20.0}})
    driver.audio(data[len(data) // 2 :])
    driver.send({"type": "stop"})
    driver.work()
    found = driver.all("result")
    assert [result["t_end"] for result in found[8:]] == pytest.approx([0.9, 1.0, 1.5, 2.0])
    assert off(azimuths(found[9])[0], 70) < 6
    assert off(azimuths(found[-1])[0], 50) < 6


def test_flush_answers_for_what_is_buffered_and_stop_sums_up(
    new_session: NewSession, speech: FloatArray
) -> None:
    driver = new_session()
    driver.send(start())
    driver.audio(pcm(speech[:, : round(0.75 * RATE)]))
    driver.send({"type": "flush"})
    last, flushed = driver.messages[-2:]
    assert (last["type"], last["final"], last["t_end"]) == ("result", True, pytest.approx(0.75))
    assert flushed == {"type": "flushed", "seq": flushed["seq"], "t_end": pytest.approx(0.75)}
    driver.send({"type": "stop"})
    summary, closing = driver.messages[-2:]
    assert (summary["audio_s"], summary["results"]) == (pytest.approx(0.75), 8)
    assert off(summary["sources"][0]["azimuth_deg"], 70) < 6
    assert (closing["code"], closing["close_code"]) == ("done", 1000)


def test_odas_consumers_get_their_objects(new_session: NewSession, speech: FloatArray) -> None:
    driver = new_session()
    driver.send(start(output={"format": "odas"}))
    driver.audio(pcm(speech))
    assert not driver.all("result")
    ssl, sst = driver.all("ssl")[-1], driver.all("sst")[-1]
    assert ssl["timeStamp"] == sst["timeStamp"] == 250
    assert [set(each) for each in ssl["src"]] == [{"x", "y", "z", "E"}] * 4
    assert [each["id"] for each in sst["src"]] == [1, 0, 0, 0]
    talker = sst["src"][0]
    assert off(np.rad2deg(np.arctan2(talker["y"], talker["x"])), 70) < 6
    assert talker["activity"] > 0.5
    assert sst["src"][1] == {"id": 0, "tag": "", "x": 0.0, "y": 0.0, "z": 0.0, "activity": 0.0}


def test_the_noise_of_the_robot_is_learnt_kept_and_whitened_away(
    new_session: NewSession,
    store: NoiseStore,
    square: MicrophoneArray,
    plane_waves: Any,
) -> None:
    """A steady plane wave is the fan; a talker as loud comes from elsewhere."""
    rng = np.random.default_rng(5)
    samples = 6 * RATE
    spectrum = np.fft.rfft(rng.standard_normal(samples))
    towards = np.array([np.cos(np.deg2rad(30)), np.sin(np.deg2rad(30)), 0.0])
    omega = 2 * np.pi * np.fft.rfftfreq(samples, 1 / RATE)
    advance = square.positions @ towards / 343.0
    fan = np.fft.irfft(spectrum * np.exp(1j * omega * advance[:, None]), samples)
    fan = 0.02 * (fan + 0.1 * rng.standard_normal((4, samples)))
    talker = plane_waves(square, [120.0], seconds=2.0)
    talker *= 0.02 / talker.std()
    before = new_session()
    before.send(start(client="robot-1"))
    before.audio(pcm(fan[:, : RATE // 2] + talker[:, : RATE // 2]))
    before.send({"type": "calibrate", "kind": "noise", "seconds": 2})
    before.audio(pcm(fan[:, RATE : 4 * RATE]))
    calibrated = before.only("calibrated")
    assert (calibrated["name"], calibrated["seconds"]) == ("robot-1", pytest.approx(2, abs=0.2))
    assert store.get("robot-1").noise.array.matches(square)
    after = new_session()
    after.send(start(client="robot-1"))
    assert after.only("ready")["noise"]["name"] == "robot-1"
    for driver in (before, after):
        count = len(driver.all("result"))
        driver.audio(pcm(fan[:, 4 * RATE :] + talker))
        late = driver.all("result")[count + 8 :]
        found = [azimuth for result in late for azimuth in azimuths(result)]
        assert len(found) > 5
        assert all(off(azimuth, 120) < 10 for azimuth in found), found
    ignoring = new_session()
    ignoring.send(start(client="robot-1", noise="none"))
    assert ignoring.only("ready")["noise"] is None


@pytest.mark.parametrize(
    ("model", "noise", "words"), [("paper", 0.01, "paper"), ("default", 0.0, "silent")]
)
def test_a_calibration_that_cannot_be_is_a_warning_and_the_stream_goes_on(
    model: str, noise: float, words: str, new_session: NewSession, store: NoiseStore
) -> None:
    audio = noise * np.random.default_rng(0).standard_normal((4, 2 * RATE))
    driver = new_session()
    driver.send(start(model=model, client="robot", output={"interval_ms": 500}))
    driver.send({"type": "calibrate", "kind": "noise", "seconds": 1})
    driver.audio(pcm(audio))
    warning = driver.only("warning")
    assert warning["code"] == "calibration_failed"
    assert words in warning["detail"]
    assert [result["t_end"] for result in driver.all("result")] == pytest.approx([0.5, 1, 1.5, 2])
    assert not store.all()


def test_noise_that_cannot_be_stored_is_used_and_no_path_is_told(
    new_session: NewSession, store: NoiseStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuses = OSError(errno.EROFS, "Read-only file system", "/operators/folder")
    monkeypatch.setattr(store, "put", Mock(side_effect=refuses))
    driver = new_session()
    driver.send(start(client="robot", output={"interval_ms": 500}))
    driver.send({"type": "calibrate", "kind": "noise", "seconds": 1})
    driver.audio(pcm(0.01 * np.random.default_rng(0).standard_normal((4, 2 * RATE))))
    assert driver.only("warning")["detail"].endswith("was not stored: Read-only file system")
    assert driver.only("calibrated")["name"] is None


def test_a_second_of_much_audio_is_worked_off_in_pieces(new_session: NewSession) -> None:
    """100 MB at once would hold up the worker's other streams, and whoever hands them over."""
    driver = new_session(eager=False)
    audio = {"encoding": "pcm_f32le", "sample_rate": 384_000, "channels": 64}
    driver.send(
        start(method="music", audio=audio, channel_map=[0, 1, 2, 3], output={"interval_ms": 1000})
    )
    driver.work()
    assert driver.last["type"] == "ready"
    sizes = []
    for _ in range(410):
        driver.session.receive_bytes(bytes(960 * 256), 0.0)
        while (work := driver.session.take_work()) is not None:
            assert isinstance(work, Advance)
            sizes.append(sum(len(piece.data) for piece in work.pieces))
            driver.session.work_done(driver.perform(work), 0.0)
    assert len(driver.all("result")) == 1
    assert 100_000 < max(sizes) <= JOB_BYTES

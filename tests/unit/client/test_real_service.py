"""The stream client and the service itself, which know each other only by the protocol."""

from __future__ import annotations

import asyncio
from typing import Any

import numpy as np
import pytest
from running_service import RunningService
from scripted_service import TIMEOUT_S

from neuralmusic import (
    AsyncStreamClient,
    Backoff,
    LocalizationClient,
    Reconnecting,
    StreamClient,
    StreamRefused,
)
from neuralmusic.protocol.server_messages import (
    Calibrated,
    Closing,
    Flushed,
    OdasSsl,
    OdasSst,
    Pong,
    Ready,
    Result,
)
from service.doa.array import MicrophoneArray

RATE = 16_000


def options(square: MicrophoneArray, **changes: Any) -> dict[str, Any]:
    audio = {"encoding": "pcm_f32le", "sample_rate": RATE, "channels": square.num_microphones}
    asked = {"audio": audio, "array": square.name, "method": "norm_music", "overflow": "block"}
    return {**asked, **changes}


@pytest.fixture
def talk(square: MicrophoneArray, plane_waves: Any) -> np.ndarray[Any, Any]:
    """(T, N) three seconds from 60 degrees."""
    return plane_waves(square, [60], seconds=3.0).T


def azimuths(events: list[Any]) -> list[float]:
    return [s.azimuth_deg for e in events if isinstance(e, Result) for s in e.sources if s.active]


@pytest.mark.parametrize("encoding", ["pcm_s16le", "pcm_s32le", "pcm_f32le"])
def test_every_array_type_is_localized(
    real_service: str, square: MicrophoneArray, talk: Any, encoding: str
) -> None:
    scale = {"pcm_s16le": 2**15, "pcm_s32le": 2**31, "pcm_f32le": 1}[encoding]
    kind = {"pcm_s16le": np.int16, "pcm_s32le": np.int32, "pcm_f32le": np.float32}[encoding]
    asked = options(square)
    asked["audio"] |= {"encoding": encoding, "header": "seq_time"}
    with StreamClient(real_service, **asked) as stream:
        stream.send((talk * scale).astype(kind), capture_time_ns=10**18)
        summary = stream.stop(TIMEOUT_S)
        events = list(stream)
    assert summary.audio_s == pytest.approx(3.0)
    assert summary.gap_s == summary.dropped_s == 0
    assert np.median(azimuths(events)) == pytest.approx(60, abs=3)
    last = [event for event in events if isinstance(event, Result)][-1]
    assert last.capture_time_ns == pytest.approx(10**18 + last.t_end * 1e9, abs=2e6)


def test_everything_that_a_session_may_be_asked(
    real_service: str, square: MicrophoneArray, talk: Any
) -> None:
    async def session() -> list[Any]:
        events: list[Any] = []
        asked = options(square, output={"interval_ms": 200})
        async with AsyncStreamClient(real_service, **asked) as stream:

            async def until(kind: type) -> None:
                while not (events and isinstance(events[-1], kind)):
                    event = await stream.receive(TIMEOUT_S)
                    assert event is not None
                    events.append(event)

            await stream.send(talk)
            stream.flush()
            await until(Flushed)
            stream.ping(5)
            await until(Pong)
            stream.update(yaw_deg=100.0, exclude_deg=[(300, 310)])
            await stream.send(talk)
            stream.flush()
            await until(Flushed)
            stream.calibrate(1.0)
            noise = np.random.default_rng(3).standard_normal(talk.shape).astype(np.float32)
            await stream.send(1e-3 * noise)
            await until(Calibrated)
            assert events[-1].seconds >= 1.0
            await stream.stop(TIMEOUT_S)
            return events + stream.received()

    events = asyncio.run(session())
    flushes = [index for index, event in enumerate(events) if isinstance(event, Flushed)]
    assert isinstance(events[0], Ready)
    assert np.median(azimuths(events[: flushes[0]])) == pytest.approx(60, abs=3)
    assert azimuths(events[: flushes[1]])[-1] == pytest.approx(160, abs=3)
    assert isinstance(events[-1], Closing)
    assert events[-1].code == "done"


def test_odas_objects_come_in_the_place_of_results(
    real_service: str, square: MicrophoneArray, talk: Any
) -> None:
    with StreamClient(real_service, **options(square, output={"format": "odas"})) as stream:
        stream.send(talk)
        stream.stop(TIMEOUT_S)
        events = list(stream)
    tracks = [event for event in events if isinstance(event, OdasSst)]
    assert any(isinstance(event, OdasSsl) for event in events)
    assert not any(isinstance(event, Result) for event in events)
    assert all(len(track.src) == 4 for track in tracks)
    assert tracks[-1].src[0].x == pytest.approx(0.5, abs=0.05)


def test_a_running_stream_is_listed(real_service: str, square: MicrophoneArray, talk: Any) -> None:
    with StreamClient(real_service, **options(square)) as stream:
        with LocalizationClient(real_service) as client:
            running = client.sessions()
        assert stream.ready.session in [listed["id"] for listed in running]
        stream.stop(TIMEOUT_S)


def test_the_service_s_refusal_is_its_own_sentence(
    real_service: str, square: MicrophoneArray
) -> None:
    with pytest.raises(StreamRefused, match="no array preset is called 'round'") as caught:
        StreamClient(real_service, **options(square, array="round")).open()
    assert (caught.value.code, caught.value.close_code) == ("array_unknown", 4400)


@pytest.mark.processes
def test_a_robot_survives_a_restart_of_the_service(square: MicrophoneArray, talk: Any) -> None:
    first = RunningService()
    asked = options(square, overflow="drop_oldest", backoff=Backoff(0.05, 0.2))
    with StreamClient(first.url, **asked) as stream:
        stream.send(talk[:8000])
        events: list[Any] = []

        def until(kind: type) -> Any:
            while not (events and isinstance(events[-1], kind)):
                event = stream.receive(TIMEOUT_S)
                assert event is not None
                events.append(event)
            return events[-1]

        before = until(Result)
        assert isinstance(events[0], Ready)
        first.stop()
        gone = until(Reconnecting)
        assert "shutting down" in gone.reason
        second = RunningService(first.port)
        after = until(Ready)
        stream.send(talk[:8000])
        stream.stop(TIMEOUT_S)
        events.extend(stream)
    second.stop()
    assert after.session != events[0].session
    assert isinstance(before, Result)
    assert any(isinstance(event, Result) for event in events[events.index(after) :])

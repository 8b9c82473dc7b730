"""Streams against a scripted service: what is sent, what is read, and what survives an outage."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scripted_service import TIMEOUT_S, Peer, ScriptedService, error, result

from service.client import (
    AsyncStreamClient,
    Backoff,
    Reconnecting,
    ServiceUnreachable,
    StreamClient,
    StreamClosed,
    StreamRefused,
)
from service.errors import InvalidMessage, InvalidOption
from service.protocol.client_messages import Start
from service.protocol.close_codes import RETRYABLE
from service.protocol.framing import HEADER, FrameHeader
from service.protocol.server_messages import Closing, Flushed, Pong, Ready, Result

ServiceOf = Callable[..., ScriptedService]
AT_ONCE = Backoff(first_s=0.0, longest_s=0.0)


def options(**changes: Any) -> dict[str, Any]:
    audio = {"encoding": "pcm_s16le", "sample_rate": 16_000, "channels": 2}
    return {"audio": audio, "array": "square", "backoff": AT_ONCE, **changes}


def samples(count: int) -> np.ndarray[Any, np.dtype[np.int16]]:
    return np.random.default_rng(count).integers(-9000, 9000, (count, 2), np.int16)


def whole_session(peer: Peer) -> None:
    """One result for every message, as long as the client sends."""
    peer.begin()
    seq = 0
    while isinstance(message := peer.hear(), bytes):
        seq += 1
        peer.say(result(seq, 30.0 * seq))
    assert message == {"type": "stop"}
    peer.finish()


def say_no(code: str, close_code: int) -> Callable[[Peer], None]:
    def script(peer: Peer) -> None:
        peer.control()
        peer.say(error(code, close_code, retryable=close_code in RETRYABLE))
        peer.close(close_code)

    return script


def test_a_session_from_start_to_summary(service_of: ServiceOf) -> None:
    heard: list[bytes] = []

    def script(peer: Peer) -> None:
        peer.begin()
        heard.extend(peer.audio_until("flush"))
        peer.say(result(1, 45.0), Flushed(seq=2, t_end=0.1))
        assert peer.control() == {"type": "ping", "id": 7}
        peer.say(Pong(seq=3, id=7))
        assert peer.control() == {"type": "calibrate", "kind": "noise", "seconds": 3.0}
        assert peer.control() == {"type": "stop"}
        peer.finish(audio_s=0.1)

    service, audio = service_of(script), samples(1600)
    asked = options(token="secret", output={"interval_ms": 50}, client="r2")
    with StreamClient(service.url, **asked) as stream:
        assert stream.ready.session == "one"
        stream.send(audio)
        stream.flush()
        stream.ping(7)
        stream.calibrate(3)
        assert stream.stop(TIMEOUT_S).audio_s == 0.1
        kinds = [event.type for event in stream]
        assert stream.ended
        assert stream.latest is not None
        assert stream.latest.sources[0].azimuth_deg == 45.0
    assert kinds == ["ready", "result", "flushed", "pong", "summary", "closing"]
    assert b"".join(heard) == audio.tobytes()
    peer = service.peers[0]
    assert peer.start == {
        "type": "start",
        "audio": asked["audio"],
        "array": {"name": "square"},
        "output": {"interval_ms": 50},
        "client": "r2",
    }
    assert peer.request.path == "/stream"
    assert peer.request.headers["Authorization"] == "Bearer secret"
    assert peer.request.headers["Sec-WebSocket-Protocol"] == "doa.v1"
    assert "Sec-WebSocket-Extensions" not in peer.request.headers


def test_the_same_with_asyncio(service_of: ServiceOf) -> None:
    service = service_of(whole_session)

    async def session() -> list[Any]:
        async with AsyncStreamClient(service.url, **options()) as stream:
            for _ in range(3):
                await stream.send(samples(320))
            await stream.stop(TIMEOUT_S)
            return [event async for event in stream]

    events = asyncio.run(session())
    found = [e.sources[0].azimuth_deg for e in events if isinstance(e, Result)]
    assert found == [30.0, 60.0, 90.0]


def test_start_is_given_as_itself_or_by_its_fields() -> None:
    start = Start.model_validate_json(
        '{"type": "start", "array": {"name": "square"}, '
        '"audio": {"encoding": "pcm_f32le", "sample_rate": 48000, "channels": 4}}'
    )
    StreamClient("ws://robot/stream", start)
    geometry = {"positions_m": np.eye(3)}
    StreamClient("robot:8000", **options(array=geometry, output=start.output))
    with pytest.raises(InvalidOption, match="not both"):
        StreamClient("robot", start, array="square")
    with pytest.raises(InvalidMessage, match=r"audio.*sample_rate is missing"):
        StreamClient("robot", array="square", audio={"encoding": "pcm_s16le", "channels": 2})
    with pytest.raises(InvalidMessage, match="overfow is no field"):
        StreamClient("robot", **options(overfow="block"))


def test_a_stream_that_is_not_open_says_so() -> None:
    stream = StreamClient("http://robot", **options())
    for use in (lambda: stream.ready, lambda: stream.send(b""), stream.stop, stream.received):
        with pytest.raises(InvalidOption, match="not open yet"):
            use()


def test_sequence_and_capture_time_are_those_of_the_pieces(service_of: ServiceOf) -> None:
    heard: list[bytes] = []

    def script(peer: Peer) -> None:
        peer.begin()
        heard.extend(peer.audio_until("stop"))
        peer.finish()

    audio = options()["audio"] | {"header": "seq_time"}
    with StreamClient(service_of(script).url, **options(audio=audio)) as stream:
        stream.send(samples(4000), capture_time_ns=5_000_000_000)
        stream.send(samples(160))
        stream.stop(TIMEOUT_S)
    headers = [FrameHeader.unpack(message) for message in heard]
    assert [header.sequence for header in headers] == [0, 1, 2, 3]
    assert [h.capture_time_ns for h in headers[:3]] == [5_000_000_000 + i * 10**8 for i in range(3)]
    assert b"".join(message[HEADER.size :] for message in heard[:3]) == samples(4000).tobytes()


def test_unknown_messages_are_skipped_and_unknown_fields_ignored(service_of: ServiceOf) -> None:
    def script(peer: Peer) -> None:
        peer.begin()
        peer.say('{"type": "weather", "seq": 1}', '{"type": "result", "seq": 2}', "{")
        peer.say('{"type": "pong", "seq": 3, "id": 1, "mood": "good"}')
        peer.audio_until("stop")
        peer.finish()

    with StreamClient(service_of(script).url, **options()) as stream:
        assert isinstance(stream.receive(TIMEOUT_S), Ready)
        assert stream.receive(TIMEOUT_S) == Pong(seq=3, id=1)
        stream.stop(TIMEOUT_S)


@pytest.mark.parametrize("code", [1001, 1011, 1012, 1013, "crash"])
def test_a_lost_session_is_followed_by_another(service_of: ServiceOf, code: int | str) -> None:
    def lost(peer: Peer) -> None:
        peer.begin("first")
        assert len(peer.audio_until("update")) == 1
        if code == "crash":
            peer.vanish()
        else:
            peer.say(Closing(seq=1, code="draining", detail="back soon", close_code=code))
            peer.close(code)

    def again(peer: Peer) -> None:
        peer.begin("second")
        peer.audio_until("stop")
        peer.finish()

    service = service_of(lost, again)
    asked = options(output={"interval_ms": 50, "max_sources": 2})
    with StreamClient(service.url, **asked) as stream:
        stream.send(samples(160))
        stream.update(interval_ms=200, exclude_deg=[[-10, 20]])
        events = []
        while not (isinstance(event := stream.receive(TIMEOUT_S), Ready) and events):
            assert event is not None
            events.append(event)
        stream.stop(TIMEOUT_S)
    gone = next(event for event in events if isinstance(event, Reconnecting))
    assert (gone.attempt, gone.delay_s) == (0, 0.0)
    assert ("lost" if code == "crash" else "back soon") in gone.reason
    assert event.session == stream.ready.session == "second"
    # The other session has the options that were in effect.
    assert service.peers[0].start["output"] == {"interval_ms": 50, "max_sources": 2}
    assert service.peers[1].start["output"] == {
        "interval_ms": 200,
        "max_sources": 2,
        "exclude_deg": [[-10.0, 20.0]],
    }


def test_audio_of_an_outage_is_dropped_not_sent_late(service_of: ServiceOf) -> None:
    heard: list[bytes] = []
    outage, over = threading.Event(), threading.Event()

    def lost(peer: Peer) -> None:
        peer.begin()
        peer.close(1012)

    def count(peer: Peer) -> None:
        outage.set()
        assert over.wait(TIMEOUT_S)
        peer.begin()
        heard.extend(peer.audio_until("stop"))
        peer.finish()

    with StreamClient(service_of(lost, count).url, **options()) as stream:
        assert outage.wait(TIMEOUT_S)
        stream.send(samples(800))
        assert stream.dropped_s == pytest.approx(0.05)
        over.set()
        while not stream.connected:
            stream.receive(TIMEOUT_S)
        stream.send(samples(160))
        stream.stop(TIMEOUT_S)
    assert b"".join(heard) == samples(160).tobytes()
    assert stream.dropped_s == pytest.approx(0.05)


@pytest.mark.parametrize("code", [4400, 4408, 4410, 4429, 1003, 1008, 1009])
def test_what_would_fail_again_is_not_tried_again(service_of: ServiceOf, code: int) -> None:
    def script(peer: Peer) -> None:
        peer.begin()
        peer.say(result(1, 10.0), error("wrong", code))
        peer.close(code)

    service = service_of(script)
    with StreamClient(service.url, **options()) as stream:
        seen = []
        with pytest.raises(StreamClosed, match="because of wrong") as caught:
            seen.extend(event for event in iter(stream.receive, None))
        assert (caught.value.code, caught.value.close_code) == ("wrong", code)
        assert not caught.value.retryable
        with pytest.raises(StreamClosed, match="because of wrong"):
            stream.send(samples(160))
        with pytest.raises(StreamClosed, match="because of wrong"):
            stream.stop()
    assert len(service.peers) == 1


def test_reconnecting_can_be_turned_off_and_is_off_for_files(service_of: ServiceOf) -> None:
    def script(peer: Peer) -> None:
        peer.begin()
        peer.close(1012)

    for asked in ({"reconnect": False}, {"overflow": "block"}):
        service = service_of(script)
        with (
            StreamClient(service.url, **options(**asked)) as stream,
            pytest.raises(StreamClosed, match="code 1012") as caught,
        ):
            list(stream)
        assert caught.value.retryable
        assert len(service.peers) == 1


def test_a_refusal_after_an_outage_ends_the_stream(service_of: ServiceOf) -> None:
    def lost(peer: Peer) -> None:
        peer.begin()
        peer.vanish()

    service = service_of(lost, say_no("array_unknown", 4400))
    with (
        StreamClient(service.url, **options()) as stream,
        pytest.raises(StreamRefused, match="because of array_unknown"),
    ):
        list(stream)


def test_a_refused_start_is_a_sentence(service_of: ServiceOf) -> None:
    service = service_of(say_no("array_unknown", 4400))
    with pytest.raises(StreamRefused, match="because of array_unknown") as caught:
        StreamClient(service.url, **options(wait_s=TIMEOUT_S)).open()
    assert (caught.value.code, caught.value.close_code) == ("array_unknown", 4400)
    assert len(service.peers) == 1


def test_a_refused_handshake_is_the_problem_of_the_service(service_of: ServiceOf) -> None:
    problem = {"code": "unauthorized", "title": "No key", "detail": "give a key", "status": 401}
    service = service_of(whole_session, refusals=[(401, problem, {})])
    with pytest.raises(StreamRefused, match="give a key") as caught:
        StreamClient(service.url, **options(wait_s=TIMEOUT_S)).open()
    assert (caught.value.status, caught.value.code, caught.value.retryable) == (
        401,
        "unauthorized",
        False,
    )


def test_a_full_service_is_tried_again_when_it_says(service_of: ServiceOf) -> None:
    full = {"code": "overloaded", "title": "Overloaded", "detail": "full", "status": 503}
    later = (503, full, {"Retry-After": "3600"})
    with pytest.raises(StreamRefused, match="full") as caught:
        StreamClient(service_of(whole_session, refusals=[later]).url, **options(wait_s=60)).open()
    assert caught.value.retry_after_s == 3600
    soon = (503, full, {"Retry-After": "0"})
    service = service_of(whole_session, refusals=[soon, (502, {}, {}), soon])
    with StreamClient(service.url, **options(wait_s=TIMEOUT_S)) as stream:
        assert stream.stop(TIMEOUT_S).audio_s == 1.0


def test_nobody_there_is_a_sentence(unused_tcp_port: int) -> None:
    url = f"http://127.0.0.1:{unused_tcp_port}"
    with pytest.raises(ServiceUnreachable, match=r"nothing answers at ws://127.*neuralmusic serve"):
        StreamClient(url, **options()).open()


def test_a_server_of_another_kind_is_refused(service_of: ServiceOf) -> None:
    problem = (404, {"hello": "world"}, {})
    with pytest.raises(StreamRefused, match="HTTP status 404"):
        StreamClient(service_of(whole_session, refusals=[problem]).url, **options()).open()


def test_a_file_loses_nothing_where_the_service_is_slow(service_of: ServiceOf) -> None:
    heard: list[bytes] = []
    seconds = 40  # more than the operating system's buffers hold

    def script(peer: Peer) -> None:
        peer.begin()
        heard.extend(peer.audio_until("stop"))
        peer.finish()

    audio = {"encoding": "pcm_f32le", "sample_rate": 48_000, "channels": 4}
    block = np.ones((48_000, 4), np.float32)
    asked = options(audio=audio, overflow="block", queue_s=0.2)
    with StreamClient(service_of(script).url, **asked) as stream:
        for index in range(seconds):
            stream.send(block * index)
        stream.stop(TIMEOUT_S)
        assert stream.dropped_s == 0
    got = np.frombuffer(b"".join(heard), np.float32).reshape(seconds, -1)
    assert (got == np.arange(seconds)[:, None]).all()


def test_a_live_stream_drops_the_oldest_where_the_service_does_not_read(
    service_of: ServiceOf,
) -> None:
    heard: list[bytes] = []
    sent = threading.Event()
    seconds = 60

    def script(peer: Peer) -> None:
        peer.begin()
        assert sent.wait(TIMEOUT_S)
        heard.extend(peer.audio_until("stop"))
        peer.finish()

    audio = {"encoding": "pcm_f32le", "sample_rate": 48_000, "channels": 4, "header": "seq_time"}
    with StreamClient(service_of(script).url, **options(audio=audio)) as stream:
        for index in range(seconds * 20):
            stream.send(np.full((2400, 4), index, np.float32))
        sent.set()
        stream.stop(TIMEOUT_S)
        dropped = stream.dropped_s
    assert dropped > 0
    assert len(heard) / 20 + dropped == pytest.approx(seconds)
    sequences = [FrameHeader.unpack(message).sequence for message in heard]
    assert sequences == [int(np.frombuffer(m[HEADER.size :], np.float32)[0]) for m in heard]
    assert sequences == sorted(set(sequences))
    assert sequences[-1] == seconds * 20 - 1


def test_unread_results_are_bounded_and_the_newest_are_kept(service_of: ServiceOf) -> None:
    def script(peer: Peer) -> None:
        peer.begin()
        peer.say(*(result(seq) for seq in range(1, 101)))
        peer.audio_until("stop")
        peer.finish()

    with StreamClient(service_of(script).url, **options(max_unread=8)) as stream:
        stream.stop(TIMEOUT_S)
        events = list(stream)
    assert len(events) == 8
    assert stream.results_dropped == 100 - (8 - 3)
    assert [e.seq for e in events if isinstance(e, Result)] == [96, 97, 98, 99, 100]


def test_a_stopped_stream_takes_no_more_audio(service_of: ServiceOf) -> None:
    with StreamClient(service_of(whole_session).url, **options()) as stream:
        stream.stop(TIMEOUT_S)
        with pytest.raises(StreamClosed):
            stream.send(samples(160))
    stream.close()


def test_a_service_that_never_answers_stop_is_given_up(service_of: ServiceOf) -> None:
    done = threading.Event()

    def script(peer: Peer) -> None:
        peer.begin()
        peer.audio_until("stop")
        assert done.wait(TIMEOUT_S)

    with StreamClient(service_of(script).url, **options()) as stream:
        with pytest.raises(ServiceUnreachable, match="did not answer `stop`"):
            stream.stop(timeout_s=0.05)
        done.set()

"""Streams against a scripted service: what is sent, what is read, and what is dropped."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scripted_service import (
    TIMEOUT_S,
    Peer,
    ScriptedService,
    options,
    result,
    samples,
    whole_session,
)

from neuralmusic import (
    AsyncStreamClient,
    ServiceUnreachable,
    StreamClient,
    StreamClosed,
)
from neuralmusic.errors import InvalidMessage, InvalidOption
from neuralmusic.protocol.client_messages import Start
from neuralmusic.protocol.framing import HEADER, FrameHeader
from neuralmusic.protocol.server_messages import Flushed, Pong, Ready, Result

ServiceOf = Callable[..., ScriptedService]


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
    asked = options(key="secret", output={"interval_ms": 50}, client="r2")
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
    with pytest.raises(TypeError, match="overfow"):
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


def test_a_reader_in_another_thread_ends_with_the_stream(service_of: ServiceOf) -> None:
    """Whatever it does when the stream is closed."""

    def script(peer: Peer) -> None:
        peer.begin()
        for number in range(1, 200):
            peer.say(result(number, 45.0))
        peer.control()

    for _ in range(10):
        stream, read = StreamClient(service_of(script).url, **options()).open(), list[Any]()
        reader = threading.Thread(target=lambda s=stream, r=read: r.extend(s), daemon=True)
        reader.start()
        while stream.latest is None:
            threading.Event().wait(0.001)
        stream.close()
        reader.join(TIMEOUT_S)
        assert not reader.is_alive()
        assert isinstance(read[0], Ready)


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

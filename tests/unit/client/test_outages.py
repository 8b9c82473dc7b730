"""Streams that are refused or lost: what is tried again, and what becomes a sentence."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest
from scripted_service import (
    TIMEOUT_S,
    Peer,
    ScriptedService,
    error,
    options,
    result,
    samples,
    whole_session,
)

from neuralmusic import (
    Reconnecting,
    ServiceUnreachable,
    StreamClient,
    StreamClosed,
    StreamRefused,
)
from neuralmusic.protocol.close_codes import RETRYABLE
from neuralmusic.protocol.server_messages import Closing, Ready

ServiceOf = Callable[..., ScriptedService]


def say_no(code: str, close_code: int) -> Callable[[Peer], None]:
    def script(peer: Peer) -> None:
        peer.control()
        peer.say(error(code, close_code, retryable=close_code in RETRYABLE))
        peer.close(close_code)

    return script


@pytest.mark.parametrize("code", [1001, 1011, 1012, 1013, 4408, 4410, "crash"])
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


@pytest.mark.parametrize("code", [4400, 4429, 1003, 1008, 1009])
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


@pytest.mark.parametrize("status", [429, 503])
def test_a_full_service_is_tried_again_when_it_says(service_of: ServiceOf, status: int) -> None:
    full = {"code": "overloaded", "title": "Overloaded", "detail": "full", "status": status}
    later = (status, full, {"Retry-After": "3600"})
    with pytest.raises(StreamRefused, match="full") as caught:
        StreamClient(service_of(whole_session, refusals=[later]).url, **options(wait_s=60)).open()
    assert caught.value.retry_after_s == 3600
    soon = (status, full, {"Retry-After": "0"})
    service = service_of(whole_session, refusals=[soon, (502, {}, {}), soon])
    with StreamClient(service.url, **options(wait_s=TIMEOUT_S)) as stream:
        assert stream.stop(TIMEOUT_S).audio_s == 1.0


def test_nobody_there_is_a_sentence(unused_tcp_port: int) -> None:
    url = f"http://127.0.0.1:{unused_tcp_port}"
    with pytest.raises(ServiceUnreachable, match=r"at ws://127.*\(connection refused\).*serve"):
        StreamClient(url, **options()).open()


def test_a_server_of_another_kind_is_refused(service_of: ServiceOf) -> None:
    problem = (404, {"hello": "world"}, {})
    with pytest.raises(StreamRefused, match="HTTP status 404"):
        StreamClient(service_of(whole_session, refusals=[problem]).url, **options()).open()

"""A service whose machine vanishes: nothing is closed, and nothing answers."""

from __future__ import annotations

import socket
import threading

import pytest
from scripted_service import TIMEOUT_S, ready, samples
from websockets.http11 import Request
from websockets.server import ServerProtocol

from neuralmusic import StreamClient, StreamClosed, Timeouts
from neuralmusic.protocol import SUBPROTOCOL


def begin_and_fall_silent(listener: socket.socket, over: threading.Event) -> None:
    """A handshake, ``ready``, and then not even pongs."""
    peer, _ = listener.accept()
    with peer:
        protocol = ServerProtocol(subprotocols=[SUBPROTOCOL])
        events: list[object] = []
        while not any(isinstance(event, Request) for event in events):
            protocol.receive_data(peer.recv(65_536))
            events = protocol.events_received()
        protocol.send_response(protocol.accept(events[0]))
        protocol.send_text(ready().model_dump_json().encode())
        for data in protocol.data_to_send():
            peer.sendall(data)
        over.wait(TIMEOUT_S)


def test_a_vanished_service_is_noticed() -> None:
    over = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=begin_and_fall_silent, args=(listener, over))
        thread.start()
        stream = StreamClient(
            f"http://127.0.0.1:{listener.getsockname()[1]}",
            array="square",
            audio={"encoding": "pcm_s16le", "sample_rate": 16_000, "channels": 2},
            reconnect=False,
            timeouts=Timeouts(close_s=0.05, ping_interval_s=0.02, ping_timeout_s=0.02),
        )
        with stream, pytest.raises(StreamClosed, match="was lost") as caught:
            list(stream)
        over.set()
        thread.join()
    assert (caught.value.close_code, caught.value.retryable) == (1006, True)


def send_until_it_ends(stream: StreamClient) -> None:
    while not stream.ended:
        stream.send(samples(1600))
        stream.received()


def test_a_service_that_takes_nothing_more_is_noticed_without_pings() -> None:
    """What waits for the network holds pings back, too."""
    over = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        thread = threading.Thread(target=begin_and_fall_silent, args=(listener, over))
        thread.start()
        stream = StreamClient(
            f"http://127.0.0.1:{listener.getsockname()[1]}",
            array="square",
            audio={"encoding": "pcm_s16le", "sample_rate": 16_000, "channels": 2},
            reconnect=False,
            timeouts=Timeouts(close_s=0.05, ping_interval_s=TIMEOUT_S, ping_timeout_s=0.1),
        )
        with stream, pytest.raises(StreamClosed, match="was lost") as caught:
            send_until_it_ends(stream)
        assert thread.is_alive(), "the service itself closed the connection"
        over.set()
        thread.join()
    assert (caught.value.close_code, caught.value.retryable) == (1006, True)

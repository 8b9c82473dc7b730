"""A scripted service: what it says and when is the test's, so nothing has to be waited out."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import Server, ServerConnection, serve

from neuralmusic import Backoff
from neuralmusic.protocol import SUBPROTOCOL
from neuralmusic.protocol.server_messages import (
    Closing,
    Limits,
    Ready,
    Result,
    ServerMessage,
    StreamArray,
    StreamError,
    StreamSource,
    Summary,
    Timing,
)

AT_ONCE = Backoff(first_s=0.0, longest_s=0.0)
TIMEOUT_S = 20.0
"""Seconds after which a test that hangs fails"""


def ready(session: str = "one") -> Ready:
    return Ready(
        seq=0,
        session=session,
        model=None,
        method="norm_music",
        array=StreamArray(name="square", positions_m=[[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]),
        channel_map=[0, 1],
        convention="counter-clockwise from +x",
        timing=Timing(
            interval_ms=100, window_ms=500.0, algorithmic_latency_ms=66.0, sample_rate=16_000
        ),
        limits=Limits(
            max_message_bytes=65_536, buffer_ms=1000, idle_timeout_s=30.0, max_session_s=3600.0
        ),
    )


def result(seq: int, *azimuths_deg: float, active: bool = True) -> Result:
    sources = [
        StreamSource(
            id=index + 1,
            azimuth_deg=azimuth,
            unit_vector=[1.0, 0.0, 0.0],
            confidence=0.9 - 0.1 * index,
            active=active,
            velocity_deg_s=0.0,
            std_deg=1.5,
        )
        for index, azimuth in enumerate(azimuths_deg)
    ]
    why = None if sources else "silence"
    return Result(
        seq=seq,
        t_start=0.1 * seq,
        t_end=0.1 * seq + 0.5,
        sources=sources,
        why_no_source=why,
        lag_ms=12.5,
    )


def summary(audio_s: float = 1.0) -> Summary:
    return Summary(
        seq=99,
        audio_s=audio_s,
        results=3,
        dropped_s=0.0,
        gap_s=0.0,
        sources=[],
        warnings={"clipping": 2},
    )


def error(code: str, close_code: int, *, retryable: bool = False) -> StreamError:
    return StreamError(
        seq=1,
        code=code,
        title=code.title(),
        detail=f"because of {code}",
        retryable=retryable,
        close_code=close_code,
    )


class Peer:
    """The server's side of one connection."""

    def __init__(self, connection: ServerConnection) -> None:
        self._connection = connection
        self.request = connection.request
        self.start: dict[str, Any] = {}

    def begin(self, session: str = "one") -> None:
        """Take ``start`` and send ``ready``."""
        self.start = self.control()
        self.say(ready(session))

    def say(self, *messages: ServerMessage | str) -> None:
        for message in messages:
            text = message if isinstance(message, str) else message.model_dump_json()
            self._connection.send(text)

    def hear(self) -> bytes | dict[str, Any]:
        """The next message of the client: audio, or a control message."""
        message = self._connection.recv(timeout=TIMEOUT_S)
        return message if isinstance(message, bytes) else json.loads(message)

    def control(self) -> dict[str, Any]:
        message = self.hear()
        assert isinstance(message, dict), "audio where a control message was expected"
        return message

    def audio_until(self, kind: str) -> list[bytes]:
        """All audio messages up to a control message of this type."""
        audio: list[bytes] = []
        while isinstance(message := self.hear(), bytes):
            audio.append(message)
        assert message["type"] == kind
        return audio

    def finish(self, audio_s: float = 1.0) -> None:
        """The orderly end."""
        self.say(
            summary(audio_s), Closing(seq=100, code="done", detail="as asked", close_code=1000)
        )
        self._connection.close(1000)

    def close(self, code: int) -> None:
        self._connection.close(code)

    def vanish(self) -> None:
        """Break the connection without a close frame, as a crash does."""
        self._connection.close_socket()


Script = Callable[[Peer], None]
Refusal = tuple[int, dict[str, Any], dict[str, str]]


class ScriptedService:
    """Connections are played by the scripts in their order; the last one serves all further.

    Parameters
    ----------
    *scripts : callable
        Get a ``Peer``; what they raise fails the test at ``close``.
    refusals : list of tuple
        HTTP status, problem and headers of the first handshakes.
    """

    def __init__(self, *scripts: Script, refusals: list[Refusal] | None = None) -> None:
        self._scripts = list(scripts)
        self._refusals = list(refusals or [])
        self.peers: list[Peer] = []
        self.failures: list[BaseException] = []
        self._playing: list[threading.Thread] = []
        self._server: Server = serve(
            self._play,
            "127.0.0.1",
            0,
            subprotocols=[SUBPROTOCOL],
            compression="deflate",  # offered, so that a client that takes it is noticed
            process_request=self._refuse,
        )
        self._thread = threading.Thread(target=self._server.serve_forever)
        self._thread.start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._server.socket.getsockname()[1]}"

    def close(self) -> None:
        self._server.shutdown()
        self._thread.join(TIMEOUT_S)
        for thread in self._playing:
            thread.join(TIMEOUT_S)
            assert not thread.is_alive(), "a script hangs"
        if self.failures:
            raise self.failures[0]

    def _refuse(self, connection: ServerConnection, request: Request) -> Response | None:
        if not self._refusals:
            return None
        status, problem, headers = self._refusals.pop(0)
        body = json.dumps(problem).encode()
        length = {"Content-Length": str(len(body))}
        return Response(status, "Refused", Headers({**headers, **length}), body)

    def _play(self, connection: ServerConnection) -> None:
        self._playing.append(threading.current_thread())
        peer = Peer(connection)
        self.peers.append(peer)
        script = self._scripts.pop(0) if len(self._scripts) > 1 else self._scripts[0]
        try:
            script(peer)
        except ConnectionClosed:
            pass  # the client's right
        except BaseException as failure:
            self.failures.append(failure)


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

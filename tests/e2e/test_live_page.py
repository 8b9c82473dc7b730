"""The live view against scripted streams: every message, the end, a broken connection.

The script is written with the protocol's own models, so that the page is shown what the service
could send, and in an order in which it seldom does.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

from neuralmusic.protocol.client_messages import Start, read_client_message
from neuralmusic.protocol.server_messages import (
    Closing,
    Limits,
    Ready,
    Result,
    ServerMessage,
    Stats,
    StreamArray,
    StreamError,
    StreamModel,
    StreamSource,
    StreamWarning,
    Summary,
    Timing,
)
from service.doa.array import MicrophoneArray

expect = pytest.importorskip("playwright.sync_api", reason="needs playwright").expect
pytestmark = pytest.mark.page

SAMPLE = Path(__file__).parents[2] / "examples" / "two-talkers.flac"
Visits = Callable[..., Any]
SESSION = {
    "id": "a1",
    "client": "<b>patrol</b>",
    "array": "respeaker-usb-4mic-v2",
    "model": "any-array",
    "method": "neural",
    "started_at": "2026-01-01T00:00:00Z",
    "audio_s": 12.0,
    "results": 120,
    "lag_ms": 14.0,
    "dropped_s": 0.0,
    "num_sources": 1,
    "state": "running",
    "replica": "one",
}


def ready(array: MicrophoneArray) -> Ready:
    return Ready(
        seq=0,
        session="a1",
        model=StreamModel(name="any-array", version="1.0", variant="weights", sha256="0" * 64),
        method="neural",
        array=StreamArray(name=array.name, positions_m=array.positions.tolist()),
        channel_map=[0, 1, 2, 3],
        convention="counter-clockwise",
        timing=Timing(
            interval_ms=100, window_ms=1000, algorithmic_latency_ms=80, sample_rate=16000
        ),
        limits=Limits(
            max_message_bytes=65536, buffer_ms=500, idle_timeout_s=30, max_session_s=3600
        ),
    )


def source(number: int, azimuth: float, *, active: bool = True) -> StreamSource:
    towards = [np.cos(np.deg2rad(azimuth)), np.sin(np.deg2rad(azimuth)), 0.0]
    return StreamSource(
        id=number,
        azimuth_deg=azimuth,
        unit_vector=[float(x) for x in towards],
        confidence=0.9,
        active=active,
        velocity_deg_s=0.0,
        std_deg=2.0,
    )


def result(seq: int, *sources: StreamSource, **fields: Any) -> Result:
    return Result(
        seq=seq,
        t_start=seq * 0.1,
        t_end=seq * 0.1 + 1.0,
        sources=list(sources),
        spectrum=[0.5] * 360,
        lag_ms=fields.pop("lag_ms", 14.0),
        **fields,
    )


def summary(seq: int) -> Summary:
    return Summary(
        seq=seq, audio_s=12.0, results=110, dropped_s=0.5, gap_s=0.0, sources=[], warnings={}
    )


def events(*messages: ServerMessage, history: list[list[Any]] | None = None) -> str:
    """Server-sent events as ``GET /sessions/{id}/events`` gives them."""
    first, *rest = messages
    lines = [f"event: {first.type}\ndata: {first.model_dump_json()}\n\n"]  # type: ignore[attr-defined]
    lines.append(f"event: history\ndata: {json.dumps({'points': history or []})}\n\n")
    lines += [f": keep-alive\n\nevent: {m.type}\ndata: {m.model_dump_json()}\n\n" for m in rest]  # type: ignore[attr-defined]
    return "".join(lines)


def script_sessions(page: Any, running: list[dict[str, Any]], *streams: str) -> None:
    """Answer ``GET /sessions`` with these, and each opening of the events with the next stream."""
    answers = list(streams)
    page.route("**/sessions", lambda route: route.fulfill(json=listed(running)))
    page.route(
        "**/sessions/*/events",
        lambda route: route.fulfill(content_type="text/event-stream", body=answers.pop(0)),
    )


def listed(running: list[dict[str, Any]], **changes: Any) -> dict[str, Any]:
    replicas = {"replica": "one", "replicas": ["one"], "unanswered": 0}
    return {"sessions": running, "max_sessions": 8, **replicas, **changes}


def open_live(visit: Visits, running: list[dict[str, Any]], *streams: str) -> Any:
    here = visit()
    script_sessions(here.page, running, *streams)
    here.page.click("#tab-live")
    return here


def test_where_nothing_runs_the_page_says_how_to_start(visit: Visits) -> None:
    here = open_live(visit, [])
    expect(here.page.locator("#sessions-note")).to_have_text("No session is running.")
    expect(here.page.locator("#howto-command")).to_contain_text(
        f"neuralmusic stream --device NAME --array {SESSION['array']} --url {here.url}"
    )
    here.page.click("#howto-replay")
    expect(here.page.locator("#file")).to_be_focused()


def test_the_commands_that_the_page_prints_work(visit: Visits) -> None:
    here = open_live(visit, [])
    commands = here.page.locator("#howto-command")
    expect(commands).to_contain_text("--list-devices")
    program = [sys.executable, "-m", "neuralmusic"]
    *_, printed = commands.inner_text().splitlines()
    # Where there is no microphone array, a file does.
    words = shlex.split(printed.replace("--device NAME", str(SAMPLE)))[1:]
    done = subprocess.run(
        [*program, *words, "--output", "jsonl"], capture_output=True, text=True, check=True
    )
    results = [json.loads(line) for line in done.stdout.splitlines()]
    azimuths = [s["azimuth_deg"] for r in results for s in r.get("sources", [])]
    assert min(abs(azimuth - 45) for azimuth in azimuths) < 5


def test_a_session_is_watched_to_its_end(visit: Visits, square: MicrophoneArray) -> None:
    stats = Stats(
        seq=3,
        audio_s=12.0,
        results=110,
        dropped_s=0.5,
        gap_s=0.0,
        results_dropped=0,
        lag_ms=15.0,
        buffered_ms=0.0,
    )
    clipping = StreamWarning(seq=2, code="clipping", detail="channel 1 <i>clips</i>", channels=(1,))
    stream = events(
        ready(square),
        result(1, source(7, 45.2), source(12, 200.4, active=False), lag_ms=23.0),
        clipping,
        clipping,
        stats,
        summary(4),
        Closing(seq=5, code="done", detail="the client stopped", close_code=1000),
        history=[[0.9, 44.0, 7, 0.8, True], [0.9, 201.0, 12, 0.4, False]],
    )
    here = open_live(visit, [SESSION], stream)
    page = here.page
    expect(page.locator("#sessions strong")).to_have_text("<b>patrol</b>")
    expect(page.locator("#sessions button")).to_have_attribute("aria-pressed", "true")
    sources = page.locator("#live-sources .where")
    expect(sources).to_have_text(["front left#7", "back, pausing#12"])
    assert here.azimuths("#live-sources .azimuth") == [45, 200]
    expect(page.locator("#live-facts")).to_contain_text("23 ms")
    expect(page.locator("#live-facts")).to_contain_text("0.5 s")
    expect(page.locator("#live-warnings strong")).to_have_text("Clipping (2 times)")
    expect(page.locator("#live-warnings span")).to_have_text(clipping.detail)
    expect(page.locator("#live-state")).to_have_text(
        "The session has ended after 12.0 s: 110 results, 0.5 s dropped."
    )
    expect(page.locator("#live")).to_have_attribute("data-state", "ended")
    expect(page.locator("#live-title")).to_have_text("Last heard, 1.1 s")
    links = [link.get_attribute("href") for link in page.locator("#live-exports a").all()]
    assert links == ["sessions/a1/export?format=csv", "sessions/a1/export?format=jsonl"]


def test_silence_is_explained(visit: Visits, square: MicrophoneArray) -> None:
    stream = events(ready(square), result(1, why_no_source="no_direction"), summary(2))
    here = open_live(visit, [SESSION], stream)
    expect(here.page.locator("#live-note")).to_have_text(
        "There is sound, but from no clear direction."
    )


def test_a_broken_connection_is_told_and_mended(visit: Visits, square: MicrophoneArray) -> None:
    breaks_off = events(ready(square), result(1, source(7, 45.0)))
    goes_on = events(ready(square), result(9, source(7, 50.0)), summary(10))
    here = open_live(visit, [SESSION], breaks_off, goes_on)
    expect(here.page.locator("#live-state")).to_contain_text("The connection broke. Trying again")
    expect(here.page.locator("#live-state")).to_contain_text("The session has ended after")
    assert here.azimuths("#live-sources .azimuth") == [50]


def test_why_a_watched_session_broke_off_is_said(visit: Visits, square: MicrophoneArray) -> None:
    error = StreamError(
        seq=2,
        code="session_limit",
        title="Session limit",
        detail="the session reached 3600 s, its longest duration",
        retryable=True,
        close_code=4410,
    )
    here = open_live(visit, [SESSION], events(ready(square), result(1, source(7, 45.0)), error))
    expect(here.page.locator("#live-dial")).to_be_hidden()
    expect(here.page.locator("#live-problem .detail")).to_have_text(error.detail)
    expect(here.page.locator("#live-state")).to_have_text("The stream has ended with a problem.")


def test_a_session_that_is_gone_is_not_asked_for_again(
    visit: Visits, square: MicrophoneArray
) -> None:
    running = [SESSION]
    here = open_live(visit, running, events(ready(square), result(1, source(7, 45.0))))
    expect(here.page.locator("#sessions button")).to_have_attribute("aria-pressed", "true")
    running.clear()
    expect(here.page.locator("#live-state")).to_have_text("The session has ended.")


def test_where_several_run_the_user_chooses_and_the_list_says_where_they_run(
    visit: Visits, square: MicrophoneArray
) -> None:
    here = visit()
    page = here.page
    both = [SESSION, {**SESSION, "id": "b2", "client": "robot-2", "replica": "two"}]
    answer = listed(both, replicas=["one", "two"], unanswered=1)
    page.route("**/sessions", lambda route: route.fulfill(json=answer))
    stream = events(ready(square), result(1, source(7, 45.0)), summary(2))
    asked: list[str] = []

    def watched(route: Any) -> None:
        asked.append(route.request.url.removeprefix(here.url))
        route.fulfill(content_type="text/event-stream", body=stream)

    page.route("**/sessions/*/events", watched)
    page.click("#tab-live")
    expect(page.locator("#sessions-note")).to_have_text(
        "2 of at most 8 on 2 replicas; 1 replica did not answer."
    )
    page.click("#sessions button >> nth=1")
    expect(page.locator("#live-state")).to_contain_text("The session has ended after")
    assert asked == ["/sessions/b2/events"]


@pytest.mark.parametrize(
    ("subtype", "encoding", "width"),
    [
        ("PCM_16", "pcm_s16le", 2),
        ("PCM_24", "pcm_s24le", 3),
        ("PCM_32", "pcm_s32le", 4),
        ("FLOAT", "pcm_f32le", 4),
        ("FLAC", "pcm_f32le", 4),
    ],
)
def test_replay_sends_the_file_s_samples_as_they_are(
    visit: Visits, square: MicrophoneArray, tmp_path: Path, subtype: str, encoding: str, width: int
) -> None:
    flac = subtype == "FLAC"
    path = tmp_path / ("hören 1.flac" if flac else "hören 1.wav")
    samples = 0.1 * np.random.default_rng(0).standard_normal((4000, 6))
    soundfile.write(path, samples, 16000, subtype="PCM_24" if flac else subtype)
    texts: list[str] = []
    audio: list[bytes] = []

    def take(socket: Any, message: str | bytes) -> None:
        if isinstance(message, bytes):
            audio.append(message)
            return
        texts.append(message)
        if len(texts) == 1:
            socket.send(ready(square).model_dump_json())
        else:
            socket.send(summary(1).model_dump_json())
            socket.close(code=1000)

    here = visit()
    script_sessions(here.page, [])
    here.page.route_web_socket(
        "**/stream", lambda socket: socket.on_message(lambda message: take(socket, message))
    )
    here.page.set_input_files("#file", path)
    here.page.select_option("#method", "method:srp_phat")
    here.page.click("#replay")
    expect(here.page.locator("#live-state")).to_contain_text("The session has ended after")
    expect(here.page.locator("#live-stop")).to_be_hidden()
    start, stop = map(read_client_message, texts)
    assert isinstance(start, Start)
    assert start.audio.encoding == encoding
    assert (start.audio.sample_rate, start.audio.channels) == (16000, 6)
    assert start.array.name == square.name
    assert start.channel_map == [1, 2, 3, 4]
    assert start.method == "srp_phat"
    assert start.overflow == "drop_oldest"
    assert start.output.include == ("spectrum",)
    assert start.client == f"replay-ho-ren-1{path.suffix}"
    assert stop.type == "stop"
    assert all(len(message) % (6 * width) == 0 and len(message) <= 65536 for message in audio)
    if flac:  # as the browser decodes it
        read, _ = soundfile.read(path, dtype="float32")
        sent = np.frombuffer(b"".join(audio), "<f4").reshape(-1, 6)
        np.testing.assert_allclose(sent, read, atol=2**-24)
    else:
        assert b"".join(audio) == path.read_bytes()[-4000 * 6 * width :]


def test_why_a_stream_is_refused_is_said_in_the_service_s_words(
    visit: Visits, square: MicrophoneArray
) -> None:
    error = StreamError(
        seq=0,
        code="too_many_sessions",
        title="Too many sessions",
        detail="this client has 2 sessions & may have 2",
        retryable=False,
        close_code=4429,
    )

    def refuse(socket: Any) -> None:
        socket.on_message(lambda _: (socket.send(error.model_dump_json()), socket.close(code=4429)))

    here = visit()
    script_sessions(here.page, [])
    here.page.route_web_socket("**/stream", refuse)
    here.page.click("#sample")
    expect(here.page.locator("#setup-status")).to_contain_text("Found")
    here.page.click("#replay")
    expect(here.page.locator("#live-problem .detail")).to_have_text(error.detail)
    expect(here.page.locator("#live-problem code")).to_have_text(error.code)


def test_a_file_that_the_browser_cannot_decode_is_not_replayed(visit: Visits) -> None:
    here = visit()
    flac = {"name": "a.flac", "mimeType": "audio/flac", "buffer": b"fLaC" + bytes(40)}
    here.page.set_input_files("#file", flac)
    here.page.click("#replay")
    expect(here.page.locator("#setup-status")).to_contain_text("This browser cannot decode a.flac")
    expect(here.page.locator("#recording")).to_be_visible()

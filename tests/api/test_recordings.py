"""Recordings in worker processes: full, crashed, stalled, stopped, and well again afterwards."""

from __future__ import annotations

import io
import json
import os
import re
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import soundfile
from fastapi.testclient import TestClient

from neuralmusic.errors import UNEXPECTED, InvalidOption
from service.app import create_app
from service.audio.recording import AudioLimits
from service.inference.registry import BundleRegistry
from service.lifecycle import Phase
from service.recordings.job import HeaderRead, Progress, RecordingJob, Refused, localize_file
from service.recordings.options import read_options
from service.settings import Settings
from service.workers import recording as recording_worker
from service.workers.link import TAKEN, Link

ARRAY = "respeaker-usb-4mic-v2"
PATIENCE = 20  # seconds until a hanging test fails
HEADERS = {"Content-Type": "audio/wav"}


class Service:
    """An application with one worker, which can be stopped and killed."""

    def __init__(self, client: TestClient, body: bytes) -> None:
        self.client, self.body = client, body
        self.workers = client.app.state.service.recording_workers  # type: ignore[attr-defined]
        self.executor = ThreadPoolExecutor(1)

    def post(self, body: bytes | None = None) -> Any:
        return self.client.post(
            "/localize", params={"array": ARRAY}, content=body or self.body, headers=HEADERS
        )

    @property
    def pid(self) -> int:
        (pid,) = self.workers.pids
        return int(pid)

    @contextmanager
    def busy(self) -> Iterator[Future[Any]]:
        """A context in which a worker has a recording and stands still."""
        assert self.post().status_code == 200  # it is up
        pid = self.pid
        os.kill(pid, signal.SIGSTOP)
        running = self.executor.submit(self.post)
        while not self.workers.admitted:
            assert self.client.get("/livez").status_code == 200
        try:
            yield running
        finally:
            if pid in self.workers.pids:
                os.kill(pid, signal.SIGCONT)
            running.result(PATIENCE)


@pytest.fixture
def service(sounds: Any) -> Iterator[Callable[..., Service]]:
    """Makes applications without models: classical methods start faster."""
    clients: list[TestClient] = []

    def make(**settings: Any) -> Service:
        app = create_app(Settings(workers=1, **settings), BundleRegistry(()))
        client = TestClient(app, raise_server_exceptions=False)
        client.__enter__()
        clients.append(client)
        return Service(client, sounds.wav())

    yield make
    for client in clients:
        client.__exit__(None, None, None)


@pytest.fixture(scope="module")
def running(sounds: Any) -> Iterator[Service]:
    """A shared application without a queue, for tests that leave it unchanged."""
    app = create_app(Settings(workers=1, queue=0, processes=2), BundleRegistry(()))
    with TestClient(app, raise_server_exceptions=False) as client:
        yield Service(client, sounds.wav())


def test_probes_answer_while_a_recording_is_localized(running: Service) -> None:
    with running.busy():
        assert running.client.get("/livez").json() == {"status": "ok"}
        assert running.client.get("/readyz").json() == {"status": "ok"}


def test_a_full_service_says_when_to_come_back(running: Service) -> None:
    with running.busy() as first:
        refused = running.post(b"not even read")
        assert refused.status_code == 503
        assert refused.json()["code"] == "overloaded"
        assert int(refused.headers["retry-after"]) > 0
    assert first.result().status_code == 200


def test_a_recording_that_takes_longer_than_it_lasts_is_stopped(
    running: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert running.post().status_code == 200
    pid = running.pid
    hurried = SimpleNamespace(monotonic=count(0.0, 100.0).__next__)
    with monkeypatch.context() as patched:
        patched.setattr("service.workers.recording_pool.time", hurried)
        answer = running.post()
    assert (answer.status_code, answer.json()["code"]) == (503, "too_slow")
    assert running.post().status_code == 200
    assert running.pid == pid


def test_a_worker_is_free_again_after_a_recording_that_is_none(running: Service) -> None:
    for _ in range(3):
        assert running.post(b"no audio at all").status_code == 415
    pid = running.pid
    assert running.post().status_code == 200
    assert running.pid == pid


def test_what_a_decoder_prints_goes_nowhere(
    service: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    """libsndfile prints to standard output for MIDI sample dumps, and nobody may read it."""
    dump = io.BytesIO()
    soundfile.write(dump, np.zeros(4000), 16_000, format="SDS", subtype="PCM_16")
    content = bytearray(dump.getvalue())
    content[21::127] = bytes(len(content[21::127]))  # where every packet begins
    assert service().post(bytes(content)).status_code == 422
    assert capfd.readouterr().out == ""


def test_a_stopping_service_ends_what_runs_and_refuses_what_comes(service: Any) -> None:
    running = service()
    with running.busy() as first:
        running.client.app.state.service.lifecycle.enter(Phase.ENDING)
    for response in (first.result(), running.post()):
        assert response.status_code == 503
        assert response.json()["code"] == "draining"
        assert "retry-after" in response.headers


@pytest.mark.processes
@pytest.mark.parametrize(
    ("number", "status", "code"),
    [(signal.SIGSEGV, 422, "decoding_failed"), (signal.SIGKILL, 503, "worker_lost")],
)
def test_a_worker_that_dies_takes_one_recording_with_it(
    running: Service, number: signal.Signals, status: int, code: str
) -> None:
    with running.busy() as first:
        lost = running.pid
        os.kill(lost, number)
        os.kill(lost, signal.SIGCONT)
    response = first.result()
    assert (response.status_code, response.json()["code"]) == (status, code)
    assert ("retry-after" in response.headers) == (status == 503)
    assert running.post().status_code == 200
    assert running.pid != lost


def helpers(pid: int) -> list[int]:
    """The processes that a worker forked for a long recording."""
    with suppress(OSError):
        return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return []


@pytest.mark.processes
@pytest.mark.skipif(sys.platform != "linux", reason="workers fork helpers on Linux only")
def test_a_helper_that_dies_takes_one_recording_with_it(running: Service) -> None:
    assert running.post().status_code == 200
    worker = running.pid
    long = running.executor.submit(running.post, constant(1800, level=99).getvalue())
    while not (forked := helpers(worker)):
        assert running.client.get("/livez").status_code == 200
        assert not long.done()
    os.kill(forked[0], signal.SIGKILL)
    response = long.result(PATIENCE)
    assert (response.status_code, response.json()["code"]) == (503, "worker_lost")
    assert not helpers(worker)
    assert running.post().status_code == 200
    assert running.pid != worker


@pytest.mark.processes
def test_a_worker_that_stands_still_is_replaced(service: Any) -> None:
    running = service(stall_timeout_s=1)
    with running.busy() as first:
        stalled = running.pid
        response = first.result(PATIENCE)
    assert (response.status_code, response.json()["code"]) == (503, "worker_lost")
    assert running.post().status_code == 200
    assert running.pid != stalled


def test_workers_end_with_the_application(service: Any, sounds: Any) -> None:
    app = create_app(Settings(workers=1), BundleRegistry(()))
    with TestClient(app) as client:
        running = Service(client, sounds.wav())
        assert running.post().status_code == 200
        pid = running.pid
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def job(**options: Any) -> RecordingJob:
    asked = read_options([("array", ARRAY), *((name, str(v)) for name, v in options.items())])
    return RecordingJob(asked, AudioLimits())


def constant(seconds: float, channels: int = 4, level: int = 0) -> io.BytesIO:
    """A long recording in a small file, by default of digital silence."""
    file = io.BytesIO()
    samples = np.full((round(seconds * 4000), channels), level, np.int16)
    soundfile.write(file, samples, 4000, format="FLAC")
    file.seek(0)
    return file


@pytest.mark.parametrize(
    ("seconds", "options", "says"),
    [
        (1001, {"hop_s": 0.02}, "at most 50000: use hop_s=0.021 or more"),
        (201, {"hop_s": 0.02, "spectrum": 1}, "at most 10000 with spectra"),
    ],
)
def test_too_many_windows_are_refused_before_anything_is_decoded(
    seconds: float, options: dict[str, Any], says: str
) -> None:
    reports: list[Any] = []
    with pytest.raises(InvalidOption, match=says):
        localize_file(job(**options), constant(seconds), BundleRegistry(()), reports.append)
    assert reports == []


@pytest.mark.parametrize("seconds", [1001, 1100, 1500.5, 3600])
def test_the_hop_that_is_advised_is_taken(seconds: float) -> None:
    with pytest.raises(InvalidOption) as caught:
        localize_file(job(hop_s=0.02), constant(seconds, 1), BundleRegistry(()), lambda _: None)
    advised = re.findall(r"hop_s=([0-9.]+) or more", caught.value.detail)[0]
    reports: list[Any] = []
    with suppress(Heard):
        localize_file(job(hop_s=advised), constant(seconds, 1), BundleRegistry(()), heard(reports))
    assert reports == [HeaderRead(seconds)]


class Heard(Exception):
    """Part of that recording, long enough for the test."""


def heard(reports: list[Any]) -> Callable[[object], None]:
    """Ends a recording's work with its first report."""

    def report(each: object) -> None:
        reports.append(each)
        raise Heard

    return report


@pytest.mark.skipif(sys.platform != "linux", reason="workers fork helpers on Linux only")
def test_a_long_recording_is_the_same_from_one_process_and_from_three() -> None:
    rng = np.random.default_rng(0)
    file = io.BytesIO()
    noise = (
        rng.normal(0, 0.1, (45 * 16_000, 4)) * (np.sin(np.arange(45 * 16_000) / 9e3) > 0)[:, None]
    )
    soundfile.write(file, noise, 16_000, format="WAV", subtype="PCM_16")

    def answer(processes: int) -> dict[str, Any]:
        file.seek(0)
        body, _ = localize_file(job(), file, BundleRegistry(()), lambda _: None, processes)
        answered: dict[str, Any] = json.loads(body)
        return answered

    alone, shared = answer(1), answer(3)
    assert len(alone["windows"]) == 87
    assert shared == alone


def test_a_recording_is_opened_before_it_is_decoded() -> None:
    reports: list[Any] = []
    localize_file(job(), constant(10), BundleRegistry(()), reports.append)
    assert reports[0] == HeaderRead(10.0)
    assert reports[-1] == Progress(1.0)
    shares = [report.share for report in reports[1:]]
    assert shares == sorted(shares)


@pytest.fixture
def link() -> Iterator[Link]:
    """The other end of a worker that runs in a thread."""
    ours, theirs = socket.socketpair()

    def work() -> None:
        with pytest.raises(EOFError):
            recording_worker.work_until_end(Link(theirs), BundleRegistry(()))
        theirs.close()

    ours.settimeout(PATIENCE)
    thread = threading.Thread(target=work)
    thread.start()
    yield Link(ours)
    ours.close()
    thread.join(PATIENCE)


def test_a_worker_that_is_told_to_stop_waits_for_the_next_recording(
    link: Link, tmp_path: Any
) -> None:
    path = tmp_path / "silence.flac"
    path.write_bytes(constant(10).getvalue())
    for _ in range(2):
        with path.open("rb") as file:
            link.send(job(), [file.fileno()])
        assert link.receive() == TAKEN
        assert link.receive() == HeaderRead(10.0)
        link.send(False)
        assert link.receive() is None


def test_an_unforeseen_failure_gives_nothing_away(
    link: Link, monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    def broken(*_: Any) -> None:
        raise ZeroDivisionError("secret")

    monkeypatch.setattr("service.workers.recording.localize_file", broken)
    with (tmp_path / "any").open("w+b") as file:
        link.send(job(), [file.fileno()])
        assert link.receive() == TAKEN
        refused = link.receive()
    assert isinstance(refused, Refused)
    assert (refused.error.code, refused.error.detail) == ("internal", UNEXPECTED)

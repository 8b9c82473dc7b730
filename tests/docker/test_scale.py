"""Replicas behind the proxy: no request is lost while each is replaced under load."""

from __future__ import annotations

import asyncio
import io
import itertools
from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack
from dataclasses import dataclass, field

import httpx2
import numpy as np
import pytest
import soundfile
from running_containers import ARRAY, SAMPLE, ComposeProject, wait_for

from neuralmusic import (
    AsyncLocalizationClient,
    AsyncStreamClient,
    Backoff,
    LocalizationClient,
    Reconnecting,
    ServiceProblem,
)
from neuralmusic.errors import DoaError
from neuralmusic.protocol.server_messages import Closing, Ready, Result, Summary

pytestmark = pytest.mark.docker

AUDIO, RATE = soundfile.read(SAMPLE, dtype="int16")
STREAMS = 4
UPLOADERS = 3
AFTER = 10
"""Results that every stream gets once all replicas are new"""
PATIENCE_S = 400
WAV = "audio/wav"


@pytest.fixture(scope="module")
def three(image: str, provided: Callable[[str], None]) -> Iterator[ComposeProject]:
    """Three replicas behind a proxy that knows them all."""
    provided("haproxy:2.6")
    with ComposeProject("three", "compose.scale.yaml", MEMORY="1g") as project:
        project.up()
        wait_for(f"{project.url('proxy', 8000)}/readyz")
        yield project


def wav(seconds: float) -> bytes:
    """The sample's beginning, or the sample again and again."""
    count = round(seconds * RATE)
    file = io.BytesIO()
    soundfile.write(file, np.resize(AUDIO, (count, AUDIO.shape[1])), RATE, format="WAV")
    return file.getvalue()


@dataclass
class Load:
    """Robots and recordings until ``enough`` is set, and what became of them."""

    url: str
    enough: asyncio.Event = field(default_factory=asyncio.Event)
    answers: int = 0
    refusals: int = 0
    problems: list[str] = field(default_factory=list)
    sessions: int = 0
    cut: int = 0
    """Sessions that ended before the client wanted it"""
    told: int = 0
    """Cut sessions that got their summary and were told why"""

    async def upload(self, recording: bytes, *, one_connection: bool) -> None:
        """One recording after the other, over the same connection or always a new one."""
        client = AsyncLocalizationClient(self.url)
        while not self.enough.is_set():
            try:
                answer = await client.localize(recording, array=ARRAY)
                assert answer["windows"]
                self.answers += 1
            except (DoaError, AssertionError) as error:
                self.problems.append(repr(error))
            if not one_connection:
                await client.close()
                client = AsyncLocalizationClient(self.url)
        await client.close()

    async def ask(self) -> None:
        """Cheap requests, hundreds a second, so that one is always on its way."""
        async with httpx2.AsyncClient(base_url=self.url, headers={"Content-Type": WAV}) as client:
            while not self.enough.is_set():
                try:
                    answer = await client.post("/localize", content=b"no array is named")
                    self.refusals += 1
                    if answer.status_code != 422:
                        self.problems.append(answer.text)
                except httpx2.TransportError as error:
                    self.problems.append(repr(error))

    async def stream(self) -> None:
        """A robot that continues whatever happens, and reads all messages."""
        stream = AsyncStreamClient(
            self.url,
            array=ARRAY,
            audio={"encoding": "pcm_s16le", "sample_rate": RATE, "channels": 4},
            backoff=Backoff(first_s=0.2, longest_s=1.0),
        )
        async with stream:
            speaking = asyncio.create_task(self._speak(stream))
            last: list[type] = []
            results = 0
            async for event in stream:
                if isinstance(event, Ready):
                    self.sessions += 1
                elif isinstance(event, Reconnecting) and event.attempt == 0:
                    self.cut += 1
                    self.told += last == [Summary, Closing]
                elif isinstance(event, Result) and self.enough.is_set():
                    results += 1
                    if results >= AFTER:
                        break
                last = [*last[-1:], type(event)]
            speaking.cancel()

    async def _speak(self, stream: AsyncStreamClient) -> None:
        """Audio at the pace of a microphone."""
        chunk = RATE // 10
        for begin in itertools.cycle(range(0, len(AUDIO) - chunk, chunk)):
            await stream.send(AUDIO[begin : begin + chunk])
            await asyncio.sleep(chunk / RATE)


def test_nothing_is_lost_while_every_replica_is_replaced_under_load(three: ComposeProject) -> None:
    before = {replica.id for replica in three.containers("neuralmusic")}
    load = Load(three.url("proxy", 8000))

    async def run() -> None:
        short, long = wav(1.5), wav(40.0)
        async with asyncio.timeout(PATIENCE_S), asyncio.TaskGroup() as tasks:
            for _ in range(STREAMS):
                tasks.create_task(load.stream())
            for index in range(UPLOADERS):
                tasks.create_task(load.upload(short, one_connection=index % 2 == 0))
            tasks.create_task(load.upload(long, one_connection=False))
            tasks.create_task(load.ask())
            await asyncio.to_thread(three.rolling_restart)
            load.enough.set()

    asyncio.run(run())
    after = {replica.id for replica in three.containers("neuralmusic")}
    assert len(after) == len(before) == 3
    assert not before & after
    assert load.problems == []
    assert load.answers >= 3 * UPLOADERS
    assert load.answers + load.refusals >= 1000  # on a slow machine a third of them uploads
    # Every replica had streams, which all were told, and all of them stream again.
    assert load.cut >= STREAMS
    assert load.told == load.cut
    assert load.sessions == STREAMS + load.cut


def test_whichever_replica_is_asked_shows_the_streams_of_all(three: ComposeProject) -> None:
    """Streams go to the replica with the fewest connections, so three are on three."""
    url = three.url("proxy", 8000)

    async def run() -> None:
        async with asyncio.timeout(PATIENCE_S), AsyncExitStack() as held:
            streams = [await held.enter_async_context(robot(url)) for _ in range(3)]
            known = {(await anext(aiter(stream))).session for stream in streams}
            async with httpx2.AsyncClient(base_url=url) as http:
                for _ in range(6):  # the proxy sends them to different replicas
                    answer = (await http.get("/sessions")).json()
                    running = [s for s in answer["sessions"] if s["state"] == "running"]
                    assert {session["id"] for session in running} == known
                    assert len({session["replica"] for session in running}) == 3
                    assert (len(answer["replicas"]), answer["unanswered"]) == (3, 0)
                    for session in known:
                        async with http.stream("GET", f"/sessions/{session}/events") as events:
                            assert await anext(events.aiter_lines()) == "event: ready"

    asyncio.run(run())


def robot(url: str) -> AsyncStreamClient:
    audio = {"encoding": "pcm_s16le", "sample_rate": RATE, "channels": 4}
    return AsyncStreamClient(url, array=ARRAY, audio=audio)


def test_what_is_for_operators_is_not_published(three: ComposeProject) -> None:
    url = three.url("proxy", 8000)
    for path in ("/metrics", "/metrics/", "/%6Detrics", "/METRICS", "/admin/reload"):
        answer = httpx2.get(url + path)
        assert (answer.status_code, answer.json()["code"]) == (404, "not_found"), path


def test_where_no_replica_is_ready_the_proxy_says_so_as_the_service_would(
    three: ComposeProject,
) -> None:
    three.compose("stop", "-t", "1", "neuralmusic")
    with (
        LocalizationClient(three.url("proxy", 8000)) as client,
        pytest.raises(ServiceProblem) as caught,
    ):
        client.localize(SAMPLE, array=ARRAY)
    assert (caught.value.code, caught.value.retryable) == ("http_503", True)
    assert caught.value.retry_after_s == 2
    three.compose("start", "neuralmusic")
    wait_for(f"{three.url('proxy', 8000)}/readyz")

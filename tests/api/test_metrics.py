"""What Prometheus sees of a running service."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from running_service import RunningService
from watched_service import SECONDS, localize, recording, scraped, stream
from websockets.exceptions import ConnectionClosedError

from service.settings import Settings

ROOT = Path(__file__).parents[2]


def names(values: dict[str, float]) -> set[str]:
    """The service's own metrics, by family."""
    written = {name.partition("{")[0] for name in values if name.startswith("neuralmusic_")}
    return {re.sub(r"_(bucket|sum|count)$", "", name) for name in written}


@pytest.fixture(scope="module")
def used() -> Iterator[tuple[dict[str, float], dict[str, float], list[str]]]:
    """Scrapes before and after a stream, a file and three errors; what the stream was answered."""
    service = RunningService(settings=Settings(workers=1, stream_workers=1), workers_ahead=True)
    url, socket = service.url, service.url.replace("http", "ws") + "/stream"
    before = scraped(url)
    with pytest.raises(ConnectionClosedError, match="4400"):
        asyncio.run(stream(socket, start={"array": {"name": "nobody's"}}, seconds=0))
    answered = asyncio.run(stream(socket))
    assert localize(url, recording()).status_code == 200
    for body in (b"no audio", b""):
        localize(url, body)
    yield before, scraped(url), answered
    service.stop()


def test_every_metric_of_the_document_is_there_from_the_start_and_no_other(used: Any) -> None:
    table = (ROOT / "docs" / "monitoring.md").read_text()
    documented = set(re.findall(r"^\| `(neuralmusic_\w+)` ", table, re.MULTILINE))
    before, after, _ = used
    unasked = {"neuralmusic_requests_total", "neuralmusic_request_seconds"}
    assert names(before) == documented - unasked
    assert names(after) == documented
    assert "process_cpu_seconds_total" in after


def test_seconds_of_audio_are_those_that_were_sent(used: Any) -> None:
    after = used[1]
    assert after['neuralmusic_audio_seconds_total{"kind": "stream"}'] == pytest.approx(SECONDS)
    assert after['neuralmusic_audio_seconds_total{"kind": "recording"}'] == pytest.approx(1.5)
    assert after["neuralmusic_audio_dropped_seconds_total"] == 0


def test_every_result_of_the_stream_has_a_lag_and_a_latency(used: Any) -> None:
    _, after, answered = used
    results = answered.count("result")
    assert results >= 10 * SECONDS - 1
    assert after["neuralmusic_lag_seconds_count"] == results
    assert after["neuralmusic_result_latency_seconds_count"] == results
    lag, latency = (after[f"neuralmusic_{name}_seconds_sum"] for name in ("lag", "result_latency"))
    # The latency goes on where the lag ends; a lag is rounded to a tenth of a millisecond.
    assert 0 < lag <= latency + results * 5e-5


def test_work_is_timed_by_its_kind(used: Any) -> None:
    _, after, answered = used
    for name in ("queue", "inference"):
        steps = after[f'neuralmusic_{name}_seconds_count{{"kind": "stream"}}']
        assert steps >= answered.count("result")
        assert after[f'neuralmusic_{name}_seconds_count{{"kind": "recording"}}'] >= 1
    assert after['neuralmusic_inference_seconds_sum{"kind": "recording"}'] > 0
    # 1.5 s in hops of half the window, in batches
    assert after["neuralmusic_batch_windows_sum"] >= 2


def test_errors_are_counted_by_their_code(used: Any) -> None:
    after = used[1]
    errors = {name: value for name, value in after.items() if "errors_total" in name and value}
    assert errors == {
        'neuralmusic_errors_total{"code": "not_audio"}': 1,
        'neuralmusic_errors_total{"code": "audio_missing"}': 1,
        'neuralmusic_errors_total{"code": "array_unknown"}': 1,
    }


def test_streams_are_counted_when_they_end_and_the_gauges_go_back(used: Any) -> None:
    after = used[1]
    ended = {name: value for name, value in after.items() if "sessions_ended" in name and value}
    assert ended == {
        'neuralmusic_sessions_ended_total{"reason": "done"}': 1,
        'neuralmusic_sessions_ended_total{"reason": "array_unknown"}': 1,
    }
    assert after["neuralmusic_sessions"] == 0
    assert after["neuralmusic_uploads"] == 0
    assert after["neuralmusic_ready"] == 1
    assert after['neuralmusic_workers{"kind": "stream"}'] == 1

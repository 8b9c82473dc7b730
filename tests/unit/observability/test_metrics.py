"""Counting: what comes out is what Prometheus' own parsers read."""

from __future__ import annotations

import pytest
from prometheus_client.openmetrics.parser import text_string_to_metric_families as read_openmetrics
from prometheus_client.parser import text_string_to_metric_families as read_text

from neuralmusic.errors import DoaError
from service.inference.results import ModelIdentity
from service.observability.metrics import Gauges, Metrics, error_codes

OPENMETRICS = "application/openmetrics-text;version=1.0.0,text/plain;version=0.0.4;q=0.5"


def samples(
    metrics: Metrics, accept: str = ""
) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    """Values by name and labels, as read by the format's own parser."""
    body, media_type = metrics.exposition(accept)
    read = read_openmetrics if "openmetrics" in media_type else read_text
    return {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in read(body.decode())
        for sample in family.samples
    }


def value(metrics: Metrics, name: str, /, **labels: str) -> float:
    return samples(metrics)[f"neuralmusic_{name}", tuple(sorted(labels.items()))]


def test_both_formats_say_the_same() -> None:
    metrics = Metrics()
    metrics.audio("stream", 1.5)
    metrics.requested("GET", "/livez", 200, 0.01)
    metrics.lag(0.012)
    text, openmetrics = samples(metrics), samples(metrics, OPENMETRICS)
    ours = {key for key in text if key[0].startswith("neuralmusic_")}
    assert ours == {key for key in openmetrics if key[0].startswith("neuralmusic_")}
    assert {key: text[key] for key in ours} == {key: openmetrics[key] for key in ours}


def test_the_media_type_follows_what_is_accepted() -> None:
    metrics = Metrics()
    assert metrics.exposition("")[1] == "text/plain; version=0.0.4; charset=utf-8"
    assert metrics.exposition(OPENMETRICS)[1].startswith("application/openmetrics-text; version=1")


def test_two_applications_count_apart() -> None:
    one, other = Metrics(), Metrics()
    one.refused("overloaded")
    assert value(one, "errors_total", code="overloaded") == 1
    assert value(other, "errors_total", code="overloaded") == 0


@pytest.mark.parametrize(
    ("lag_s", "under"),
    [(0.004, "0.005"), (0.005, "0.005"), (0.0051, "0.01"), (4.9, "5.0"), (60.0, "+Inf")],
)
def test_a_lag_is_counted_in_its_bucket_and_all_above(lag_s: float, under: str) -> None:
    metrics = Metrics()
    metrics.lag(lag_s)
    buckets = {
        dict(labels)["le"]: count
        for (name, labels), count in samples(metrics).items()
        if name == "neuralmusic_lag_seconds_bucket"
    }
    for bound, count in buckets.items():
        assert count == (float(bound) >= float(under)), bound


def test_work_is_counted_by_its_kind() -> None:
    metrics = Metrics()
    metrics.worked("stream", 0.001, 0.004)
    metrics.worked("stream", 0.002, 0.004)
    metrics.worked("recording", 3.0, 20.0)
    assert value(metrics, "queue_seconds_sum", kind="stream") == pytest.approx(0.003)
    assert value(metrics, "inference_seconds_count", kind="stream") == 2
    assert value(metrics, "inference_seconds_sum", kind="recording") == 20.0


def test_what_clients_make_up_becomes_no_time_series() -> None:
    metrics = Metrics()
    before = len(samples(metrics))
    for index in range(50):
        metrics.refused(f"made_up_{index}")
        metrics.session_ended(f"made_up_{index}")
        metrics.requested(f"METHOD{index}", "other", 404, None)
    assert value(metrics, "errors_total", code="other") == 50
    assert value(metrics, "sessions_ended_total", reason="other") == 50
    assert value(metrics, "requests_total", method="other", path="other", status="404") == 50
    assert len(samples(metrics)) == before + 3


def test_every_code_begins_at_nought_so_that_its_first_count_is_an_increase() -> None:
    metrics = Metrics()
    assert {DoaError.code, "worker_lost", "timeout", "disk_full"} <= set(error_codes())
    for code in error_codes():
        assert value(metrics, "errors_total", code=code) == 0


def test_gauges_are_read_when_they_are_asked_for() -> None:
    metrics = Metrics()
    now = Gauges()
    metrics.read_from(lambda: now)
    assert value(metrics, "ready") == 0
    model = ModelIdentity("one", "1.0", "weights", "0" * 64)
    now = Gauges(3, 64, 2, {"stream": 1, "recording": 2}, True, (model,))
    assert value(metrics, "sessions") == 3
    assert value(metrics, "max_sessions") == 64
    assert value(metrics, "uploads") == 2
    assert value(metrics, "workers", kind="recording") == 2
    assert value(metrics, "ready") == 1
    labels = {"name": "one", "version": "1.0", "variant": "weights", "sha256": "0" * 64}
    assert value(metrics, "model_info", **labels) == 1


def test_lost_workers_and_reloads_are_counted() -> None:
    metrics = Metrics()
    metrics.worker_lost("recording")
    metrics.reloaded(ok=True)
    metrics.reloaded(ok=False)
    metrics.batch(4)
    assert value(metrics, "workers_lost_total", kind="recording") == 1
    assert value(metrics, "workers_lost_total", kind="stream") == 0
    assert value(metrics, "reloads_total", outcome="ok") == 1
    assert value(metrics, "reloads_total", outcome="refused") == 1
    assert value(metrics, "batch_windows_bucket", le="3.0") == 0
    assert value(metrics, "batch_windows_bucket", le="4.0") == 1

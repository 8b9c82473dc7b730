"""OpenTelemetry traces: a span for every request and stream, by FastAPI's own support.

Off by default; then nothing of OpenTelemetry's SDK is imported. The exporter takes the usual
``OTEL_`` variables (headers, timeouts, batches); the endpoint is the setting ``traces``.
"""

from __future__ import annotations

from collections.abc import MutableMapping
from contextlib import AbstractContextManager, nullcontext
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from neuralmusic import __version__
from neuralmusic.errors import ConfigError

if TYPE_CHECKING:
    from fastapi.telemetry import TelemetryConfig

SERVICE = "neuralmusic"
PATH = "/v1/traces"
"""Where OTLP/HTTP takes traces, after an endpoint that is an address alone"""
UNTRACED = ("/livez", "/readyz", "/metrics")
"""Asked every few seconds"""
OFF: TelemetryConfig = {
    "tracing": False,
    "metrics": False,
    "logs": False,
    "auto_configure": False,
}
FLUSH_S = 3
"""Seconds that the last spans have at the end, so that a dead collector holds up no restart"""


class Traces:
    """Where the spans of one application go.

    Parameters
    ----------
    endpoint : str, optional
        Of a collector; None for no traces at all.

    Raises
    ------
    ConfigError
        If the extra ``otel`` is not installed.
    """

    def __init__(self, endpoint: str | None = None) -> None:
        self._provider = _provider(endpoint) if endpoint else None
        self._tracer = self._provider.get_tracer(SERVICE, __version__) if self._provider else None

    @property
    def telemetry(self) -> TelemetryConfig:
        """What FastAPI takes as ``telemetry``."""
        if self._provider is None:
            return OFF
        return {
            **OFF,
            "tracing": True,
            "tracer_provider": self._provider,
            "exclude": _untraced,
            # A stream's endpoint lasts as long as the stream: its span would say nothing more.
            "operation_spans": False,
        }

    def span(self, name: str) -> AbstractContextManager[Any]:
        """A span within the request's; nothing where there are no traces."""
        if self._tracer is None:
            return nullcontext()
        # An error that is a client's becomes a status of the request, not an exception here.
        span: AbstractContextManager[Any] = self._tracer.start_as_current_span(
            name, record_exception=False, set_status_on_exception=False
        )
        return span

    def stop(self) -> None:
        """Send what waits; blocks for a moment."""
        if self._provider is not None:
            self._provider.force_flush(1000 * FLUSH_S)
            self._provider.shutdown()


def _untraced(scope: MutableMapping[str, Any]) -> bool:
    return scope["type"] == "http" and scope["path"] in UNTRACED


def _provider(endpoint: str) -> Any:
    """A tracer provider that exports to ``endpoint`` in batches, from a thread of its own."""
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.resources import Resource
        from opentelemetry.sdk.trace import ReadableSpan, Span, SpanProcessor, TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
    except ImportError:
        raise _missing() from None
    if find_spec("fastapi.telemetry") is None:  # before 0.143
        raise _missing()

    class WithoutQuery(SpanProcessor):
        """Leaves query strings out, as the log does: clients put into them what they like."""

        def on_start(self, span: Span, parent_context: Any = None) -> None:
            if isinstance(span, ReadableSpan) and "url.query" in (span.attributes or {}):
                span.set_attribute("url.query", "hidden")

    resource = Resource.create({"service.name": SERVICE, "service.version": __version__})
    provider = TracerProvider(resource=resource, shutdown_on_exit=False)
    provider.add_span_processor(WithoutQuery())
    address = endpoint if urlsplit(endpoint).path not in ("", "/") else endpoint.rstrip("/") + PATH
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter(address, timeout=FLUSH_S)))
    return provider


def _missing() -> ConfigError:
    return ConfigError(
        "traces need an extra: pip install ./client '.[otel]' in the project's folder, or leave "
        "traces out"
    )

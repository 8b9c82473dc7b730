"""OpenTelemetry traces: a span for every request and stream, through FastAPI's own support.

Traces are off by default; OpenTelemetry's SDK is then not imported. The exporter takes the usual
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
"""Path of OTLP/HTTP, added to an endpoint without a path"""
UNTRACED = ("/livez", "/readyz", "/metrics")
"""Paths without spans: they are asked every few seconds"""
OFF: TelemetryConfig = {
    "tracing": False,
    "metrics": False,
    "logs": False,
    "auto_configure": False,
}
FLUSH_S = 3
"""Most seconds for the last spans, so that a dead collector does not delay a restart"""


class Traces:
    """The spans of one application.

    Parameters
    ----------
    endpoint : str, optional
        A collector's; None for no traces at all.

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
        """The argument ``telemetry`` of FastAPI."""
        if self._provider is None:
            return OFF
        return {
            **OFF,
            "tracing": True,
            "tracer_provider": self._provider,
            "exclude": _untraced,
            # The span of a stream's endpoint would only repeat the request's: both last as long.
            "operation_spans": False,
        }

    def span(self, name: str) -> AbstractContextManager[Any]:
        """A span within the request's; does nothing without traces."""
        if self._tracer is None:
            return nullcontext()
        # A client's error becomes the status of the request, not an exception of this span.
        span: AbstractContextManager[Any] = self._tracer.start_as_current_span(
            name, record_exception=False, set_status_on_exception=False
        )
        return span

    def stop(self) -> None:
        """Send the remaining spans; blocks for up to ``FLUSH_S``."""
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
        """Leaves query strings out, as the log does: they may hold anything."""

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

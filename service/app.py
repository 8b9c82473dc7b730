"""The ASGI application, which ``neuralmusic serve`` runs.

Another ASGI server takes ``service.app:create_app`` as a factory; set the variables of
``service.machine.environment`` for it yourself.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from fastapi import FastAPI
from fastapi.routing import APIRoute
from starlette.types import ASGIApp

from neuralmusic import __version__
from service.api import admin, catalog, localize, metrics, noise, page, probes, sessions, stream
from service.api.contract.keys import document_guard
from service.api.contract.localize import document_answer
from service.api.middleware.body_deadline import BodyDeadline
from service.api.middleware.body_limit import BodyLimit
from service.api.middleware.guard import Guard
from service.api.middleware.request_watch import RequestWatch
from service.api.problems import Problem, install_problem_handlers
from service.api.state import ServiceState
from service.inference.registry import BundleRegistry
from service.settings import Settings, load_settings

DESCRIPTION = """
Directions of arrival from microphone array audio, with a neural covariance model and MUSIC or with
classical methods.

Angles are azimuths in degrees in [0, 360), counter-clockwise from the array's +x axis (x forward,
y left, z up). Positions are metres, times seconds. Errors are RFC 9457 problems with a stable
`code`.
"""

TAGS = [
    {"name": "localization", "description": "Recordings in, directions out."},
    {"name": "streams", "description": "Running streams and their results. They use /stream."},
    {"name": "noise", "description": "Profiles of the robot's own noise."},
    {"name": "catalog", "description": "What requests may name."},
    {"name": "service", "description": "Web page and probes."},
]

PARTS = (localize, stream, sessions, noise, catalog, admin, probes, metrics, page)
"""Modules of the API, each with a router"""


class DocumentedApp(FastAPI):
    """FastAPI with ``RequestWatch`` around it, and with ``Problem`` and the keys in its document.

    No endpoint's type mentions these two.
    """

    def build_middleware_stack(self) -> ASGIApp:
        """Starlette's stack, watched from outside its answer to unexpected errors."""
        paths = [route.path for part in PARTS for route in part.router.routes]
        documents = [self.openapi_url] if self.openapi_url else []
        stack = super().build_middleware_stack()
        return RequestWatch(stack, self.state.service.metrics, [*documents, *paths])

    def openapi(self) -> dict[str, Any]:
        document = super().openapi()
        schemas = document["components"]["schemas"]
        schemas.setdefault("Problem", Problem.model_json_schema())
        # FastAPI documents its own 422 wherever there is a parameter, even if any text is valid.
        for name in ("HTTPValidationError", "ValidationError"):
            schemas.pop(name, None)
        for path in document["paths"].values():
            for operation in path.values():
                if operation["responses"].get("422", {}).get("description") == "Validation Error":
                    del operation["responses"]["422"]
        document_guard(document)
        document_answer(document)
        return document


def create_app(settings: Settings | None = None, registry: BundleRegistry | None = None) -> FastAPI:
    """The application; without a registry it loads its bundles at startup."""
    settings = settings or load_settings()
    state = ServiceState.of(settings)
    if registry is not None:
        state.install(registry)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        await state.load()
        yield
        await state.stop()

    app = DocumentedApp(
        title="NeuralMUSIC Service",
        summary="Sound source localization for robots",
        description=DESCRIPTION.strip(),
        version=__version__,
        license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
        openapi_tags=TAGS,
        lifespan=lifespan,
        telemetry=state.traces.telemetry,
        docs_url=None,  # it would load Swagger UI from elsewhere: service.api.page has it
        redoc_url=None,
        generate_unique_id_function=_operation_id,
    )
    app.state.service = state
    app.add_middleware(BodyDeadline, seconds=settings.body_timeout_s)
    app.add_middleware(BodyLimit, max_bytes=settings.max_upload_bytes)
    app.add_middleware(Guard, settings=settings, keys=state.keys)
    install_problem_handlers(app)
    for each in PARTS:
        app.include_router(each.router)
    return app


def _operation_id(route: APIRoute) -> str:
    return route.name

"""The ASGI application: ``uvicorn --factory service.app:create_app`` or ``neuralmusic serve``."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import anyio.to_thread
from fastapi import FastAPI
from fastapi.routing import APIRoute

from service import __version__
from service.api import catalog, localize, noise, page, probes, sessions, stream
from service.api.limits import BodyLimit
from service.api.problems import Problem, install_problem_handlers
from service.api.state import ServiceState
from service.api.stream_workers import StreamWorkers
from service.api.workers import WorkerPool
from service.inference.noise_store import NoiseStore
from service.inference.registry import BundleRegistry
from service.settings import Settings, load_settings
from service.startup import load_registry
from service.streaming.registry import SessionRegistry

DESCRIPTION = """
Directions of arrival from microphone array audio, with a neural covariance model and MUSIC or with
classical methods.

Angles are azimuths in degrees in [0, 360), counter-clockwise from the array's +x axis (x forward,
y left, z up). Positions are metres, times seconds. Errors are RFC 9457 problems with a stable
`code`.
"""

TAGS = [
    {"name": "localization", "description": "Recordings in, directions out."},
    {"name": "streams", "description": "Who streams, what they get. The stream itself is /stream."},
    {"name": "noise", "description": "Profiles of the robot's own noise."},
    {"name": "catalog", "description": "What requests may name."},
    {"name": "service", "description": "Web page and probes."},
]


class DocumentedApp(FastAPI):
    """FastAPI whose document says what is answered: problems, and no others than there are."""

    def openapi(self) -> dict[str, Any]:
        document = super().openapi()
        schemas = document["components"]["schemas"]
        schemas.setdefault("Problem", Problem.model_json_schema())
        # FastAPI promises its own 422 wherever there is a parameter, were it any text.
        if schemas.pop("HTTPValidationError", None):
            del schemas["ValidationError"]
            for path in document["paths"].values():
                for operation in path.values():
                    if "application/json" in operation["responses"].get("422", {}).get(
                        "content", {}
                    ):
                        del operation["responses"]["422"]
        return document


def create_app(settings: Settings | None = None, registry: BundleRegistry | None = None) -> FastAPI:
    """The application; without a registry it loads its bundles at startup."""
    settings = settings or load_settings()
    state = ServiceState(
        settings,
        WorkerPool(settings.workers, settings.queue),
        SessionRegistry(settings.max_sessions),
        StreamWorkers(settings),
        registry,
        NoiseStore(settings.noise_folder),
    )

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        if state.registry is None:
            state.registry = await anyio.to_thread.run_sync(load_registry, settings)
        yield
        await state.stream_workers.stop()

    app = DocumentedApp(
        title="NeuralMUSIC Service",
        summary="Sound source localization for robots",
        description=DESCRIPTION.strip(),
        version=__version__,
        license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
        openapi_tags=TAGS,
        lifespan=lifespan,
        redoc_url=None,
        generate_unique_id_function=_operation_id,
    )
    app.state.service = state
    app.add_middleware(BodyLimit, max_bytes=settings.max_upload_bytes)
    install_problem_handlers(app)
    for each in (localize, stream, sessions, noise, catalog, probes, page):
        app.include_router(each.router)
    return app


def _operation_id(route: APIRoute) -> str:
    return route.name

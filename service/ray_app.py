"""The service on a Ray cluster: ``serve run service.ray_app:app`` (``docs/scale-out.md``).

Ray Serve holds the connections and starts one replica, a process of its own, for every few of them.
A replica runs the application of ``create_app``, configured by the same ``NEURALMUSIC_`` variables.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import ray
from fastapi import FastAPI
from ray import serve

from service.machine.environment import prepare_process

prepare_process()  # a replica begins here: what follows imports numpy

from service.api.state import ServiceState
from service.app import create_app
from service.server import FAREWELL
from service.settings import GRACE, variable

CONTROLLER = "SERVE_CONTROLLER_ACTOR"
LOOK_S = 1.0
"""Seconds between looks at this replica's state in Ray Serve"""


def replica_app() -> FastAPI:
    """The application of one replica, with as many processes as Ray gave it CPUs."""
    cpus = max(1, int(ray.get_runtime_context().get_assigned_resources().get("CPU", 1)))
    for name in ("workers", "stream_workers"):
        os.environ.setdefault(variable(name), str(cpus))
    app = create_app()
    state: ServiceState = app.state.service
    loading = app.router.lifespan_context

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        async with loading(app):
            await state.start_workers()
            watching = asyncio.create_task(drain_once_stopped(state))
            yield
            watching.cancel()

    app.router.lifespan_context = lifespan
    return app


async def drain_once_stopped(state: ServiceState) -> None:
    """End the streams once Ray Serve stops this replica.

    Ray Serve tells a replica only after all requests have ended. An open stream is a request, and
    would be cut off at the end of the grace period.
    """
    stopping = False
    while not stopping:
        await asyncio.sleep(LOOK_S)
        stopping = await _stopping()
    state.drain()


async def _stopping() -> bool:
    """Whether Ray Serve's controller lists this replica as stopping, or no longer lists it."""
    here = serve.get_replica_context()
    try:
        controller = ray.get_actor(CONTROLLER, namespace="serve")
        details = await controller.get_serve_instance_details.remote()
    except (ray.exceptions.RayError, ValueError):  # the controller restarts; streams continue
        return False
    deployments = details["applications"].get(here.app_name, {}).get("deployments", {})
    replicas = deployments.get(here.deployment, {}).get("replicas", [])
    states = {replica["replica_id"]: replica["state"] for replica in replicas}
    return bool(states.get(here.replica_tag, "STOPPING") == "STOPPING")


class Replica:
    """One process of the service."""

    app: FastAPI
    """The application; Ray Serve sets it"""

    async def check_health(self) -> None:
        """Raise NotReady where the service has no models."""
        self.app.state.service.models()


deployment = serve.deployment(
    name="neuralmusic",
    ray_actor_options={"num_cpus": 1},
    # An open stream counts as a request; the service itself answers 503 at its own limits.
    max_ongoing_requests=128,
    autoscaling_config={"min_replicas": 1, "max_replicas": 8, "target_ongoing_requests": 8},
    health_check_period_s=5,
    graceful_shutdown_wait_loop_s=0.5,
    graceful_shutdown_timeout_s=GRACE + FAREWELL,
)(serve.ingress(replica_app)(Replica))

app = deployment.bind()

"""A Ray cluster of one node and the service's replicas on it, as Ray itself lists them."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ray
from ray import serve
from ray._private import worker
from ray.serve.context import _get_global_client

APP = "default"
NAME = "neuralmusic"
OBJECT_STORE_BYTES = 100 * 2**20
LANE_S = 60.0
"""Seconds after which something that Ray should have done fails the test"""
ENVIRONMENT = {
    # Ray tells nobody of these tests, and writes no token into the home folder.
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_AUTH_MODE": "disabled",
    # It counts requests every half second instead of every ten.
    "RAY_SERVE_REPLICA_AUTOSCALING_METRIC_PUSH_INTERVAL_S": "0.5",
    "RAY_SERVE_HANDLE_AUTOSCALING_METRIC_PUSH_INTERVAL_S": "0.5",
}


@contextmanager
def cluster(cpus: int = 2) -> Iterator[None]:
    """A cluster of one node, and nothing of it afterwards."""
    before = {name: os.environ.get(name) for name in ENVIRONMENT}
    os.environ.update(ENVIRONMENT)
    try:
        ray.init(
            address="local",
            num_cpus=cpus,
            include_dashboard=False,
            object_store_memory=OBJECT_STORE_BYTES,
            log_to_driver=False,
            logging_level="error",
        )
        yield
    finally:
        ray.shutdown()
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@dataclass(frozen=True)
class Replica:
    """One replica that serves."""

    id: str
    pid: int
    actor: str
    """Name of the replica among Ray's actors"""

    @property
    def requests(self) -> int:
        """Number of requests that Ray counts as running on the replica."""
        actor = ray.get_actor(self.actor, namespace="serve")
        return int(ray.get(actor.get_num_ongoing_requests.remote(), timeout=LANE_S))

    @property
    def log(self) -> str:
        """Log in which Ray Serve writes every request that this replica answered."""
        folder = Path(worker._global_node.get_session_dir_path(), "logs", "serve")
        return (folder / f"replica_{APP}_{NAME}_{self.id}.log").read_text()


@dataclass(frozen=True)
class Deployed:
    """The service behind Ray Serve's proxy."""

    url: str

    def deploy(self, **options: Any) -> None:
        """Deploy ``service.ray_app`` with other options than its own; waits until it serves."""
        from service import ray_app

        serve.run(ray_app.deployment.options(**options).bind(), name=APP)

    def replicas(self) -> list[Replica]:
        """Those that serve now."""
        details = _get_global_client().get_serve_details()
        listed = details["applications"][APP]["deployments"][NAME]["replicas"]
        return [
            Replica(each["replica_id"], each["pid"], each["actor_name"])
            for each in listed
            if each["state"] == "RUNNING"
        ]


@contextmanager
def deployed() -> Iterator[Deployed]:
    """Two replicas of the service, on the cluster that runs."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    serve.start(http_options={"host": "127.0.0.1", "port": port})
    try:
        service = Deployed(f"http://127.0.0.1:{port}")
        service.deploy(num_replicas=2, autoscaling_config=None)
        yield service
    finally:
        serve.shutdown()


def until(condition: Callable[[], Any], meanwhile: Callable[[], object]) -> Any:
    """Do something until a condition is true, at most ``LANE_S``; gives what it then was."""
    end = time.monotonic() + LANE_S
    while not (found := condition()):
        assert time.monotonic() < end, "Ray did not do it in time"
        meanwhile()
    return found

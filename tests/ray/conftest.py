"""Ray for real: two CPUs on one node, the service's replicas behind its proxy."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

# Not "ray" alone: this folder has that name, too.
pytest.importorskip("ray.serve", reason="needs Ray: pip install 'neuralmusic[ray]'")

import ray_cluster
from ray_cluster import Deployed


@pytest.fixture(scope="session")
def cluster() -> Iterator[None]:
    with ray_cluster.cluster():
        yield


@pytest.fixture(scope="module")
def deployed(cluster: None) -> Iterator[Deployed]:
    with ray_cluster.deployed() as service:
        yield service

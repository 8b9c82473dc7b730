"""Ray for real: two CPUs on one node, the service's replicas behind its proxy.

Modules here ask for ``ray.serve``, not for ``ray`` alone: this folder has that name, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from ray_cluster import Deployed


@pytest.fixture(scope="session")
def cluster() -> Iterator[None]:
    import ray_cluster

    with ray_cluster.cluster():
        yield


@pytest.fixture(scope="module")
def deployed(cluster: None) -> Iterator[Deployed]:
    import ray_cluster

    with ray_cluster.deployed() as service:
        yield service

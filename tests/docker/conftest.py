"""An engine and the images for the lane ``docker``; where there is none, the lane says why."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from container_engine import docker, engine
from container_images import BASE, SERVICE, build_service, provide
from running_containers import Container

RunContainer = Callable[..., Container]


@pytest.fixture(scope="session")
def running_engine() -> Iterator[None]:
    with engine() as missing:
        if missing is not None:
            pytest.skip(missing)
        yield


@pytest.fixture(scope="session")
def provided(running_engine: None) -> Callable[[str], None]:
    """Provides an image, or skips."""

    def have(image: str) -> None:
        missing = provide(image)
        if missing is not None:
            pytest.skip(missing)

    return have


@pytest.fixture(scope="session")
def image(provided: Callable[[str], None]) -> str:
    """The service's image, built from this tree."""
    provided(BASE)
    build_service()
    return SERVICE


@pytest.fixture
def run_container(image: str) -> Iterator[RunContainer]:
    """``docker run`` with further words; the containers are gone after the test."""
    started: list[Container] = []

    def start(*words: str, command: tuple[str, ...] = ()) -> Container:
        publish = ("-p", "127.0.0.1:0:8000")
        started.append(Container(docker("run", "-d", *publish, *words, image, *command).strip()))
        return started[-1]

    yield start
    for each in started:
        docker("rm", "-f", each.id)

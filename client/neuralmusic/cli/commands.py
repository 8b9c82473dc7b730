"""The installed commands: this package's own, and those that entry points name."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol

from neuralmusic.cli import arrays, stream

GROUP = "neuralmusic.commands"
"""Group of entry points that name modules with commands"""
OF_THE_SERVICE = ("serve", "localize", "batch", "check", "noise", "bundle", "bench", "key")
"""Commands that ``neuralmusic-service`` adds"""
INSTALLING = "pip install ./client . in the project's folder, with Python 3.11 or newer"


class Command(Protocol):
    """A command's module."""

    NAME: str
    SUMMARY: str

    @property
    def configure(self) -> Callable[[argparse.ArgumentParser], None]: ...

    @property
    def run(self) -> Callable[[argparse.Namespace], int]: ...


def installed_commands() -> dict[str, Command]:
    """Every command by name, the service's first."""
    found: dict[str, Command] = {point.name: point.load() for point in _entry_points()}
    ordered = sorted(found, key=lambda name: (*OF_THE_SERVICE, name).index(name))
    return {**{name: found[name] for name in ordered}, stream.NAME: stream, arrays.NAME: arrays}


def missing_commands() -> list[str]:
    """The service's commands that are not installed."""
    found = {point.name for point in _entry_points()}
    return [name for name in OF_THE_SERVICE if name not in found]


def _entry_points() -> Iterator[EntryPoint]:
    if sys.version_info >= (3, 10):
        yield from entry_points(group=GROUP)
    else:
        yield from entry_points().get(GROUP, ())

"""Faults of a data set on disk: found by ``verify``, raised by the loaders."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

FaultCode = Literal["missing", "count", "audio", "channels", "sample_rate", "annotation"]
"""Kinds of faults, in this order: a file or folder is missing; fewer or more files than published;
audio cannot be decoded; another number of channels; another sample rate; an annotation is empty,
malformed or impossible"""

REMEDY = "unpack or download the file again"


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault, in the file or folder that has it."""

    code: FaultCode
    path: Path
    detail: str
    """The problem and its remedy"""

    def __str__(self) -> str:
        return f"{self.path}: {self.detail}"


class DatasetError(ValueError):
    """A data set cannot be read; ``fault`` says why."""

    def __init__(self, code: FaultCode, path: Path, detail: str) -> None:
        self.fault = Fault(code, path, detail)
        super().__init__(str(self.fault))


@dataclass(frozen=True, slots=True)
class Count:
    """A number of things on disk, beside the number that the data set's authors published."""

    what: str
    found: int
    published: tuple[int, ...]
    """Numbers in a whole download, one per version of the data set; empty if none is published"""
    exact: bool = True
    """False if the published number is rounded, or its way of counting is unknown"""

    @property
    def complete(self) -> bool:
        return not self.exact or not self.published or self.found in self.published

    def __str__(self) -> str:
        if not self.published:
            return f"{self.found:,} {self.what}"
        expected = " or ".join(f"{number:,}" for number in self.published)
        return f"{self.found:,} {self.what}, published {'' if self.exact else 'about '}{expected}"


def collect(checks: Iterable[Callable[[], object]]) -> list[Fault]:
    """Run every check and gather the faults of those that raise DatasetError."""
    faults = []
    for check in checks:
        try:
            check()
        except DatasetError as error:
            faults.append(error.fault)
    return faults


def miscounts(folder: Path, counts: Iterable[Count]) -> list[Fault]:
    """A fault for every count that is not a published one."""
    return [
        Fault("count", folder, f"{count}: unpack the whole download, or know that you use a part")
        for count in counts
        if not count.complete
    ]


def require(path: Path, remedy: str) -> Path:
    """The path, or DatasetError where nothing is there."""
    if not path.exists():
        raise DatasetError("missing", path, f"is missing: {remedy}")
    return path

"""The recordings that patterns name, and the key by which a changed file is noticed."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from neuralmusic.errors import InvalidOption

Key = tuple[str, int, int]
"""Path, bytes, milliseconds: equal where a file has not changed"""


@dataclass(frozen=True, slots=True)
class FoundRecording:
    """A file as it was found."""

    path: str
    """Path as the pattern names it"""
    size_bytes: int
    modified_ms: int
    """Milliseconds since 1970; JSON readers would round nanoseconds"""
    place: Path
    """Absolute path, for processes in other folders"""

    @property
    def key(self) -> Key:
        """The key of this file in its present state."""
        return self.path, self.size_bytes, self.modified_ms


def find_recordings(patterns: Iterable[str], besides: Sequence[Path] = ()) -> list[FoundRecording]:
    """The files that match any of the patterns, each once, sorted by path.

    Parameters
    ----------
    patterns : iterable of str
        Paths, or patterns with ``*``, ``?``, ``[...]`` and ``**`` for folders in folders.
    besides : sequence of Path
        Files that are not recordings: the result itself.

    Raises
    ------
    InvalidOption
        If a pattern matches no file.
    """
    left_out = {path.resolve() for path in besides}
    found: dict[str, FoundRecording] = {}
    for pattern in patterns:
        # A file whose own name has brackets in it is not a pattern.
        paths = [pattern] if Path(pattern).is_file() else glob.glob(pattern, recursive=True)
        files = [path for path in paths if Path(path).is_file()]
        if not files:
            raise InvalidOption(_nothing(pattern))
        for path in files:
            place = Path(path).absolute()
            if place.resolve() not in left_out:
                found[path] = _found(path, place)
    return [found[path] for path in sorted(found)]


def _found(path: str, place: Path) -> FoundRecording:
    status = place.stat()
    # JSON is UTF-8, names of files need not be.
    name = os.fsencode(path).decode(errors="replace")
    return FoundRecording(name, status.st_size, status.st_mtime_ns // 1_000_000, place)


def _nothing(pattern: str) -> str:
    if Path(pattern).is_dir():
        inside = Path(pattern, "**", "*.wav")
        return f"{pattern} is a folder: give a pattern of files in it, as '{inside}'"
    advice = "check the folder and the ending" if glob.has_magic(pattern) else "check the path"
    return f"no file matches {pattern!r}: {advice}; '**/*.wav' also takes folders in folders"

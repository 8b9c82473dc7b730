"""Chunks of simulated rooms, in memory and on disk."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Self

import numpy as np

from service.doa.types import FloatArray


@dataclass(frozen=True, slots=True)
class RoomChunk:
    """R rooms, each with one array of N microphones and S source positions."""

    responses: FloatArray
    """(R, S, N, K) float16 impulse responses at 16 kHz, scaled to a peak of 1 for each source"""
    positions: FloatArray
    """(R, N, 3) nominal microphone positions in metres; responses are from positions 1 mm off"""
    azimuth: FloatArray
    """(R, S) radians"""
    elevation: FloatArray
    """(R, S) radians"""
    distance: FloatArray
    """(R, S) metres from the array's centre"""
    diffuse: FloatArray
    """(R, N, T) float16 white noise of a diffuse field"""
    room: FloatArray
    """(R, 8): size and array centre (3 each, metres), image order (-1: RT60 instead), RT60 (s)"""

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a chunk from a file of ``write``."""
        with np.load(path) as arrays:
            return cls(**arrays)

    def write(self, path: Path) -> None:
        """Write one ``.npz`` file; an interruption leaves no ``.npz`` at ``path``."""
        unfinished = path.with_suffix(".part.npz")
        np.savez(unfinished, **{each.name: getattr(self, each.name) for each in fields(self)})
        unfinished.rename(path)


class RoomBank:
    """Chunks of simulated rooms on disk (``rooms.write_room_bank``), drawn one at a time."""

    def __init__(self, folder: Path, *, validation: bool = False) -> None:
        paths = sorted(p for p in folder.glob("*.npz") if not p.name.endswith(".part.npz"))
        # One chunk in twenty only validates; in a smaller bank, as of tests, every chunk does both.
        if len(paths) >= 20:
            paths = [p for p in paths if (int(p.stem) % 20 == 19) == validation]
        self.paths = paths
        if not self.paths:
            raise FileNotFoundError(f"no room chunks in {folder}: run 'model_export rooms' first")

    def chunk(self, rng: np.random.Generator) -> RoomChunk:
        """Draw one whole chunk; its rooms share the microphone count."""
        return RoomChunk.read(self.paths[rng.integers(len(self.paths))])

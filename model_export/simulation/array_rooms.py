"""Rooms around one given array, simulated as they are needed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model_export.simulation import rooms
from model_export.simulation.room_bank import RoomChunk
from service.doa.array import MicrophoneArray

RESPONSE_SAMPLES = 4096
"""0.26 s; the reflections of order 4 in a room of 10 m have passed by then"""
HIGHEST_ORDER = 12
"""Of rooms with an RT60: about 0.1 s of reflections, nine tenths of their energy at 0.6 s, for a
twentieth of the time that all of them take"""
PAPER_SHARE = 0.25
"""Rooms of the paper's kind beyond those that ``rooms.random_room`` draws, a quarter of its own"""
DIFFUSE_FIELDS = 4


@dataclass(frozen=True, slots=True)
class ArrayRooms:
    """An endless supply of rooms, all with the same array."""

    array: MicrophoneArray

    def chunk(self, rng: np.random.Generator) -> RoomChunk:
        """New rooms, different at every call."""
        return simulate_array_chunk(int(rng.integers(2**63)), self.array)


def simulate_array_chunk(seed: int, array: MicrophoneArray) -> RoomChunk:
    """Rooms of every kind with the same array.

    Of 100, 44 are the paper's 7 x 7 x 3 m room with rigid walls and order 0 to 4, 17 others with
    rigid walls and 39 have an RT60. They take half a second, so that they need not be kept on disk.
    """
    rng = np.random.default_rng(seed)
    simulated = []
    for _ in range(rooms.CHUNK_ROOMS):
        paper = rng.random() < PAPER_SHARE
        room = rooms.paper_room(int(rng.integers(5))) if paper else rooms.random_room(rng)
        _, one = rooms.simulate_room(rng, room, array.positions, RESPONSE_SAMPLES, HIGHEST_ORDER)
        simulated.append(one)
    # The slowest part by far; scenes shift the noise in time, so that few fields go a long way.
    fields = [rooms.diffuse_field(rng, array.positions) for _ in range(DIFFUSE_FIELDS)]
    diffuse = [fields[index % DIFFUSE_FIELDS] for index in range(rooms.CHUNK_ROOMS)]
    return rooms.chunk_of(simulated, diffuse)

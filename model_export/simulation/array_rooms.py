"""Rooms around one given array, simulated on demand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model_export.simulation import rooms
from model_export.simulation.room_bank import RoomChunk
from service.doa.array import MicrophoneArray

RESPONSE_SAMPLES = 4096
"""Kept length of a response, 0.26 s: longer than reflections of order 4 take in a 10 m room"""
HIGHEST_ORDER = 12
"""Cap on the image order of rooms with an RT60: about 0.1 s of reflections, which hold nine tenths
of the energy at an RT60 of 0.6 s and take a twentieth of the computing time"""
PAPER_SHARE = 0.25
"""Share of the paper's room, besides its quarter among ``rooms.random_room``"""
DIFFUSE_FIELDS = 4


@dataclass(frozen=True, slots=True)
class ArrayRooms:
    """An endless supply of rooms, all with the same array."""

    array: MicrophoneArray

    def chunk(self, rng: np.random.Generator) -> RoomChunk:
        """Simulate new rooms, different at every call."""
        return simulate_array_chunk(int(rng.integers(2**63)), self.array)


def simulate_array_chunk(seed: int, array: MicrophoneArray) -> RoomChunk:
    """Simulate rooms of every kind with the same array.

    Of 100, 44 are the paper's 7 x 7 x 3 m room with rigid walls and order 0 to 4, 17 others with
    rigid walls and 39 have an RT60. A chunk takes half a second, so none is kept on disk.
    """
    rng = np.random.default_rng(seed)
    simulated = []
    for _ in range(rooms.CHUNK_ROOMS):
        paper = rng.random() < PAPER_SHARE
        room = rooms.paper_room(int(rng.integers(5))) if paper else rooms.random_room(rng)
        _, one = rooms.simulate_room(rng, room, array.positions, RESPONSE_SAMPLES, HIGHEST_ORDER)
        simulated.append(one)
    # By far the slowest part; scenes shift the noise in time, so a few fields suffice.
    fields = [rooms.diffuse_field(rng, array.positions) for _ in range(DIFFUSE_FIELDS)]
    diffuse = [fields[index % DIFFUSE_FIELDS] for index in range(rooms.CHUNK_ROOMS)]
    return rooms.chunk_of(simulated, diffuse)

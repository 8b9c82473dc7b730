"""Rooms around one given array, simulated as they are needed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from model_export.simulation import rooms
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

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

    def chunk(self, rng: np.random.Generator) -> dict[str, FloatArray]:
        """New rooms, different at every call."""
        return simulate_array_chunk(int(rng.integers(2**63)), self.array)


def simulate_array_chunk(seed: int, array: MicrophoneArray) -> dict[str, FloatArray]:
    """Rooms of every kind with the same array.

    Of 100, 44 are the paper's 7 x 7 x 3 m room with rigid walls and order 0 to 4, 17 others with
    rigid walls and 39 have an RT60. They take half a second, so that they need not be kept on disk.

    Returns
    -------
    chunk : dict
        As ``rooms.simulate_chunk`` gives, without ``elevation`` and ``room``.
    """
    rng = np.random.default_rng(seed)
    responses, azimuths, distances, diffuse = [], [], [], []
    for _ in range(rooms.CHUNK_ROOMS):
        paper = rng.random() < PAPER_SHARE
        room = rooms.paper_room(int(rng.integers(5))) if paper else rooms.random_room(rng)
        sources, azimuth, _, distance = rooms.place_sources(rng, room, rooms.SOURCES_PER_ROOM)
        jittered = array.positions + rng.normal(scale=0.001, size=array.positions.shape)
        simulated = rooms.impulse_responses(
            room, jittered, sources, longest=RESPONSE_SAMPLES, highest_order=HIGHEST_ORDER
        )
        peaks = np.abs(simulated).max(axis=(1, 2), keepdims=True)
        responses.append((simulated / peaks).astype(np.float16))
        azimuths.append(azimuth)
        distances.append(distance)
    # The slowest part by far; scenes shift the noise in time, so that few fields go a long way.
    for _ in range(DIFFUSE_FIELDS):
        noise = rooms.diffuse_noise(rng, array.positions, rooms.NOISE_SAMPLES)
        diffuse.append((0.1 * noise).astype(np.float16))
    return {
        "responses": np.stack(responses),
        "positions": np.repeat(array.positions[None], rooms.CHUNK_ROOMS, axis=0),
        "azimuth": np.stack(azimuths),
        "distance": np.stack(distances),
        "diffuse": np.stack(diffuse)[np.arange(rooms.CHUNK_ROOMS) % DIFFUSE_FIELDS],
    }

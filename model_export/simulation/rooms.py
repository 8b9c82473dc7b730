"""Rooms: seeded room impulse responses by the image-source method (pyroomacoustics).

A room is one array at one place with a few source positions. Responses are simulated once and
kept in chunk files: they cost a thousand times more than the convolutions with speech that
training repeats.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyroomacoustics as pra
from rich.progress import track

from model_export import SAMPLE_RATE
from model_export.simulation.arrays import random_array
from model_export.simulation.room_bank import RoomChunk
from service.doa.array import SPEED_OF_SOUND
from service.doa.steering import unit_vectors
from service.doa.types import FloatArray

RESPONSE_SAMPLES = 8000
"""Kept length of a response, 0.5 s; the tail that is cut is at least 30 dB down"""
MAX_ORDER = 45
"""Cap on the image order: beyond it the cost explodes and the tail is diffuse anyway"""
CHUNK_ROOMS = 32
SOURCES_PER_ROOM = 4
NOISE_SAMPLES = 16640
NUM_WAVES = 48
"""Plane waves of a diffuse field"""


@dataclass(frozen=True, slots=True)
class RoomSpec:
    """A shoebox room with either rigid walls and a maximum image order, or an RT60."""

    size: tuple[float, float, float]
    """Length, width and height in metres"""
    centre: tuple[float, float, float]
    """Array centre in metres"""
    max_order: int | None = None
    """Image order with rigid walls, as in the paper's protocol"""
    rt60: float | None = None
    """Seconds; 0 is an anechoic room"""


PAPER_ROOM_SIZE = (7.0, 7.0, 3.0)
PAPER_ARRAY_CENTRE = (3.0, 3.0, 1.0)


def paper_room(max_order: int) -> RoomSpec:
    """The paper's 7 x 7 x 3 m room with rigid walls and the array at (3, 3, 1)."""
    return RoomSpec(PAPER_ROOM_SIZE, PAPER_ARRAY_CENTRE, max_order=max_order)


def impulse_responses(
    room: RoomSpec,
    positions: FloatArray,
    sources: FloatArray,
    *,
    longest: int | None = None,
    highest_order: int = MAX_ORDER,
) -> FloatArray:
    """Impulse responses from every source to every microphone.

    Parameters
    ----------
    room : RoomSpec
    positions : (N, 3) float
        Microphones relative to the array centre, metres.
    sources : (S, 3) float
        Sources relative to the array centre, metres.
    longest : int, optional
        Number of samples T to cut or pad to; by default that of the longest response.
    highest_order : int
        Cap on the image order of a room with an RT60.

    Returns
    -------
    responses : (S, N, T) float32
    """
    if room.max_order is not None:
        shoebox = pra.ShoeBox(room.size, fs=SAMPLE_RATE, max_order=room.max_order)
    elif room.rt60:
        absorption, order = pra.inverse_sabine(room.rt60, room.size)
        shoebox = pra.ShoeBox(
            room.size,
            fs=SAMPLE_RATE,
            materials=pra.Material(absorption),
            max_order=min(order, highest_order),
        )
    else:
        shoebox = pra.ShoeBox(room.size, fs=SAMPLE_RATE, max_order=0)
    centre = np.asarray(room.centre)
    shoebox.add_microphone_array((positions + centre).T)
    for source in sources:
        shoebox.add_source(source + centre)
    shoebox.compute_rir()
    length = longest or max(len(rir) for rirs in shoebox.rir for rir in rirs)
    responses = np.zeros((len(sources), len(positions), length), dtype=np.float32)
    for microphone, rirs in enumerate(shoebox.rir):
        for source, rir in enumerate(rirs):
            kept = rir[:length]
            responses[source, microphone, : len(kept)] = kept
    return responses


def random_room(rng: np.random.Generator) -> RoomSpec:
    """A random room: half have rigid walls and a low order, half an RT60 of up to 0.8 s."""
    if rng.random() < 0.25:
        return paper_room(int(rng.integers(0, 5)))
    size = (rng.uniform(3, 10), rng.uniform(3, 8), rng.uniform(2.4, 4.0))
    centre = tuple(
        rng.uniform(min(0.8, 0.3 * side), max(side - 0.8, 0.7 * side)) for side in size[:2]
    )
    spec_centre = (centre[0], centre[1], rng.uniform(0.4, 1.6))
    if rng.random() < 0.3:
        return RoomSpec(size, spec_centre, max_order=int(rng.integers(0, 5)))
    # Sabine's formula has no solution for a very short RT60 in a large room.
    shortest = 0.16 * np.prod(size) / _surface(size) + 0.05
    return RoomSpec(size, spec_centre, rt60=float(rng.uniform(shortest, 0.8)))


def _surface(size: Sequence[float]) -> float:
    x, y, z = size
    return 2 * (x * y + y * z + z * x)


def place_sources(
    rng: np.random.Generator, room: RoomSpec, count: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Draw sources inside the room, azimuths uniform, elevations mostly near the horizon.

    Returns
    -------
    sources : (S, 3) float
        Positions relative to the array centre, metres.
        azimuth, elevation, distance : (S,) float
        Radians and metres.
    """
    low = 0.15 - np.asarray(room.centre)
    high = np.asarray(room.size) - 0.15 - np.asarray(room.centre)
    sources: list[FloatArray] = []
    angles: list[tuple[float, float, float]] = []
    while len(sources) < count:
        azimuth = rng.uniform(0, 2 * np.pi)
        elevation = 0.0 if rng.random() < 0.4 else np.deg2rad(rng.uniform(-20, 50))
        distance = rng.uniform(0.5, 3.0)
        source = distance * unit_vectors(np.array(azimuth), float(elevation))
        if (source > low).all() and (source < high).all():
            sources.append(source)
            angles.append((azimuth, elevation, distance))
    azimuths, elevations, distances = np.array(angles).T
    return np.array(sources), azimuths, elevations, distances


def diffuse_noise(
    rng: np.random.Generator, positions: FloatArray, num_samples: int, num_waves: int = NUM_WAVES
) -> FloatArray:
    """Diffuse field (N, T) float32: independent white plane waves from the whole sphere."""
    directions = isotropic_directions(rng, num_waves)
    return superpose(positions, directions, rng.normal(size=(num_waves, num_samples)))


def isotropic_directions(rng: np.random.Generator, num_waves: int = NUM_WAVES) -> FloatArray:
    """Unit vectors (K, 3), uniformly random on the sphere."""
    elevation = np.arcsin(rng.uniform(-1, 1, num_waves))
    return unit_vectors(rng.uniform(0, 2 * np.pi, num_waves), elevation)


def superpose(positions: FloatArray, directions: FloatArray, signals: FloatArray) -> FloatArray:
    """Microphone signals (N, T) float32 of plane waves, with the waves' mean power.

    Parameters
    ----------
    positions : (N, 3) float
        Microphone positions, metres.
        directions : (K, 3) float
        Unit vectors towards the waves' origins.
    signals : (K, T) float
        Signal of each wave; its delays are circular.
    """
    waves, num_samples = signals.shape
    delays = positions @ directions.T / SPEED_OF_SOUND  # (N, K) seconds
    spectra = np.fft.rfft(signals, axis=-1)
    omega = 2 * np.pi * np.fft.rfftfreq(num_samples, 1 / SAMPLE_RATE)
    mixed = np.zeros((len(positions), omega.size), dtype=complex)
    for wave in range(waves):
        mixed += np.exp(1j * omega * delays[:, wave, None]) * spectra[wave]
    noise = np.fft.irfft(mixed, num_samples, axis=-1) / np.sqrt(waves)
    return noise.astype(np.float32)


def simulate_chunk(seed: int) -> RoomChunk:
    """Simulate ``CHUNK_ROOMS`` random rooms whose arrays share one microphone count."""
    rng = np.random.default_rng([seed, 20260])
    microphones = int(rng.choice([3, 4, 4, 4, 5, 6, 6, 7, 8]))
    simulated, diffuse = [], []
    for _ in range(CHUNK_ROOMS):
        array = random_array(rng, microphones)
        jittered, room = simulate_room(rng, random_room(rng), array.positions, RESPONSE_SAMPLES)
        simulated.append(room)
        diffuse.append(diffuse_field(rng, jittered))
    return chunk_of(simulated, diffuse)


def simulate_room(
    rng: np.random.Generator,
    room: RoomSpec,
    positions: FloatArray,
    longest: int,
    highest_order: int = MAX_ORDER,
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """The array's jittered positions (N, 3), and fields of ``RoomChunk`` without ``diffuse``."""
    sources, azimuth, elevation, distance = place_sources(rng, room, SOURCES_PER_ROOM)
    jittered = positions + rng.normal(scale=0.001, size=positions.shape)
    responses = impulse_responses(
        room, jittered, sources, longest=longest, highest_order=highest_order
    )
    peaks = np.abs(responses).max(axis=(1, 2), keepdims=True)
    order = -1 if room.max_order is None else room.max_order
    return jittered, {
        "responses": (responses / peaks).astype(np.float16),
        "positions": positions,
        "azimuth": azimuth,
        "elevation": elevation,
        "distance": distance,
        "room": np.array([*room.size, *room.centre, order, room.rt60 or 0.0]),
    }


def diffuse_field(rng: np.random.Generator, positions: FloatArray) -> FloatArray:
    """Diffuse field (N, T) float16 of one room, for ``RoomChunk.diffuse``."""
    return (0.1 * diffuse_noise(rng, positions, NOISE_SAMPLES)).astype(np.float16)


def chunk_of(rooms: Sequence[dict[str, FloatArray]], diffuse: Sequence[FloatArray]) -> RoomChunk:
    """Stack rooms from ``simulate_room``, each with a diffuse field, to a chunk."""
    stacked = {key: np.stack([room[key] for room in rooms]) for key in rooms[0]}
    return RoomChunk(**stacked, diffuse=np.stack(diffuse))


def _write_chunk(folder: Path, seed: int) -> None:
    path = folder / f"{seed:05d}.npz"
    if not path.exists():
        simulate_chunk(seed).write(path)


def write_room_bank(folder: Path, num_chunks: int, *, workers: int = 1) -> None:
    """Write chunks 0 to ``num_chunks`` - 1 into ``folder``; existing ones are kept."""
    folder.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(workers) as pool:
        futures = [pool.submit(_write_chunk, folder, seed) for seed in range(num_chunks)]
        for future in track(futures, description="simulating rooms"):
            future.result()

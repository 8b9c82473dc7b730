"""Scenes for evaluation and for users: seeded protocols, with metadata beside them.

Training draws its scenes from a bank of rooms (``scenes``); here every scene has its own room, no
random imperfection, and a JSON sidecar that says all there is to know about it. As in the paper a
talker says one word from the window's beginning, or speaks on without a pause.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import soundfile
from rich.progress import track

from model_export import SAMPLE_RATE
from model_export.simulation.arrays import named_array
from model_export.simulation.noise import unit_power
from model_export.simulation.rooms import RoomSpec, impulse_responses, paper_room
from model_export.simulation.running_speech import active_power, mean_power, running_speech
from model_export.simulation.scenes import WINDOW_SAMPLES, convolve
from service.doa.array import MicrophoneArray
from service.doa.sphere import angle_between
from service.doa.steering import unit_vectors
from service.doa.types import FloatArray

VOICED_DB = 20.0


MOST_TRIES = 100_000
"""Draws until sources count as impossible to place; four take a dozen"""


@dataclass(frozen=True, slots=True)
class SceneProtocol:
    """Fixed and drawn properties of a set of scenes."""

    num_sources: int = 1
    array: str = "respeaker-usb-4mic-v2"
    """A preset or one of ``arrays.TEST_ARRAYS``"""
    room: RoomSpec | None = None
    """None is the paper's room with the orders below"""
    orders: tuple[int, int] = (4, 4)
    """Smallest and largest image order of the paper's room"""
    snr_db: float = 30.0
    """White sensor noise against one source's power"""
    distance: tuple[float, float] = (0.5, 2.0)
    """Metres from the array, drawn for every source on its own"""
    min_separation_deg: float = 10.0
    separation_deg: float | None = None
    """Fixed angle between two sources; None draws it"""
    azimuths_deg: tuple[float, ...] | None = None
    """Directions to draw from; None draws from the full circle"""
    elevations_deg: tuple[float, float] = (0.0, 0.0)
    """Lowest and highest elevation, drawn for every source on its own"""
    continuous: bool = False
    """Talkers speak before, throughout and after the window, not one word from its beginning"""
    num_samples: int = WINDOW_SAMPLES
    """Samples of the window"""


@dataclass(frozen=True, slots=True)
class SimulatedScene:
    """Audio and its ground truth."""

    audio: FloatArray
    """(N, T) float32"""
    array: MicrophoneArray
    azimuth: FloatArray
    """(M,) radians"""
    elevation: FloatArray
    """(M,) radians above the array's horizontal plane"""
    voiced: bool
    """Every talker speaks in the window: there the dry speech is not ``VOICED_DB`` below its own
    active level"""
    metadata: dict[str, Any]


def simulate_scene(
    protocol: SceneProtocol,
    speech: Sequence[FloatArray],
    seed: Sequence[int],
    *,
    array: MicrophoneArray | None = None,
) -> SimulatedScene:
    """One scene; the same seed gives the same scene.

    Every source has unit power at the first microphone (over its utterance, or over at least
    ``WINDOW_SAMPLES`` of continuous speech from the window's beginning) and the noise has that of
    one source times ``num_sources`` less the SNR, as pyroomacoustics' ``simulate(snr=...)`` and the
    paper have it.
    """
    rng = np.random.default_rng(list(seed))
    array = array or named_array(protocol.array)
    room = protocol.room or paper_room(
        int(rng.integers(protocol.orders[0], protocol.orders[1] + 1))
    )
    azimuth, elevation, distance = _place(rng, protocol, room)
    sources = distance[:, None] * unit_vectors(azimuth, elevation)
    responses = impulse_responses(room, array.positions, sources)
    clips = rng.integers(len(speech), size=protocol.num_sources)
    audio = np.zeros((array.num_microphones, protocol.num_samples), dtype=np.float32)
    voiced = True
    for source, clip in enumerate(clips):
        dry, start = _utterance(rng, protocol, speech[clip], responses.shape[-1])
        end = len(dry) if protocol.continuous else None
        wet = unit_power(convolve(dry, responses[source])[:, start:end])
        wet = wet[:, : protocol.num_samples]
        audio[:, : wet.shape[1]] += wet
        heard = dry[start : start + protocol.num_samples]
        voiced = voiced and mean_power(heard) >= 10 ** (-VOICED_DB / 10) * active_power(dry)
    sigma = np.sqrt(max(1, protocol.num_sources) * 10 ** (-protocol.snr_db / 10))
    audio += np.float32(sigma) * rng.standard_normal(audio.shape, dtype=np.float32)
    metadata = {
        "seed": list(seed),
        "azimuth_deg": np.rad2deg(azimuth).round(3).tolist(),
        "elevation_deg": np.rad2deg(elevation).round(3).tolist(),
        "distance_m": distance.round(3).tolist(),
        "clips": clips.tolist(),
        "snr_db": protocol.snr_db,
        "room": asdict(room),
        "array": {"name": array.name, "positions_m": array.positions.tolist()},
        "voiced": voiced,
        "sample_rate": SAMPLE_RATE,
    }
    return SimulatedScene(audio, array, azimuth, elevation, voiced, metadata)


def write_scenes(
    folder: Path, protocol: SceneProtocol, speech: Sequence[FloatArray], count: int, seed: int
) -> None:
    """Write ``scene_00000.wav`` and so on, each with a JSON sidecar, scaled to -6 dBFS."""
    folder.mkdir(parents=True, exist_ok=True)
    for index in track(range(count), description="simulating scenes"):
        scene = simulate_scene(protocol, speech, [seed, index])
        scale = 0.5 / np.abs(scene.audio).max()
        path = folder / f"scene_{index:05d}.wav"
        soundfile.write(path, (scale * scene.audio).T, SAMPLE_RATE, subtype="PCM_16")
        path.with_suffix(".json").write_text(json.dumps(scene.metadata, indent=2) + "\n")


def _utterance(
    rng: np.random.Generator, protocol: SceneProtocol, clip: FloatArray, lead: int
) -> tuple[FloatArray, int]:
    """Dry speech and where in it the window begins: after ``lead`` samples of continuous speech."""
    if not protocol.continuous:
        return clip, 0
    return running_speech(rng, clip, lead + max(protocol.num_samples, WINDOW_SAMPLES)), lead


def _place(
    rng: np.random.Generator, protocol: SceneProtocol, room: RoomSpec
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Azimuths, elevations and distances (M,) of sources inside the room and far enough apart."""
    count = protocol.num_sources
    low = 0.1 - np.asarray(room.centre)
    high = np.asarray(room.size) - 0.1 - np.asarray(room.centre)
    for _ in range(MOST_TRIES):
        if protocol.azimuths_deg is None:
            azimuth = rng.uniform(0, 2 * np.pi, count)
        else:
            azimuth = np.deg2rad(rng.choice(protocol.azimuths_deg, count))
        if protocol.separation_deg is not None and count == 2:
            azimuth[1] = (azimuth[0] + np.deg2rad(protocol.separation_deg)) % (2 * np.pi)
        distance = rng.uniform(*protocol.distance, count)
        elevation = np.zeros(count)
        if any(protocol.elevations_deg):
            elevation = np.deg2rad(rng.uniform(*protocol.elevations_deg, count))
        directions = unit_vectors(azimuth, elevation)
        sources = distance[:, None] * directions
        gaps = angle_between(directions[:, None], directions[None])[np.triu_indices(count, 1)]
        if (gaps >= np.deg2rad(protocol.min_separation_deg)).all() and (
            ((sources > low) & (sources < high)).all()
        ):
            return azimuth, elevation, distance
    raise ValueError(
        f"no places for {count} sources {protocol.min_separation_deg:g} degrees apart were found "
        f"in a room of {' x '.join(f'{side:g}' for side in room.size)} m: ask for fewer"
    )

"""A simulated room and array of one's own, to measure the gain of fine-tuning.

It combines what training scenes lack: strong reflections in a small room, a steady fan below the
array, and constant errors of the microphones' positions and gains. The recordings for tuning go
once around the array with one voice each; the test has other voices at other places of the room.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy.signal
import soundfile
from rich.progress import track

from model_export import SAMPLE_RATE
from model_export.finetuning.labels import COLUMNS, LABELS
from model_export.simulation.noise import unit_power
from model_export.simulation.rooms import RoomSpec, diffuse_noise, impulse_responses
from model_export.simulation.scenes import convolve
from service.doa.array import MicrophoneArray
from service.doa.steering import unit_vectors
from service.doa.types import FloatArray

OWN_ROOM = RoomSpec((4.0, 3.0, 2.5), (2.1, 1.4, 1.0), rt60=0.5)
POSITION_ERROR = 0.002
"""Standard deviation in metres of every coordinate in the array's plane"""
GAIN_ERROR_DB = 2.0
"""Standard deviation of the microphones' gains"""
FAN = np.array([0.12, -0.08, -0.3])
"""Position of the fan in metres from the array's centre"""


def write_own_room(
    folder: Path,
    array: MicrophoneArray,
    speech: Sequence[FloatArray],
    test_speech: Sequence[FloatArray],
    *,
    directions: int = 36,
    test_recordings: int = 48,
    seconds: float = 3.0,
    snr_db: float = 10.0,
    seed: int = 1,
    room: RoomSpec = OWN_ROOM,
) -> None:
    """Write ``recordings/`` and ``test/``, each with its ``labels.csv``.

    The recordings' sources stand at even angles and 1 m, the test's at random angles and 0.6 to
    1.3 m.
    """
    rng = np.random.default_rng([seed, 36])
    hears = _Hearing(rng, array, room, snr_db)
    around = np.arange(directions) * 2 * np.pi / directions
    _write(folder / "recordings", hears, rng, around, np.full(directions, 1.0), speech, seconds)
    anywhere = rng.uniform(0, 2 * np.pi, test_recordings)
    distance = rng.uniform(0.6, 1.3, test_recordings)
    _write(folder / "test", hears, rng, anywhere, distance, test_speech, seconds)


class _Hearing:
    """The imperfect array in its room with its fan."""

    def __init__(
        self, rng: np.random.Generator, array: MicrophoneArray, room: RoomSpec, snr_db: float
    ) -> None:
        offsets = rng.normal(scale=POSITION_ERROR, size=(array.num_microphones, 3)) * [1, 1, 0]
        self.positions = array.positions + offsets
        gains = rng.normal(scale=GAIN_ERROR_DB, size=(array.num_microphones, 1))
        self.gains = (10 ** (gains / 20)).astype(np.float32)
        self.room, self.snr_db = room, snr_db
        (self.fan,) = impulse_responses(room, self.positions, FAN[None])

    def record(self, rng: np.random.Generator, source: FloatArray, voice: FloatArray) -> FloatArray:
        """Recording (N, T) float32 of a voice (T,) at a position (3,), with a peak of 0.5."""
        (response,) = impulse_responses(self.room, self.positions, source[None])
        audio = unit_power(convolve(voice, response)[:, : len(voice)])
        audio = audio + np.float32(10 ** (-self.snr_db / 20)) * self._noise(rng, len(voice))
        audio = self.gains * audio
        return 0.5 * audio / np.abs(audio).max()

    def _noise(self, rng: np.random.Generator, samples: int) -> FloatArray:
        """Noise (N, T) of fan, room and converters, of unit power."""
        hum = scipy.signal.lfilter([1], [1, -0.9], rng.standard_normal(samples + SAMPLE_RATE))
        fan = convolve(hum.astype(np.float32), self.fan)[:, SAMPLE_RATE : SAMPLE_RATE + samples]
        diffuse = diffuse_noise(rng, self.positions, samples)
        sensor = rng.standard_normal(diffuse.shape, dtype=np.float32)
        return unit_power(unit_power(fan) + 0.5 * unit_power(diffuse) + np.float32(0.2) * sensor)


def _write(
    folder: Path,
    hears: _Hearing,
    rng: np.random.Generator,
    azimuth: FloatArray,
    distance: FloatArray,
    speech: Sequence[FloatArray],
    seconds: float,
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LABELS).open("w", newline="") as file:
        labels = csv.writer(file)
        labels.writerow(COLUMNS[:2])
        places = zip(azimuth, distance, strict=True)
        for index, (angle, metres) in enumerate(track(list(places), description=folder.name)):
            source = metres * unit_vectors(np.array(angle)) + np.array([0, 0, 0.3])
            audio = hears.record(rng, source, _words(rng, speech, round(seconds * SAMPLE_RATE)))
            name = f"{index:02d}.wav"
            soundfile.write(folder / name, audio.T, SAMPLE_RATE, subtype="PCM_16")
            labels.writerow([name, f"{np.rad2deg(angle):.2f}"])


def _words(rng: np.random.Generator, speech: Sequence[FloatArray], samples: int) -> FloatArray:
    """Words one after the other, each with a short pause after it, (T,)."""
    pieces: list[FloatArray] = []
    while sum(map(len, pieces)) < samples:
        pieces.append(speech[int(rng.integers(len(speech)))])
        pieces.append(np.zeros(int(rng.uniform(0.1, 0.4) * SAMPLE_RATE), dtype=np.float32))
    return np.concatenate(pieces)[:samples]

"""False sources: sources that are reported while nobody speaks.

The recordings go through the service's own path with a request's default options, the number of
sources unknown. The score counts, per minute, the sources in the recording's summary and the
windows that report any source.
"""

from __future__ import annotations

import io
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import soundfile

from model_export import SAMPLE_RATE
from model_export.datasets.speech import Clip, load
from model_export.evaluation.cells import living_room
from model_export.evaluation.methods import CLASSICAL
from model_export.evaluation.workers import Inputs, Workers
from model_export.simulation.fan import air_noise, fan_tones
from model_export.simulation.noise import unit_power
from model_export.simulation.rooms import (
    NUM_WAVES,
    diffuse_noise,
    impulse_responses,
    isotropic_directions,
    superpose,
)
from model_export.simulation.scenes import convolve
from service.audio.recording import Recording
from service.doa.array import SPEED_OF_SOUND, MicrophoneArray
from service.doa.presets import preset
from service.doa.steering import unit_vectors
from service.doa.types import FloatArray
from service.inference.registry import BundleRegistry
from service.recordings.localize import localize_recording
from service.recordings.results import LocalizeOptions, RecordingResult

ARRAY = "respeaker-usb-4mic-v2"
LEVEL_DBFS = -35.0
"""RMS level of every noise but silence"""
BLOCK_SAMPLES = 4 * SAMPLE_RATE
"""Samples in a block of a diffuse field; each block has its own directions"""
OWN_FAN_DISTANCE = 0.10
"""Distance of the robot's own fan from the array's centre, in metres"""
ROOM_FAN_DISTANCE = 1.5
"""Distance of a fan elsewhere in the room from the array's centre, in metres"""
SENSOR_NOISE_DB = -30.0
"""Level of the sensor noise relative to the fan"""

Sound = Callable[[np.random.Generator, FloatArray, int], FloatArray]
"""Makes audio (N, T) of any level from a generator, positions (N, 3) in metres and T"""


@dataclass(frozen=True, slots=True)
class Noise:
    """A recording without any talker."""

    name: str
    sound: Sound
    seconds: float = 60.0


def silence(rng: np.random.Generator, positions: FloatArray, num_samples: int) -> FloatArray:
    """Digital silence."""
    return np.zeros((len(positions), num_samples))


def sensor_noise(rng: np.random.Generator, positions: FloatArray, num_samples: int) -> FloatArray:
    """White noise, independent at every microphone."""
    return rng.standard_normal((len(positions), num_samples))


def isotropic_noise(
    rng: np.random.Generator, positions: FloatArray, num_samples: int
) -> FloatArray:
    """White noise of a diffuse field, equal from all directions."""
    return _in_blocks(partial(diffuse_noise, rng, positions), num_samples)


def own_fan(
    elevation_deg: float, rng: np.random.Generator, positions: FloatArray, num_samples: int
) -> FloatArray:
    """The robot's own fan behind the array's centre, at a negative elevation also below it.

    Its tones come from one place; the turbulence of its air is independent at each microphone.
    """
    tones = _behind(elevation_deg, positions, fan_tones(rng, num_samples))
    turbulence = air_noise(rng, len(positions), num_samples)
    return _with_sensor_noise(rng, tones + turbulence)


def own_motor(
    elevation_deg: float, rng: np.random.Generator, positions: FloatArray, num_samples: int
) -> FloatArray:
    """A motor or an encased fan at the same place, from which all of its sound comes."""
    sound = fan_tones(rng, num_samples) + air_noise(rng, 1, num_samples)[0]
    return _with_sensor_noise(rng, _behind(elevation_deg, positions, sound))


def _behind(elevation_deg: float, positions: FloatArray, sound: FloatArray) -> FloatArray:
    """Microphone signals (N, T) of a sound (T,) at the place of the robot's own noise."""
    place = OWN_FAN_DISTANCE * unit_vectors(np.array(np.pi), np.deg2rad(elevation_deg))
    distance = np.linalg.norm(positions - place, axis=-1, keepdims=True)
    omega = 2 * np.pi * np.fft.rfftfreq(len(sound), 1 / SAMPLE_RATE)
    delayed = np.fft.rfft(sound) * np.exp(-1j * omega * distance / SPEED_OF_SOUND)
    heard: FloatArray = np.fft.irfft(delayed, len(sound), axis=-1) * OWN_FAN_DISTANCE / distance
    return heard


def room_fan(rng: np.random.Generator, positions: FloatArray, num_samples: int) -> FloatArray:
    """A fan elsewhere in a room: tones and air as one point source."""
    place = ROOM_FAN_DISTANCE * unit_vectors(rng.uniform(0, 2 * np.pi, 1))
    (responses,) = impulse_responses(living_room(0.4), positions, place)
    lead = responses.shape[-1]
    dry = fan_tones(rng, num_samples + lead) + air_noise(rng, 1, num_samples + lead)[0]
    return _with_sensor_noise(rng, convolve(dry, responses)[:, lead : lead + num_samples])


def spread_recording(
    path: Path, rng: np.random.Generator, positions: FloatArray, num_samples: int
) -> FloatArray:
    """A steady mono recording as a diffuse field: each plane wave starts at another moment."""
    (signal,) = load([Clip(path, speaker="")])

    def block(length: int) -> FloatArray:
        begins = rng.integers(len(signal), size=(NUM_WAVES, 1))
        waves = signal[(begins + np.arange(length)) % len(signal)]
        return superpose(positions, isotropic_directions(rng), waves)

    return _in_blocks(block, num_samples)


NOISES = (
    Noise("60 s of silence", silence),
    Noise("60 s of white sensor noise", sensor_noise),
    Noise("60 s of diffuse noise", isotropic_noise),
    # Tones from straight below reach all microphones of a level array at the same time.
    Noise("60 s of the robot's own fan, below", partial(own_fan, -90.0)),
    Noise("60 s of the robot's own fan, behind and below", partial(own_fan, -45.0)),
    Noise("60 s of a fan at 1.5 m, RT60 0.4 s", room_fan),
)


def recorded(paths: Sequence[Path]) -> tuple[Noise, ...]:
    """A user's steady recordings (16 kHz, mono), each spread as a diffuse field."""
    return tuple(
        Noise(f"60 s of {path.stem}, diffuse", partial(spread_recording, path)) for path in paths
    )


def count_false_sources(
    workers: Workers, noises: Sequence[Noise] = NOISES
) -> dict[str, dict[str, dict[str, float]]]:
    """Scores by noise and method, as in ``Results.cells``."""
    scores = workers.map(score_noise, noises, "noises")
    return {noise.name: found for noise, found in zip(noises, scores, strict=True)}


def score_noise(inputs: Inputs, noise: Noise) -> dict[str, dict[str, float]]:
    """False-source scores of every method that the service offers, for one noise."""
    array = preset(ARRAY)
    file = noise_file(noise, array, inputs.seed)
    registry = BundleRegistry(inputs.methods.bundles)
    options = {
        name: LocalizeOptions(array, model=name) for name in inputs.methods.localizers(array)
    }
    options |= {method: LocalizeOptions(array, method=method) for method in CLASSICAL}
    scores = {}
    for name, chosen in options.items():
        with Recording.open(file) as recording:
            scores[name] = false_source_scores(localize_recording(recording, chosen, registry))
    return scores


def noise_file(noise: Noise, array: MicrophoneArray, seed: int) -> io.BytesIO:
    """The noise as a WAV file with the array's channels."""
    rng = np.random.default_rng([seed, zlib.crc32(noise.name.encode())])
    audio = noise.sound(rng, array.positions, round(noise.seconds * SAMPLE_RATE))
    scaled = 10 ** (LEVEL_DBFS / 20) * unit_power(audio)
    file = io.BytesIO()
    soundfile.write(file, scaled.T, SAMPLE_RATE, format="WAV", subtype="PCM_16")
    file.seek(0)
    return file


def false_source_scores(result: RecordingResult) -> dict[str, float]:
    """Reports per minute of a recording without talkers."""
    minutes = result.duration / 60
    summary = len(result.summary) / minutes
    windows = sum(bool(window.estimate.sources) for window in result.windows) / minutes
    return {
        "false_sources_per_minute": summary + windows,
        "summary_sources_per_minute": summary,
        "reporting_windows_per_minute": windows,
    }


def _in_blocks(block: Callable[[int], FloatArray], num_samples: int) -> FloatArray:
    """Audio (N, T) made of blocks (N, T') of up to ``BLOCK_SAMPLES``."""
    begins = range(0, num_samples, BLOCK_SAMPLES)
    return np.concatenate([block(min(BLOCK_SAMPLES, num_samples - b)) for b in begins], axis=1)


def _with_sensor_noise(rng: np.random.Generator, audio: FloatArray) -> FloatArray:
    noisy = unit_power(audio)
    return noisy + 10 ** (SENSOR_NOISE_DB / 20) * rng.standard_normal(noisy.shape)

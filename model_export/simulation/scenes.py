"""Scenes: dry speech through room responses, plus the noises that real arrays hear.

A scene is one analysis window of multichannel audio with the directions of its talkers. Every
source has the same power at the first microphone before noise, as the paper's protocol has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft

from model_export import SAMPLE_RATE
from model_export.simulation.fan import random_fan
from model_export.simulation.imperfections import band_limit, crosstalk, mismatch, quantised
from model_export.simulation.noise import (
    colour,
    coupled_noise,
    excerpt,
    sensor_noise,
    shaped_like,
    unit_power,
)
from model_export.simulation.room_bank import RoomChunk
from model_export.simulation.scene_config import SceneConfig
from service.doa.array import SPEED_OF_SOUND
from service.doa.scoring import circular_error
from service.doa.types import FloatArray

WINDOW_SAMPLES = 16640
"""64 STFT frames of 512 samples every 256"""
DRY_SAMPLES = 32000
RESPONSE_DELAY = 40
"""Samples by which pyroomacoustics' fractional delays are late"""
DIRECT_SECONDS = 1e-3
AUDIBLE = 0.02
"""Share of its mean power below which a talker counts as absent in a part of a scene"""

LATE = (0.3, 0.95)
"""Earliest and latest beginning of a talker, as shares of the window"""
ONSET_LEVEL = 0.1
"""Share of a clip's peak at which its sound begins"""


@dataclass(frozen=True, slots=True)
class Scene:
    """One window of audio and its truth."""

    audio: FloatArray
    """(N, T) float32"""
    positions: FloatArray
    """(N, 3) nominal microphone positions in metres"""
    azimuth: FloatArray
    """(M,) radians"""
    direct: FloatArray | None = None
    """(M, T) float32: the talkers' direct sound at the first microphone; None: not known"""
    heard: FloatArray | None = None
    """(T,) float32: all that the first microphone hears, before its imperfections, likewise"""
    elevation: FloatArray | None = None
    """(M,) radians; None: not known"""

    def crop(self, start: int, num_samples: int) -> Scene:
        """A shorter scene, of the talkers that sound in it as far as that is known."""
        kept = slice(start, start + num_samples)
        if self.direct is None or self.heard is None:
            return replace(self, audio=self.audio[:, kept])
        whole = np.square(self.direct).mean(axis=1)
        sounds = np.square(self.direct[:, kept]).mean(axis=1) > AUDIBLE * whole
        return Scene(
            self.audio[:, kept],
            self.positions,
            self.azimuth[sounds],
            self.direct[sounds][:, kept],
            self.heard[kept],
            None if self.elevation is None else self.elevation[sounds],
        )


def draw_scene(
    rng: np.random.Generator,
    chunk: RoomChunk,
    speech: Sequence[FloatArray],
    config: SceneConfig,
    *,
    noises: Sequence[FloatArray] = (),
) -> Scene:
    """A random scene in a random room of the chunk; ``noises`` are steady mono recordings."""
    room = int(rng.integers(len(chunk.positions)))
    positions = chunk.positions[room]
    count = int(rng.choice(len(config.source_counts), p=config.source_counts))
    chosen = _separated(rng, chunk.azimuth[room], count, config.min_separation)
    start = int(rng.integers(0, DRY_SAMPLES - WINDOW_SAMPLES))
    late = config.late > 0 and rng.random() < config.late
    begins = start + round(float(rng.uniform(*LATE)) * WINDOW_SAMPLES) if late else 0
    audio = np.zeros((len(positions), WINDOW_SAMPLES), dtype=np.float32)
    direct = np.zeros((len(chosen), WINDOW_SAMPLES), dtype=np.float32)
    for rank, source in enumerate(chosen):
        responses = chunk.responses[room, source].astype(np.float32)
        first = direct_response(responses[0], float(chunk.distance[room, source]))
        dry = late_speech(rng, speech, begins) if late else dry_speech(rng, speech, start)
        wet = convolve_window(dry, np.concatenate([responses, first[None]]), start)
        level = 10 ** (rng.uniform(-1, 1) * config.level_difference_db / 40)
        wet = np.float32(level) * unit_power(wet)
        audio += wet[:-1]
        direct[rank] = wet[-1]
    snr_db = float(rng.uniform(*config.snr_db))
    noise = _noise(rng, chunk, room, chosen, config, noises)
    audio += noise * np.float32(10 ** (-snr_db / 20)) if len(chosen) else noise
    heard = audio[0].copy()
    audio = _imperfections(rng, audio, config)
    error = rng.normal(scale=config.position_error * rng.random(), size=positions.shape)
    return Scene(
        audio,
        positions + error,
        chunk.azimuth[room, chosen],
        direct,
        heard,
        chunk.elevation[room, chosen],
    )


def direct_response(response: FloatArray, distance: float) -> FloatArray:
    """A response (K,) up to a millisecond after the direct sound has arrived."""
    arrival = distance / SPEED_OF_SOUND * SAMPLE_RATE + RESPONSE_DELAY
    kept = np.zeros_like(response)
    end = round(arrival + DIRECT_SECONDS * SAMPLE_RATE)
    kept[:end] = response[:end]
    return kept


def dry_speech(rng: np.random.Generator, speech: Sequence[FloatArray], start: int) -> FloatArray:
    """(DRY_SAMPLES,) float32 of one talker who speaks inside the window that begins at ``start``.

    Half the scenes hold continuous speech, so that the window opens in the middle of a
    reverberant sentence; the others a lone word, whose onset is heard in a quiet room.
    """
    dry = np.zeros(DRY_SAMPLES, dtype=np.float32)
    clip = speech[int(rng.integers(len(speech)))]
    if len(clip) > DRY_SAMPLES:
        offset = int(rng.integers(len(clip) - DRY_SAMPLES))
        return clip[offset : offset + DRY_SAMPLES]
    if rng.random() < 0.5:
        offset = int(rng.integers(0, len(clip)))
        repeated = np.concatenate([clip[offset:], *([clip] * (1 + DRY_SAMPLES // len(clip)))])
        return repeated[:DRY_SAMPLES]
    begin = min(max(0, start + int(rng.integers(-4000, 6000))), DRY_SAMPLES - len(clip))
    dry[begin : begin + len(clip)] = clip
    return dry


def late_speech(rng: np.random.Generator, speech: Sequence[FloatArray], begins: int) -> FloatArray:
    """(DRY_SAMPLES,) float32 of one talker whose first sound is at ``begins``."""
    clip = speech[int(rng.integers(len(speech)))]
    level = np.abs(clip)
    sound = clip[int(np.argmax(level > ONSET_LEVEL * level.max())) :][: DRY_SAMPLES - begins]
    dry = np.zeros(DRY_SAMPLES, dtype=np.float32)
    dry[begins : begins + len(sound)] = sound
    return dry


def convolve(dry: FloatArray, responses: FloatArray) -> FloatArray:
    """A dry signal (T,) through responses (N, K): at least (N, T + K - 1) float32."""
    size = scipy.fft.next_fast_len(dry.size + responses.shape[-1], real=True)
    spectrum = scipy.fft.rfft(dry, size) * scipy.fft.rfft(responses, size, axis=-1)
    wet: FloatArray = scipy.fft.irfft(spectrum, size, axis=-1).astype(np.float32)
    return wet


def convolve_window(dry: FloatArray, responses: FloatArray, start: int) -> FloatArray:
    """The window of ``convolve``'s that begins at ``start``: (N, WINDOW_SAMPLES) float32.

    Only what sounds in the window is transformed; what wraps around falls before it.
    """
    lead = responses.shape[-1] - 1
    heard = dry[max(0, start - lead) : start + WINDOW_SAMPLES]
    part = np.pad(heard, (lead + WINDOW_SAMPLES - len(heard), 0))
    size = scipy.fft.next_fast_len(len(part), real=True)
    spectrum = scipy.fft.rfft(part, size) * scipy.fft.rfft(responses, size, axis=-1)
    wet: FloatArray = scipy.fft.irfft(spectrum, size, axis=-1)[:, lead : lead + WINDOW_SAMPLES]
    return wet.astype(np.float32, copy=False)


def _separated(
    rng: np.random.Generator, azimuth: FloatArray, count: int, separation: float
) -> list[int]:
    """Up to ``count`` of the room's sources, pairwise at least ``separation`` apart."""
    chosen: list[int] = []
    for source in rng.permutation(len(azimuth)):
        gaps = circular_error(azimuth[chosen], azimuth[source])
        if len(chosen) < count and (gaps >= separation).all():
            chosen.append(int(source))
    return chosen


def _noise(
    rng: np.random.Generator,
    chunk: RoomChunk,
    room: int,
    chosen: Sequence[int],
    config: SceneConfig,
    noises: Sequence[FloatArray],
) -> FloatArray:
    """Unit-power mixture of sensor, diffuse, coupled and machine noise, (N, T)."""
    shape = chunk.diffuse[room].shape
    mixture = sensor_noise(rng, shape) * np.float32(rng.uniform(0.05, 1))
    if rng.random() < config.diffuse:
        diffuse = np.roll(chunk.diffuse[room], int(rng.integers(shape[1])), axis=1)
        diffuse = diffuse.astype(np.float32)
        if noises and rng.random() < config.recorded:
            diffuse = shaped_like(diffuse, excerpt(rng, noises, shape[1]))
        else:
            diffuse = colour(rng, diffuse)
        mixture += unit_power(diffuse) * np.float32(rng.uniform(0.2, 3))
    if rng.random() < config.coupled:
        mixture += coupled_noise(rng, shape) * np.float32(rng.uniform(0.05, 0.7))
    mixture = unit_power(mixture)
    free = np.setdiff1d(np.arange(len(chunk.azimuth[room])), chosen)
    if len(free) and rng.random() < (config.machine if len(chosen) else 4 * config.machine):
        steady = random_fan(rng, DRY_SAMPLES)
        responses = chunk.responses[room, rng.choice(free)].astype(np.float32)
        machine = convolve(steady, responses)[:, DRY_SAMPLES - shape[1] : DRY_SAMPLES]
        mixture = unit_power(mixture + unit_power(machine) * np.float32(rng.uniform(0.3, 3)))
    return mixture


def _imperfections(rng: np.random.Generator, audio: FloatArray, config: SceneConfig) -> FloatArray:
    audio = mismatch(rng, audio)
    if rng.random() < config.crosstalk:
        audio = crosstalk(rng, audio)
    if rng.random() < config.band_limit:
        audio = band_limit(rng, audio)
    if rng.random() < config.quantised:
        audio = quantised(rng, audio)
    return audio

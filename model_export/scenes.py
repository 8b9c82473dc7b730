"""Scenes: dry speech through room responses, plus the noises that real arrays hear.

A scene is one analysis window of multichannel audio with the directions of its talkers. Every
source has the same power at the first microphone before noise, as the paper's protocol has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.fft

from service.doa.scoring import circular_error
from service.doa.types import FloatArray

WINDOW_SAMPLES = 16640
"""64 STFT frames of 512 samples every 256"""
DRY_SAMPLES = 32000


@dataclass(frozen=True, slots=True)
class SceneConfig:
    """What a training scene may hold; probabilities unless said otherwise."""

    source_counts: tuple[float, ...] = (0.0, 0.55, 0.35, 0.10)
    """Probability of 0, 1, 2, ... talkers"""
    min_separation: float = np.deg2rad(12.0)
    """Radians between talkers"""
    snr_db: tuple[float, float] = (-5.0, 35.0)
    """Signal-to-noise ratio against all noise, uniform"""
    level_difference_db: float = 3.0
    """Talkers differ by up to this much"""
    gain_mismatch_db: float = 1.0
    """Standard deviation of the microphones' gains"""
    diffuse: float = 0.5
    coupled: float = 0.15
    crosstalk: float = 0.15
    band_limit: float = 0.12


@dataclass(frozen=True, slots=True)
class Scene:
    """One window of audio and its truth."""

    audio: FloatArray
    """(N, T) float32"""
    positions: FloatArray
    """(N, 3) nominal microphone positions in metres"""
    azimuth: FloatArray
    """(M,) radians"""
    snr_db: float


class RoomBank:
    """Chunks of simulated rooms on disk (``rooms.write_room_bank``), drawn one at a time."""

    def __init__(self, folder: Path, *, validation: bool = False) -> None:
        paths = sorted(p for p in folder.glob("*.npz") if not p.name.endswith(".part.npz"))
        # One chunk in twenty only validates; a bank of fewer, as tests make, does both with all.
        if len(paths) >= 20:
            paths = [p for p in paths if (int(p.stem) % 20 == 19) == validation]
        self.paths = paths
        if not self.paths:
            raise FileNotFoundError(f"no room chunks in {folder}: run 'model_export rooms' first")

    def chunk(self, rng: np.random.Generator) -> dict[str, FloatArray]:
        """One whole chunk; its rooms share the microphone count."""
        with np.load(self.paths[rng.integers(len(self.paths))]) as arrays:
            return {key: arrays[key] for key in arrays.files}


def draw_scene(
    rng: np.random.Generator,
    chunk: dict[str, FloatArray],
    speech: Sequence[FloatArray],
    config: SceneConfig,
) -> Scene:
    """A random scene in a random room of the chunk."""
    room = int(rng.integers(len(chunk["positions"])))
    positions = chunk["positions"][room]
    count = int(rng.choice(len(config.source_counts), p=config.source_counts))
    chosen = _separated(rng, chunk["azimuth"][room], count, config.min_separation)
    start = int(rng.integers(0, DRY_SAMPLES - WINDOW_SAMPLES))
    audio = np.zeros((len(positions), WINDOW_SAMPLES), dtype=np.float32)
    for source in chosen:
        dry = dry_speech(rng, speech, start)
        wet = convolve(dry, chunk["responses"][room, source].astype(np.float32))
        wet = wet[:, start : start + WINDOW_SAMPLES]
        level = 10 ** (rng.uniform(-1, 1) * config.level_difference_db / 40)
        audio += np.float32(level) * unit_power(wet)
    snr_db = float(rng.uniform(*config.snr_db))
    noise = _noise(rng, chunk["diffuse"][room].astype(np.float32), config)
    audio += noise * np.float32(10 ** (-snr_db / 20)) if len(chosen) else noise
    audio = _imperfections(rng, audio, config)
    return Scene(audio, positions, chunk["azimuth"][room, chosen], snr_db)


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


def convolve(dry: FloatArray, responses: FloatArray) -> FloatArray:
    """A dry signal (T,) through responses (N, K): at least (N, T + K - 1) float32."""
    size = scipy.fft.next_fast_len(dry.size + responses.shape[-1], real=True)
    spectrum = scipy.fft.rfft(dry, size) * scipy.fft.rfft(responses, size, axis=-1)
    wet: FloatArray = scipy.fft.irfft(spectrum, size, axis=-1).astype(np.float32)
    return wet


def unit_power(audio: FloatArray) -> FloatArray:
    """Scale (N, T) audio to unit variance at its first microphone."""
    power = float(np.mean(audio[0].astype(np.float64) ** 2))
    return audio / np.float32(np.sqrt(max(power, 1e-12)))


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


def _noise(rng: np.random.Generator, diffuse: FloatArray, config: SceneConfig) -> FloatArray:
    """Unit-power mixture of sensor noise, coloured diffuse noise and coupled noise, (N, T)."""
    shape = diffuse.shape
    noise = rng.standard_normal(shape, dtype=np.float32) * np.float32(rng.uniform(0.05, 1))
    if rng.random() < config.diffuse:
        shifted = np.roll(diffuse, int(rng.integers(shape[1])), axis=1)
        noise += unit_power(_colour(rng, shifted)) * np.float32(rng.uniform(0.2, 3))
    if rng.random() < config.coupled:
        common = _colour(rng, rng.standard_normal((1, shape[1]), dtype=np.float32))
        # One converter feeds two or four channels; what couples into it is in phase in them.
        members = rng.random(shape[0]) < rng.choice([0.5, 1.0])
        noise += members[:, None] * unit_power(common) * np.float32(rng.uniform(0.05, 0.7))
    return unit_power(noise)


def _colour(rng: np.random.Generator, noise: FloatArray) -> FloatArray:
    """Give noise (N, T) a random spectral slope and a random resonance."""
    spectrum = scipy.fft.rfft(noise, axis=-1)
    frequency = np.linspace(1e-3, 1, spectrum.shape[-1], dtype=np.float32)
    slope = frequency ** np.float32(-rng.uniform(0, 1.2))
    centre, width = rng.uniform(0.02, 0.8), rng.uniform(0.02, 0.3)
    resonance = 1 + rng.uniform(0, 4) * np.exp(-0.5 * ((frequency - centre) / width) ** 2)
    coloured: FloatArray = scipy.fft.irfft(
        spectrum * np.minimum(slope, 100) * resonance.astype(np.float32), noise.shape[-1], axis=-1
    )
    return coloured


def _imperfections(rng: np.random.Generator, audio: FloatArray, config: SceneConfig) -> FloatArray:
    """Unequal gains, crosstalk between neighbouring channels, a band limit."""
    microphones = audio.shape[0]
    gains = 10 ** (rng.normal(scale=config.gain_mismatch_db, size=(microphones, 1)) / 20)
    audio = audio * gains.astype(np.float32)
    if rng.random() < config.crosstalk:
        leak = np.float32(10 ** (rng.uniform(-45, -22) / 20))
        audio = audio + leak * np.roll(audio, 1, axis=0)
    if rng.random() < config.band_limit:
        spectrum = scipy.fft.rfft(audio, axis=-1)
        edge = int(spectrum.shape[-1] * rng.uniform(0.4, 0.95))
        spectrum[:, edge:] *= np.float32(1e-3)
        audio = scipy.fft.irfft(spectrum, audio.shape[-1], axis=-1)
    return audio.astype(np.float32)

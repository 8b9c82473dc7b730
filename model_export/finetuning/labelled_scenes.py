"""Training scenes from labelled recordings: windows, mixtures and noise of the same room.

The sum of two recordings of one array in one room is a recording of both talkers at once, so
recordings of single talkers teach the network to separate two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from model_export.finetuning.labelled_recordings import (
    FRAME_SAMPLES,
    GRAIN_FRAMES,
    LabelledRecording,
    LabelledWindows,
)
from model_export.simulation.noise import sensor_noise, unit_power
from model_export.simulation.scene_config import SceneConfig
from model_export.simulation.scenes import WINDOW_SAMPLES, Scene
from service.doa.array import MicrophoneArray
from service.doa.scoring import circular_error
from service.doa.types import FloatArray

MIN_GRAINS = 4
"""Least number of quiet grains; noise made of fewer repeats itself"""


@dataclass(frozen=True, slots=True)
class Augmentation:
    """Augmentation of recorded windows."""

    mixtures: float = 0.35
    """Probability of adding a second recording"""
    noise: float = 0.6
    """Probability of adding noise"""
    snr_db: tuple[float, float] = (-5.0, 25.0)
    """Range of the SNR of the recorded window, with its own noise, over the added noise"""


class LabelledScenes:
    """Draws scenes from the recordings of one array."""

    def __init__(self, recordings: Sequence[LabelledRecording], array: MicrophoneArray) -> None:
        self.recordings = recordings
        self.positions = array.positions
        self._noisy = [r for r in recordings if len(r.quiet) >= MIN_GRAINS]
        self._single = [(r, w) for r in recordings for w in r.windows if len(w.azimuth) == 1]

    def draw(
        self, rng: np.random.Generator, augmentation: Augmentation, config: SceneConfig
    ) -> Scene:
        """Draw a window at a random place, possibly with a second talker and noise."""
        recording = self.recordings[int(rng.integers(len(self.recordings)))]
        windows = recording.windows[int(rng.integers(len(recording.windows)))]
        audio = _cut(recording, windows, _random_start(rng, windows))
        scene = Scene(audio, self.positions, windows.azimuth)
        if rng.random() < augmentation.mixtures:
            scene = self.mix(rng, scene, config)
        if rng.random() < augmentation.noise:
            scene = self.with_noise(rng, scene, float(rng.uniform(*augmentation.snr_db)))
        return scene

    def windows(self, most_per_recording: int) -> list[Scene]:
        """Windows as recorded, evenly over every recording's labelled sound."""
        scenes = []
        for recording in self.recordings:
            places = [(w, int(start)) for w in recording.windows for start in w.starts]
            count = min(most_per_recording, len(places))
            for index in np.linspace(0, len(places) - 1, count).round().astype(int):
                windows, start = places[index]
                audio = _cut(recording, windows, start)
                scenes.append(Scene(audio, self.positions, windows.azimuth))
        return scenes

    def mix(self, rng: np.random.Generator, scene: Scene, config: SceneConfig) -> Scene:
        """Add another recording's talker to the scene, unless the two are too close."""
        if len(scene.azimuth) != 1 or not self._single:
            return scene
        other, windows = self._single[int(rng.integers(len(self._single)))]
        if float(circular_error(windows.azimuth[0], scene.azimuth[0])) < config.min_separation:
            return scene
        added = unit_power(_cut(other, windows, _random_start(rng, windows)))
        level = np.float32(10 ** (rng.uniform(-1, 1) * config.level_difference_db / 20))
        azimuth = np.concatenate([scene.azimuth, windows.azimuth])
        return replace(scene, audio=unit_power(scene.audio) + level * added, azimuth=azimuth)

    def with_noise(self, rng: np.random.Generator, scene: Scene, snr_db: float) -> Scene:
        """Add sensor noise to the scene and, if recordings have pauses, the room's own noise."""
        audio = scene.audio
        noise = sensor_noise(rng, audio.shape) * np.float32(rng.uniform(0.1, 1))
        if self._noisy:
            recording = self._noisy[int(rng.integers(len(self._noisy)))]
            noise += unit_power(room_noise(rng, recording, audio.shape[1]))
        noise = unit_power(noise) * np.float32(10 ** (-snr_db / 20))
        return replace(scene, audio=unit_power(audio) + noise)


def room_noise(
    rng: np.random.Generator, recording: LabelledRecording, num_samples: int
) -> FloatArray:
    """Noise (N, num_samples) float32 with the spectrum and directions of a recording's pauses.

    It overlaps grains of the pauses under sine windows, whose powers add up to one.
    """
    length = GRAIN_FRAMES * FRAME_SAMPLES
    hop = length // 2
    window = np.sin(np.pi * (np.arange(length, dtype=np.float32) + 0.5) / length)
    noise = np.zeros((len(recording.audio), num_samples + 2 * length), dtype=np.float32)
    for begin in range(0, num_samples + hop, hop):
        start = int(rng.choice(recording.quiet))
        noise[:, begin : begin + length] += window * recording.audio[:, start : start + length]
    return noise[:, hop : hop + num_samples]


def _random_start(rng: np.random.Generator, windows: LabelledWindows) -> int:
    start = int(rng.choice(windows.starts)) + int(rng.integers(FRAME_SAMPLES))
    return min(start, windows.last)


def _cut(recording: LabelledRecording, windows: LabelledWindows, start: int) -> FloatArray:
    audio = recording.audio[:, start : start + WINDOW_SAMPLES]
    return np.pad(audio, [(0, 0), (0, WINDOW_SAMPLES - audio.shape[1])])

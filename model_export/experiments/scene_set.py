"""Scenes of an experiment: simulated or cut from recordings once, then read by every method."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from model_export.baselines.network import MAX_TALKERS
from model_export.datasets.speech import Split
from model_export.evaluation.methods import Methods
from model_export.evaluation.workers import Inputs, Workers
from model_export.simulation.arrays import named_array
from model_export.simulation.protocol import SceneProtocol, simulate_scene
from model_export.simulation.scenes import WINDOW_SAMPLES
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

DESCRIPTION = "array.json"
PART = 2400
"""Number of scenes that are simulated at a time, before they are written"""


@dataclass(frozen=True, slots=True)
class Recipe:
    """Definition of a scene set: protocols in turn, speakers, a seed."""

    name: str
    protocols: tuple[SceneProtocol, ...]
    """Protocols, of which scene k takes number k modulo their count"""
    split: Split
    count: int
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class SceneSet:
    """Windows of one array with their sources."""

    audio: FloatArray
    """(S, N, T) float16 at 16 kHz with a peak of 1, memory-mapped"""
    azimuth: FloatArray
    """(S, MAX_TALKERS) radians, padded with NaN"""
    array: MicrophoneArray

    def __len__(self) -> int:
        return len(self.azimuth)

    def window(self, index: int) -> FloatArray:
        """One scene's audio (N, T) float32."""
        window: FloatArray = self.audio[index].astype(np.float32)
        return window

    def sources(self, index: int) -> FloatArray:
        """One scene's directions (M,) in radians."""
        row = self.azimuth[index]
        sources: FloatArray = row[np.isfinite(row)]
        return sources

    def share(self, share: float, seed: int = 0) -> SceneSet:
        """A random part of the scenes, which favours no direction whatever their order."""
        kept = np.random.default_rng(seed).permutation(len(self))[: round(share * len(self))]
        return SceneSet(self.audio[np.sort(kept)], self.azimuth[np.sort(kept)], self.array)

    @classmethod
    def read(cls, folder: Path) -> SceneSet:
        """Read the set that ``write`` has written."""
        described = json.loads((folder / DESCRIPTION).read_text())
        array = MicrophoneArray(described["name"], np.array(described["positions_m"]))
        azimuth = np.load(folder / "azimuth.npy")
        shape = (len(azimuth), array.num_microphones, WINDOW_SAMPLES)
        audio = np.memmap(folder / "audio.f16", np.float16, "r", shape=shape)
        return cls(audio, azimuth, array)

    @classmethod
    def write(
        cls, folder: Path, scenes: Iterable[tuple[FloatArray, FloatArray]], array: MicrophoneArray
    ) -> SceneSet:
        """Write scenes, each with audio (N, T) and azimuths (M,) in radians, and read the set.

        Longer windows are cut, shorter ones padded to ``WINDOW_SAMPLES``.

        Raises
        ------
        ValueError
            If there is no scene, or one with more than ``MAX_TALKERS`` sources.
        """
        folder.mkdir(parents=True, exist_ok=True)
        azimuth = []
        with (folder / "audio.f16").open("wb") as file:
            for samples, sources in scenes:
                if len(sources) > MAX_TALKERS:
                    raise ValueError(
                        f"a window with {len(sources)} sources: the comparison has at most "
                        f"{MAX_TALKERS}"
                    )
                _half_precision(samples).tofile(file)
                missing = MAX_TALKERS - len(sources)
                azimuth.append(np.pad(sources, (0, missing), constant_values=np.nan))
        if not azimuth:
            raise ValueError(f"{folder.name}: no scene has a known direction")
        np.save(folder / "azimuth.npy", np.stack(azimuth).astype(np.float32))
        # Written last: its presence says that the set is whole.
        (folder / DESCRIPTION).write_text(
            json.dumps({"name": array.name, "positions_m": array.positions.tolist()}) + "\n"
        )
        return cls.read(folder)


def is_whole(folder: Path) -> bool:
    """Whether a scene set was written to its end."""
    return (folder / DESCRIPTION).exists()


def simulated(folder: Path, recipe: Recipe, speech: Sequence[FloatArray], workers: int) -> SceneSet:
    """Simulate and write the recipe's scenes."""
    with Workers.start(Inputs(Methods(()), speech, recipe.seed), workers) as pool:
        parts = (
            pool.map(
                _simulate,
                [(recipe, index) for index in range(first, min(first + PART, recipe.count))],
                f"{recipe.name} from {first}" if recipe.count > PART else recipe.name,
            )
            for first in range(0, recipe.count, PART)
        )
        scenes = (scene for part in parts for scene in part)
        return SceneSet.write(folder, scenes, named_array(recipe.protocols[0].array))


def _simulate(inputs: Inputs, task: tuple[Recipe, int]) -> tuple[FloatArray, FloatArray]:
    recipe, index = task
    protocol = recipe.protocols[index % len(recipe.protocols)]
    scene = simulate_scene(protocol, inputs.speech, [recipe.seed, index])
    return _half_precision(scene.audio), scene.azimuth


def _half_precision(samples: FloatArray) -> FloatArray:
    """Audio (N, WINDOW_SAMPLES) float16 with a peak of 1; rounding errors are 70 dB below it."""
    kept = samples[:, :WINDOW_SAMPLES]
    kept = np.pad(kept, [(0, 0), (0, WINDOW_SAMPLES - kept.shape[1])])
    scaled: FloatArray = (kept / max(float(np.abs(kept).max()), 1e-9)).astype(np.float16)
    return scaled

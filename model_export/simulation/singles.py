"""A bank of single talkers on disk, and scenes that are sums of them.

Every talker speaks alone in the paper's room and has unit power at the first microphone, so that M
of them added, and sensor noise, are a scene of the paper's protocol: some thousand simulated
talkers give billions of scenes for next to nothing. In a sum every talker has a room of its own
order, which the paper's scenes have not.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pyroomacoustics
from rich.progress import track

from model_export.simulation import noise, protocol, rooms, scenes
from model_export.simulation.arrays import named_array
from model_export.simulation.noise import sensor_noise
from model_export.simulation.protocol import MOST_TRIES, SceneProtocol, simulate_scene
from model_export.simulation.scene_config import SceneConfig
from model_export.simulation.scenes import WINDOW_SAMPLES, Scene
from model_export.simulation.symmetry import symmetries
from service.doa.scoring import circular_error
from service.doa.types import FloatArray, IntArray

CHUNK_TALKERS = 1000
"""133 MB of four microphones"""
MANIFEST = "singles.json"


def single_talkers(array: str) -> SceneProtocol:
    """The protocol of a bank: one talker in the paper's room of order 0 to 4, without noise."""
    return SceneProtocol(array=array, orders=(0, 4), snr_db=math.inf)


def write_singles(
    folder: Path, array: str, speech: Sequence[FloatArray], num_chunks: int, seed: int
) -> None:
    """Write chunks 0 to ``num_chunks`` - 1 into ``folder``; those that exist are kept.

    A chunk is ``audio-00000.npy``, (1000, N, T) float16, and ``azimuth-00000.npy``, (1000,) float32
    radians.

    Raises
    ------
    ValueError
        If the folder holds a bank of another array, corpus or seed, or of other code.
    """
    folder.mkdir(parents=True, exist_ok=True)
    described = _description(array)
    described |= {"seed": seed, "sha256": _digest(described, speech, seed)}
    manifest = folder / MANIFEST
    if manifest.exists() and json.loads(manifest.read_text()) != described:
        raise ValueError(
            f"{folder} holds single talkers of another array, corpus or seed, or of other code: "
            "name another folder"
        )
    manifest.write_text(json.dumps(described, indent=2) + "\n")
    for chunk in track(range(num_chunks), description="simulating single talkers"):
        if not _audio(folder, chunk).exists():
            _write_chunk(folder, chunk, array, speech, seed)


class SinglesBank:
    """The single talkers of a folder, by memory map.

    Raises
    ------
    FileNotFoundError
        If the folder holds none.
    ValueError
        If they were simulated for another array or by another protocol.
    """

    def __init__(self, folder: Path, array: str) -> None:
        chunks = sorted(folder.glob("audio-?????.npy"))
        if not chunks or not (folder / MANIFEST).exists():
            raise FileNotFoundError(
                f"no single talkers in {folder}: run 'model_export singles' first"
            )
        found = json.loads((folder / MANIFEST).read_text())
        if found["protocol"] != _description(array)["protocol"]:
            raise ValueError(f"{folder} holds single talkers of another protocol than {array}'s")
        self._audio = [np.load(path, mmap_mode="r") for path in chunks]
        azimuths = [
            np.load(path.with_name(path.name.replace("audio", "azimuth"))) for path in chunks
        ]
        self._azimuth = np.concatenate(azimuths).astype(np.float64)
        self._positions = named_array(array).positions
        self._symmetries = symmetries(named_array(array))

    def __len__(self) -> int:
        return len(self._azimuth)

    def draw(self, rng: np.random.Generator, config: SceneConfig) -> Scene:
        """A random scene: talkers of the bank added up, and sensor noise.

        The configuration's counts, separation, ratios and symmetries apply. The ratio relates the
        power of all talkers to the noise, as in the paper's protocol.
        """
        count = int(rng.choice(len(config.source_counts), p=config.source_counts))
        talkers, views, azimuth = self._apart(rng, count, config)
        ratios = config.noisy_snr_db if rng.random() < config.noisy else config.snr_db
        sigma = np.sqrt(max(1, count) * 10 ** (-rng.uniform(*ratios) / 10))
        audio = np.float32(sigma) * sensor_noise(rng, (len(self._positions), WINDOW_SAMPLES))
        for talker, view in zip(talkers, views, strict=True):
            chunk, row = divmod(int(talker), len(self._audio[0]))
            audio += self._audio[chunk][row][self._symmetries[view].permutation]
        return Scene(audio, self._positions, azimuth % (2 * np.pi))

    def _apart(
        self, rng: np.random.Generator, count: int, config: SceneConfig
    ) -> tuple[IntArray, IntArray, FloatArray]:
        """Talkers, the symmetries that they are seen by, and their azimuths, far enough apart."""
        for _ in range(MOST_TRIES):
            talkers = rng.integers(len(self), size=count)
            views = rng.integers(len(self._symmetries) if config.symmetric else 1, size=count)
            seen = zip(talkers, views, strict=True)
            azimuth = np.array([self._symmetries[v].azimuth(self._azimuth[t]) for t, v in seen])
            gaps = circular_error(azimuth[:, None], azimuth[None])[np.triu_indices(count, 1)]
            if (gaps >= config.min_separation).all():
                return talkers, views, azimuth
        raise ValueError(f"the bank holds no {count} talkers that are far enough apart")


def _write_chunk(
    folder: Path, chunk: int, array: str, speech: Sequence[FloatArray], seed: int
) -> None:
    drawn = [
        simulate_scene(single_talkers(array), speech, [seed, index])
        for index in range(chunk * CHUNK_TALKERS, (chunk + 1) * CHUNK_TALKERS)
    ]
    azimuth = np.array([scene.azimuth[0] for scene in drawn], dtype=np.float32)
    audio = np.stack([scene.audio.astype(np.float16) for scene in drawn])
    # The audio last: a chunk is there once its audio is.
    for path, values in ((_azimuth(folder, chunk), azimuth), (_audio(folder, chunk), audio)):
        unfinished = path.with_suffix(".part.npy")
        np.save(unfinished, values)
        unfinished.rename(path)


def _audio(folder: Path, chunk: int) -> Path:
    return folder / f"audio-{chunk:05d}.npy"


def _azimuth(folder: Path, chunk: int) -> Path:
    return folder / f"azimuth-{chunk:05d}.npy"


def _description(array: str) -> dict[str, object]:
    described = {"protocol": asdict(single_talkers(array)), "talkers_per_chunk": CHUNK_TALKERS}
    plain: dict[str, object] = json.loads(json.dumps(described))
    return plain


def _digest(described: dict[str, object], speech: Sequence[FloatArray], seed: int) -> str:
    """SHA-256 of all that goes into a bank: the protocol, the seed, the code and the corpus."""
    digest = hashlib.sha256(json.dumps([described, seed, pyroomacoustics.__version__]).encode())
    for module in (noise, protocol, rooms, scenes):
        digest.update(inspect.getsource(module).encode())
    for clip in speech:
        digest.update(clip.tobytes())
    return digest.hexdigest()

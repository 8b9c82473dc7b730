"""Sources of training scenes, and the endless stream of batches made from them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count, islice
from typing import Protocol

import numpy as np
import torch
from torch.utils.data import IterableDataset

from model_export.simulation.arrays import named_array
from model_export.simulation.noise import sensor_noise
from model_export.simulation.protocol import SceneProtocol, simulate_scene
from model_export.simulation.room_bank import RoomChunk
from model_export.simulation.scenes import WINDOW_SAMPLES, Scene, draw_scene
from model_export.simulation.singles import SinglesBank
from model_export.training.config import TrainingConfig
from model_export.training.task import Batch
from model_export.training.variants import collate
from service.doa.types import FloatArray

PROTOCOL_SEED = 24


class RoomSource(Protocol):
    """A source of chunks of simulated rooms: a bank on disk, or rooms made for one array."""

    def chunk(self, rng: np.random.Generator) -> RoomChunk: ...


class SceneSource(Protocol):
    """An endless supply of scenes that depend only on the generator."""

    def scenes(self, rng: np.random.Generator, config: TrainingConfig) -> Iterator[Scene]: ...


@dataclass(frozen=True, slots=True)
class SimulatedScenes:
    """Dry speech in simulated rooms."""

    rooms: RoomSource
    speech: Sequence[FloatArray]
    noises: Sequence[FloatArray] = ()
    """Steady mono recordings"""

    def scenes(self, rng: np.random.Generator, config: TrainingConfig) -> Iterator[Scene]:
        while True:
            chunk = self.rooms.chunk(rng)
            for _ in range(config.batches_per_chunk * config.batch_size):
                yield draw_scene(rng, chunk, self.speech, config.scenes, noises=self.noises)


@dataclass(frozen=True, slots=True)
class SummedScenes:
    """Sums of a bank's single talkers."""

    bank: SinglesBank

    def scenes(self, rng: np.random.Generator, config: TrainingConfig) -> Iterator[Scene]:
        while True:
            yield self.bank.draw(rng, config.scenes)


@dataclass(frozen=True, slots=True)
class ProtocolScenes:
    """Scenes of the paper's test protocol, order 4 at 30 dB: the same ones whatever the seed."""

    array: str
    speech: Sequence[FloatArray]

    def scenes(self, rng: np.random.Generator, config: TrainingConfig) -> Iterator[Scene]:
        counts = config.scenes.source_counts
        positions = named_array(self.array).positions
        for index in count():
            seed = [PROTOCOL_SEED, index]
            fixed = np.random.default_rng(seed)
            talkers = int(fixed.choice(len(counts), p=counts))
            if talkers:
                drawn = simulate_scene(SceneProtocol(talkers, self.array), self.speech, seed)
                yield Scene(drawn.audio, positions, drawn.azimuth)
            else:
                noise = sensor_noise(fixed, (len(positions), WINDOW_SAMPLES))
                yield Scene(noise, positions, np.empty(0))


class SceneStream(IterableDataset[Batch]):
    """An endless stream of batches that depends only on seed, first step and worker."""

    def __init__(self, config: TrainingConfig, source: SceneSource, *, first_step: int = 0) -> None:
        self.config, self.source, self.first_step = config, source, first_step

    def __iter__(self) -> Iterator[Batch]:
        info = torch.utils.data.get_worker_info()
        worker, workers = (info.id, info.num_workers) if info else (0, 1)
        rng = np.random.default_rng([self.config.seed, self.first_step, worker])
        scenes = self.source.scenes(rng, self.config)
        for step in count(self.first_step + worker, workers):  # the loader takes turns
            size = self.config.batch_size_at(step)
            yield collate(self.config, rng, list(islice(scenes, size)))

"""Sources of training scenes, and the endless stream of batches made from them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Protocol

import numpy as np
import torch
from torch.utils.data import IterableDataset

from model_export.simulation.room_bank import RoomChunk
from model_export.simulation.scenes import Scene, draw_scene
from model_export.training.config import TrainingConfig
from model_export.training.task import Batch
from model_export.training.variants import collate
from service.doa.types import FloatArray


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


class SceneStream(IterableDataset[Batch]):
    """An endless stream of batches that depends only on seed, first step and worker."""

    def __init__(self, config: TrainingConfig, source: SceneSource, *, first_step: int = 0) -> None:
        self.config, self.source, self.first_step = config, source, first_step

    def __iter__(self) -> Iterator[Batch]:
        info = torch.utils.data.get_worker_info()
        worker = info.id if info else 0
        rng = np.random.default_rng([self.config.seed, self.first_step, worker])
        scenes = self.source.scenes(rng, self.config)
        while True:
            yield collate(self.config, rng, list(islice(scenes, self.config.batch_size)))

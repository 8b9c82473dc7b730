"""The source-count network of the `weights` variant: how many of the candidates are sources.

Its inputs are the descriptors of detect-and-remove's four candidates, not the array. Its outputs
are the number of sources and each candidate's chance of being within 10 degrees of one. It is
trained on the localizer's own candidates in simulated scenes, computed by the service's code.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from rich.progress import track
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset

from model_export.simulation.room_bank import RoomBank
from model_export.simulation.scene_config import SceneConfig
from model_export.simulation.scenes import WINDOW_SAMPLES, Scene, draw_scene
from model_export.training.confidences import HIT_DEG, calibration_error, confidence_bins
from model_export.training.task import SHORT_SAMPLES
from service.doa.array import MicrophoneArray
from service.doa.scoring import circular_error
from service.doa.sphere import angle_between
from service.doa.steering import unit_vectors
from service.doa.types import FloatArray
from service.inference.candidates import NUM_CANDIDATES, Direction
from service.inference.descriptors import NUM_DESCRIPTORS
from service.inference.results import MAX_SOURCES
from service.inference.weights import CandidateSearch

SHORT_WINDOWS = 0.4
"""Share of the scenes that are cut to a random length of half a second or more"""
BEGINNINGS = 3
"""Number of random initialisations of the source count's training"""
GROUP = 64
"""Number of scenes from one chunk of rooms"""
COUNTING_SCENES = SceneConfig(
    source_counts=(0.16, 0.38, 0.27, 0.14, 0.05),
    snr_db=(-5.0, 35.0),
    min_separation=np.deg2rad(10),
    machine=0.24,
    late=0.2,
)


class CandidateCountNetwork(nn.Module):
    """Descriptors (B, 4, D) to count logits (B, 5) and confidence logits (B, 4)."""

    mean: Tensor
    scale: Tensor

    def __init__(self, hidden: int = 96) -> None:
        super().__init__()
        inputs = NUM_CANDIDATES * NUM_DESCRIPTORS
        self.register_buffer("mean", torch.zeros(NUM_CANDIDATES, NUM_DESCRIPTORS))
        self.register_buffer("scale", torch.ones(NUM_CANDIDATES, NUM_DESCRIPTORS))
        self.trunk = nn.Sequential(
            nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU()
        )
        self.count_head = nn.Linear(hidden, MAX_SOURCES + 1)
        self.confidence_head = nn.Linear(hidden, NUM_CANDIDATES)

    def forward(self, descriptors: Tensor) -> tuple[Tensor, Tensor]:
        standardised = (descriptors - self.mean) * self.scale
        hidden = self.trunk(standardised.flatten(1))
        return self.count_head(hidden), self.confidence_head(hidden)


@dataclass(frozen=True, slots=True)
class CountingData:
    """Candidates of many scenes with their truth."""

    descriptors: FloatArray
    """(S, 4, D)"""
    count: FloatArray
    """(S,) number of sources"""
    hit: FloatArray
    """(S, 4), 1 where a candidate hits a source that no earlier candidate hit"""


class _SceneGroups(Dataset[list[Scene]]):
    """Seeded groups of scenes that share a chunk of rooms."""

    def __init__(
        self,
        bank: RoomBank,
        speech: Sequence[FloatArray],
        noises: Sequence[FloatArray],
        num_scenes: int,
        seed: int,
    ) -> None:
        self.bank, self.speech, self.noises, self.seed = bank, speech, noises, seed
        self.sizes = [min(GROUP, num_scenes - start) for start in range(0, num_scenes, GROUP)]

    def __len__(self) -> int:
        return len(self.sizes)

    def __getitem__(self, index: int) -> list[Scene]:
        rng = np.random.default_rng([self.seed, 77, index])
        chunk = self.bank.chunk(rng)
        scenes = [
            draw_scene(rng, chunk, self.speech, COUNTING_SCENES, noises=self.noises)
            for _ in range(self.sizes[index])
        ]
        return [_shortened(rng, s) if rng.random() < SHORT_WINDOWS else s for s in scenes]


def _shortened(rng: np.random.Generator, scene: Scene) -> Scene:
    length = int(rng.integers(SHORT_SAMPLES, WINDOW_SAMPLES))
    return scene.crop(int(rng.integers(WINDOW_SAMPLES - length)), length)


def collect(
    search_for: Callable[[MicrophoneArray], CandidateSearch],
    bank: RoomBank,
    speech: Sequence[FloatArray],
    num_scenes: int,
    seed: int,
    *,
    noises: Sequence[FloatArray] = (),
) -> CountingData:
    """Run the service's candidate search on simulated scenes."""
    groups = _SceneGroups(bank, speech, noises, num_scenes, seed)
    descriptors, counts, hits = [], [], []
    loader = DataLoader(groups, batch_size=None, num_workers=1)
    for scenes in track(loader, description="collecting candidates", total=len(groups)):
        for scene in scenes:
            search = search_for(MicrophoneArray("random", scene.positions))
            (candidates,) = search.candidates(scene.audio[None])
            descriptors.append(candidates.descriptors)
            counts.append(len(scene.azimuth))
            hits.append(first_hits(candidates.directions, scene))
    return CountingData(np.stack(descriptors), np.array(counts), np.stack(hits))


def first_hits(directions: Sequence[Direction], scene: Scene) -> FloatArray:
    """Hits (4,): 1 where a candidate is within 10 degrees of a source not hit earlier.

    Candidates without an elevation are compared by their azimuths.
    """
    hit = np.zeros(NUM_CANDIDATES, dtype=np.float32)
    free = list(range(len(scene.azimuth)))
    for rank, (azimuth, elevation) in enumerate(directions):
        if elevation is None:
            errors = circular_error(np.array(azimuth), scene.azimuth)
        else:
            assert scene.elevation is not None
            found = unit_vectors(np.array(azimuth), elevation)
            errors = angle_between(found, unit_vectors(scene.azimuth, scene.elevation))
        if free and errors[free].min() <= np.deg2rad(HIT_DEG):
            free.pop(int(errors[free].argmin()))
            hit[rank] = 1
    return hit


def train_counting(
    data: CountingData, validation: CountingData, *, epochs: int = 60, seed: int = 1
) -> tuple[CandidateCountNetwork, dict[str, float]]:
    """Fit count and confidences by cross entropy, from several initialisations.

    Returns the network of the epoch with the least validation loss, and its scores.
    """
    fitted = [_fitted(data, validation, epochs, seed + each) for each in range(BEGINNINGS)]
    network, _ = min(fitted, key=lambda each: each[1])
    return network, counting_scores(network, validation)


def _fitted(
    data: CountingData, validation: CountingData, epochs: int, seed: int
) -> tuple[CandidateCountNetwork, float]:
    """The best epoch's network, and its loss on the validation data."""
    torch.manual_seed(seed)
    network = CandidateCountNetwork()
    inputs = torch.from_numpy(data.descriptors)
    network.mean.copy_(inputs.mean(0))
    network.scale.copy_(1 / (inputs.std(0) + 1e-3))
    count = torch.from_numpy(data.count).long()
    hit = torch.from_numpy(data.hit)
    optimizer = torch.optim.AdamW(network.parameters(), lr=2e-3, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, epochs)
    best: tuple[float, dict[str, Tensor]] | None = None
    for _ in track(range(epochs), description="training the source count"):
        for rows in torch.randperm(len(inputs)).split(128):
            logits, confidence = network(inputs[rows])
            loss = F.cross_entropy(logits, count[rows])
            loss = loss + F.binary_cross_entropy_with_logits(confidence, hit[rows])
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            optimizer.step()
        schedule.step()
        score = counting_scores(network, validation)["loss"]
        if best is None or score < best[0]:
            best = score, {k: v.clone() for k, v in network.state_dict().items()}
    assert best is not None
    network.load_state_dict(best[1])
    return network.eval(), best[0]


@torch.no_grad()
def counting_scores(network: CandidateCountNetwork, data: CountingData) -> dict[str, float]:
    """Loss, count accuracy, and the calibration error of the confidences in ten bins."""
    logits, confidence = network(torch.from_numpy(data.descriptors))
    count, hit = torch.from_numpy(data.count).long(), torch.from_numpy(data.hit)
    loss = F.cross_entropy(logits, count)
    loss = loss + F.binary_cross_entropy_with_logits(confidence, hit)
    chance = torch.sigmoid(confidence).flatten().numpy()
    return {
        "loss": float(loss),
        "count_accuracy": float((logits.argmax(-1) == count).float().mean()),
        "calibration_error": calibration_error(confidence_bins(chance, data.hit.flatten() > 0)),
    }

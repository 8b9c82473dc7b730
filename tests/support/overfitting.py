"""Whether a learned method can learn: it must fit a handful of scenes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from model_export.baselines.network import MAX_TALKERS, BaselineNetwork, LearnedMethod, Truth
from model_export.simulation.protocol import SceneProtocol, SimulatedScene, simulate_scene
from model_export.simulation.scenes import WINDOW_SAMPLES
from model_export.simulation.synthesis import synthetic_voice
from service.doa.array import MicrophoneArray
from service.doa.scoring import maae
from service.doa.types import FloatArray


def talkers(
    counts: Sequence[int] = (1, 1, 1, 1, 1, 2, 2, 2), *, array: MicrophoneArray | None = None
) -> list[SimulatedScene]:
    """Scenes of synthetic voices in a room with one reflection, always the same."""
    rng = np.random.default_rng(3)
    speech = [synthetic_voice(rng, 1.2) for _ in range(8)]
    return [
        simulate_scene(
            SceneProtocol(num_sources=count, orders=(1, 1), min_separation_deg=40.0),
            speech,
            [3, index],
            array=array,
        )
        for index, count in enumerate(counts)
    ]


def windows(num_microphones: int) -> FloatArray:
    """Two windows of noise, (2, N, T) float32."""
    noise = np.random.default_rng(0).standard_normal((2, num_microphones, WINDOW_SAMPLES))
    return noise.astype(np.float32)


def truth_of(scenes: Sequence[SimulatedScene]) -> Truth:
    """The directions of the scenes' talkers."""
    azimuth = torch.zeros(len(scenes), MAX_TALKERS)
    for index, scene in enumerate(scenes):
        azimuth[index, : len(scene.azimuth)] = torch.from_numpy(scene.azimuth)
    counts = torch.tensor([len(scene.azimuth) for scene in scenes])
    return Truth(azimuth, torch.arange(MAX_TALKERS) < counts[:, None])


def batch_of(network: BaselineNetwork, scenes: Sequence[SimulatedScene]) -> tuple[Tensor, Truth]:
    """The method's features of the scenes, and their directions."""
    features = network.features(np.stack([scene.audio for scene in scenes]))
    return torch.from_numpy(features), truth_of(scenes)


def untrained_parameters(network: BaselineNetwork, scenes: Sequence[SimulatedScene]) -> list[str]:
    """Names of the parameters that the loss has no finite gradient for."""
    (features, truth), array = batch_of(network, scenes), scenes[0].array
    network.train()
    network.loss(network(features, array, truth.count), truth, array).backward()
    return [
        name
        for name, parameter in network.named_parameters()
        if parameter.grad is None or not parameter.grad.isfinite().all()
    ]


def overfitted(network: BaselineNetwork, scenes: Sequence[SimulatedScene], steps: int) -> float:
    """Degrees of MAAE on the scenes after so many steps of Adam on all of them at once.

    Without dropout, which is there to prevent this. The method's own learning rate falls to zero,
    and its answer uses its own count: a missing direction costs 90 degrees.
    """
    (features, truth), array = batch_of(network, scenes), scenes[0].array
    adam = torch.optim.Adam(network.parameters(), network.learning_rate)
    cosine = torch.optim.lr_scheduler.CosineAnnealingLR(adam, steps)
    network.train()
    for module in network.modules():
        if isinstance(module, torch.nn.Dropout):
            module.p = 0.0
    for _ in range(steps):
        adam.zero_grad()
        network.loss(network(features, array, truth.count), truth, array).backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        adam.step()
        cosine.step()
    method = LearnedMethod(network)
    errors = [maae(method.localize(s.audio, s.array).azimuth, s.azimuth) for s in scenes]
    return float(np.rad2deg(np.mean(errors)))

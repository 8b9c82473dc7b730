"""Learned methods: features, prediction and loss in training, and a trained one as a method."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import permutations
from typing import ClassVar

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from model_export.baselines.method import Card, Estimate
from model_export.training.targets import target_spectrum
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

MAX_TALKERS = 3
"""Most talkers in a scene of the comparison; count classes are 0 to this"""
GRID_SIZE = 360
SIGMA = float(np.deg2rad(5.0))
"""Width of the target spectra's wrapped Gaussians, the paper's for two talkers and more"""
COUNT_WEIGHT = 0.05
"""Weight of the count's cross entropy, as in the paper's code"""


@dataclass(frozen=True, slots=True)
class Truth:
    """The sources of a batch."""

    azimuth: Tensor
    """(B, MAX_TALKERS) radians"""
    mask: Tensor
    """(B, MAX_TALKERS) bool, True for sources, which come first"""

    @property
    def count(self) -> Tensor:
        """Number of sources (B,) int."""
        return self.mask.sum(-1)

    def to(self, device: str) -> Truth:
        """Copy to a device."""
        return Truth(self.azimuth.to(device), self.mask.to(device))


@dataclass(frozen=True, slots=True)
class Prediction:
    """A network's output for a batch: a spectrum or directions, and a count."""

    count: Tensor
    """(B, MAX_TALKERS + 1) logits"""
    spectrum: Tensor | None = None
    """(B, A), higher where a source is more likely"""
    vectors: tuple[Tensor, ...] = field(default=())
    """(B, M, 2) for 1, 2, ... sources: x and y towards each, not necessarily of unit length"""
    angles: tuple[Tensor, ...] = field(default=())
    """(B, M) radians, any wrap, for 1, 2, ... sources"""
    projector: Tensor | None = None
    """(B, F, N, N) complex, hybrid methods' projectors onto the signal subspaces"""
    covariance: Tensor | None = None
    """(B, F, N, N) complex, from methods whose loss uses it"""


class BaselineNetwork(nn.Module):
    """A learned method for one array's microphone count.

    ``forward`` takes the array. If ``steered``, steering vectors are part of the method, and
    training may turn the array together with the labels; features are never turned.
    """

    card: ClassVar[Card]
    steered: ClassVar[bool] = False
    learning_rate: ClassVar[float] = 1e-3
    """Adam's initial learning rate"""

    @abstractmethod
    def features(self, audio: FloatArray) -> FloatArray:
        """The network's input (B, ...) float32 for windows (B, N, T) at 16 kHz, T as trained."""

    @abstractmethod
    def forward(
        self, features: Tensor, array: MicrophoneArray, counts: Tensor | None = None
    ) -> Prediction:
        """The network's output for features (B, ...).

        ``counts`` (B,) are known numbers of sources, the true ones in training; with None the
        network estimates them if it needs them.
        """

    def loss(self, prediction: Prediction, truth: Truth, array: MicrophoneArray) -> Tensor:
        """Training loss: the loss of the outputs that exist, and the count's."""
        return direction_loss(prediction, truth) + COUNT_WEIGHT * count_loss(prediction, truth)


def scaled(size: int, width: float) -> int:
    """A hidden size at a width, 1 being the publication's; at least 8."""
    return max(8, round(size * width))


def direction_loss(prediction: Prediction, truth: Truth) -> Tensor:
    """Squared error of the spectrum, or of vectors or angles under the best permutation."""
    if prediction.spectrum is not None:
        return spectrum_loss(prediction.spectrum, truth)
    if prediction.vectors:
        wanted = torch.stack([truth.azimuth.cos(), truth.azimuth.sin()], -1)
        return _permuted(prediction.vectors, wanted, truth, vector_squares)
    # RMSPE over the batch; the slope of its root would be infinite at zero.
    return (_permuted(prediction.angles, truth.azimuth, truth, circular_squares) + 1e-9).sqrt()


def spectrum_loss(spectrum: Tensor, truth: Truth) -> Tensor:
    """Mean squared error against wrapped Gaussians with a maximum of 1; without sources, zeros."""
    grid = torch.arange(spectrum.shape[-1], device=spectrum.device) * (
        2 * torch.pi / spectrum.shape[-1]
    )
    target = target_spectrum(truth.azimuth, truth.mask, grid, SIGMA)
    return (spectrum - target).square().mean()


def count_loss(prediction: Prediction, truth: Truth) -> Tensor:
    """Cross entropy of the number of sources."""
    return F.cross_entropy(prediction.count, truth.count)


def vector_squares(first: Tensor, second: Tensor) -> Tensor:
    """Squared distance of vectors (..., 2)."""
    return (first - second).square().sum(-1)


def circular_squares(first: Tensor, second: Tensor) -> Tensor:
    """Squared distance on the circle in radians squared."""
    wrapped = torch.remainder(first - second + torch.pi, 2 * torch.pi) - torch.pi
    return wrapped.square()


def _permuted(
    outputs: Sequence[Tensor],
    wanted: Tensor,
    truth: Truth,
    squares: Callable[[Tensor, Tensor], Tensor],
) -> Tensor:
    """Mean square over the scenes with sources, each under its best permutation.

    ``outputs`` are for 1, 2, ... sources, ``wanted`` is (B, MAX_TALKERS, ...).
    """
    total = outputs[0].sum() * 0.0
    for count, output in enumerate(outputs, start=1):
        scenes = truth.count == count
        if scenes.any():
            target = wanted[scenes][:, :count]
            errors = [
                squares(output[scenes][:, list(order)], target).mean(-1)
                for order in permutations(range(count))
            ]
            total = total + torch.stack(errors).amin(0).sum()
    return total / (truth.count > 0).sum().clamp(min=1)


class LearnedMethod:
    """A trained network as a method."""

    counts = True

    def __init__(self, network: BaselineNetwork, card: Card | None = None) -> None:
        self.network = network.eval()
        self.card = card or network.card

    @torch.no_grad()
    def localize(
        self, audio: FloatArray, array: MicrophoneArray, num_sources: int | None = None
    ) -> Estimate:
        """Directions of one window; the network counts them if no count is given."""
        features = torch.from_numpy(self.network.features(audio[None]))
        known = None if num_sources is None else torch.tensor([num_sources])
        prediction = self.network(features, array, known)
        count = int(prediction.count[0].argmax()) if num_sources is None else num_sources
        return decoded(prediction, min(count, MAX_TALKERS))


def decoded(prediction: Prediction, count: int) -> Estimate:
    """The first scene's directions for a count, from the spectrum's peaks if there is one."""
    spectrum = None
    if prediction.spectrum is not None:
        spectrum = prediction.spectrum[0].float().numpy()
        return Estimate.of_spectrum(spectrum, count)
    if count == 0:
        return Estimate(np.empty(0))
    if prediction.vectors:
        x, y = prediction.vectors[count - 1][0].float().unbind(-1)
        return Estimate(torch.atan2(y, x).numpy() % (2 * np.pi))
    return Estimate(prediction.angles[count - 1][0].float().numpy() % (2 * np.pi))

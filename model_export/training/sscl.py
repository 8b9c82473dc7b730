"""Self-supervised spatial correlation learning, the first stage of the paper's training.

One microphone is masked (``training.masking``) and reconstructed from the others. Directions are
not used, so unlabelled recordings serve as well as simulated scenes. Only the encoder goes on to
the supervised stage. The paper's decoder is a U-net that draws magnitude and phase of the masked
channel as an image; this one differs:

- The decoder predicts how to combine the other microphones: one complex coefficient per bin and
  pair of microphones, for the whole window, by one linear map that all bins share, as in the
  covariance regressor. The reconstruction is this combination in every cell. The latent features
  cannot carry details of single cells, only the spatial correlation of their bin (for one source
  the best coefficients are the covariance's entries), and their row f learns to belong to bin f.
- The error is that of the complex value, relative to the cell's norm: magnitude and phase at once,
  without regressing a wrapped phase. It counts only in masked cells, and there in the louder half
  of every bin, since sensor noise cannot be reconstructed from other microphones.
- 40 to 75 % of the microphone's cells are masked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from model_export.simulation.scenes import Scene
from model_export.training.config import TrainingConfig
from model_export.training.masking import draw_mask, masked_features
from model_export.training.networks import LATENT
from model_export.training.networks.encoder import Encoder
from model_export.training.precision import training_precision
from model_export.training.reparametrize import load_plain, reparametrize
from model_export.training.task import STFT, Batch, Task
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.types import BoolArray, FloatArray


class ReconstructionDecoder(nn.Module):
    """Maps latent features (B, F, 64) to combination coefficients (B, F, N, N), complex.

    Row n holds the other microphones' coefficients for microphone n; its own entry is zero.
    """

    def __init__(self, num_microphones: int) -> None:
        super().__init__()
        self.num_microphones = num_microphones
        self.linear = nn.Linear(LATENT, 2 * num_microphones**2)

    def forward(self, latent: Tensor) -> Tensor:
        size = self.num_microphones
        real, imaginary = self.linear(latent).unflatten(-1, (2, size, size)).unbind(-3)
        others = 1 - torch.eye(size, device=latent.device)
        return torch.complex(real * others, imaginary * others)


class SsclPipeline(nn.Module):
    """The supervised stage's encoder, and a decoder that is discarded after this stage."""

    def __init__(self, num_microphones: int) -> None:
        super().__init__()
        self.encoder = Encoder(num_microphones)
        self.decoder = ReconstructionDecoder(num_microphones)

    def forward(self, features: Tensor, spectra: Tensor, microphone: Tensor) -> Tensor:
        """Reconstruct the masked microphones' spectra (B, F, L) complex from all others'.

        Parameters
        ----------
        features : (B, 2N, 257, 64) real
            Features with the microphone masked (``masking.masked_features``).
            spectra : (B, N, 257, 64) complex
                Spectra of all microphones; those of the masked one are not used.
            microphone : (B,) int
                The masked microphone of every scene.
        """
        # The rest needs the precision of float32.
        with training_precision(features, training=self.training):
            latent = self.encoder(features.contiguous(memory_format=torch.channels_last))
        coefficients = self.decoder(latent.float())  # (B, F, N, N)
        rows = coefficients[torch.arange(len(microphone)), :, microphone]  # (B, F, N)
        return torch.einsum("bfn,bnfl->bfl", rows, spectra)


@dataclass(frozen=True)
class MaskedBatch(Batch):
    """Scenes of N microphones, one of which is masked in every scene; F = 257 bins, L = 64."""

    features: Tensor
    """(B, 2N, F, L) float32, without the masked microphone's cells"""
    spectra: Tensor
    """(B, N, F, L) complex64, of unit norm over the microphones in every cell"""
    microphone: Tensor
    """(B,) int64, the masked microphones"""
    cells: Tensor
    """(B, F, L) bool, the masked cells that count"""


def collate_masked(
    rng: np.random.Generator, scenes: Sequence[Scene], level_exponent: float = 0.0
) -> MaskedBatch:
    """Mask a random microphone of every scene with a random mask."""
    spectra = STFT.transform(np.stack([scene.audio for scene in scenes]))  # (B, N, F, L)
    microphone = rng.integers(spectra.shape[1], size=len(spectra))
    mask = np.stack([draw_mask(rng, *spectra.shape[2:]) for _ in scenes])
    power = (spectra.real**2 + spectra.imag**2).sum(axis=1)  # (B, F, L)
    norm = np.sqrt(np.maximum(power, np.finfo(np.float32).tiny))
    return MaskedBatch(
        features=torch.from_numpy(masked_features(spectra, microphone, mask, level_exponent)),
        spectra=torch.from_numpy(spectra / norm[:, None]),
        microphone=torch.from_numpy(microphone),
        cells=torch.from_numpy(mask & louder_half(power)),
    )


class SsclTask:
    """Reconstruct a random microphone in masked cells of one array's scenes.

    Parameters
    ----------
    config : TrainingConfig
    array : MicrophoneArray, optional
        Replaces the configuration's preset.
    """

    def __init__(self, config: TrainingConfig, array: MicrophoneArray | None = None) -> None:
        if config.array is None:
            raise ValueError("the sscl variant is bound to one array: name its preset")
        if config.phase_reference != "first":
            raise ValueError("the sscl variant masks features of phase_reference 'first' only")
        self.config = config
        self.array = array or preset(config.array)
        self.model = SsclPipeline(self.array.num_microphones)
        reparametrize(self.model, config)

    def start_from(self, start: Task[Any]) -> None:
        """Continue another self-supervised run, such as from simulated to recorded scenes."""
        if not isinstance(start, SsclTask):
            raise ValueError(f"{self.config.name} starts from an `sscl` run, not from another kind")
        load_plain(self.model, start.model.state_dict())

    def losses(self, batch: MaskedBatch) -> dict[str, Tensor]:
        """Share of the masked channel's power that is not reconstructed."""
        scenes = torch.arange(len(batch.microphone))
        truth = batch.spectra[scenes, batch.microphone]  # (B, F, L)
        reconstruction = self.model(batch.features, batch.spectra, batch.microphone)
        error = torch.view_as_real(truth - reconstruction).square().sum(-1)
        power = torch.view_as_real(truth).square().sum(-1)
        cells = batch.cells
        return {"loss": (error * cells).sum() / (power * cells).sum().clamp(min=1e-6)}

    def scores(self, batch: MaskedBatch) -> dict[str, Tensor]:
        return {"unexplained": self.losses(batch)["loss"][None]}


def louder_half(power: FloatArray) -> BoolArray:
    """Cells (B, F, L) bool whose power exceeds their bin's median over time; none in silence."""
    louder: BoolArray = power > np.median(power, axis=-1, keepdims=True)
    return louder


def load_encoder(encoder: Encoder, start: SsclTask, config: TrainingConfig) -> None:
    """Copy all parameters and statistics of the self-supervised encoder.

    ``start`` is a run as ``train.load_run`` gives it, of the text's plain parameters.

    Raises
    ------
    ValueError
        If its array, phase reference or level exponent differs, or the name or shape of a
        parameter.
    """
    start.config.check_features(config)
    try:
        load_plain(encoder, start.model.encoder.state_dict())
    except RuntimeError as error:
        raise ValueError(f"the encoder of {start.config.name} does not fit: {error}") from error

"""The paper's network as it is trained: the same function of other parameters, in another order.

What ships is the text's network. While it is trained

- the last convolution's kernels may be cosines over its 257 output channels times free kernels, so
  that neighbouring bins, which their channels only come to stand for in training, learn together;
- pooling may come before batch norm, which then meets a quarter of the cells. A maximum commutes
  with the norm where its scale is positive, so the scale is a magnitude.

``merge`` turns the trained network into the text's, and ``load_plain`` goes the other way.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from model_export.training.config import TrainingConfig
from model_export.training.networks.encoder import ConvBlock, Encoder


class SmoothKernels(nn.Module):
    """Kernels (O, I, H, W) as K cosines over the output channels times free ones (K, I, H, W)."""

    basis: Tensor

    def __init__(self, outputs: int, cosines: int) -> None:
        super().__init__()
        place = (torch.arange(outputs) + 0.5) / outputs
        basis = (2 / cosines) ** 0.5 * torch.cos(torch.pi * place[:, None] * torch.arange(cosines))
        basis[:, 0] = cosines**-0.5
        self.register_buffer("basis", basis, persistent=False)

    def forward(self, free: Tensor) -> Tensor:
        return torch.einsum("ok,kihw->oihw", self.basis, free)

    def right_inverse(self, kernels: Tensor) -> Tensor:
        """The free kernels that come nearest."""
        outputs, cosines = self.basis.shape
        return cosines / outputs * torch.einsum("ok,oihw->kihw", self.basis, kernels)


class Magnitude(nn.Module):
    """A scale that cannot be negative."""

    def forward(self, scale: Tensor) -> Tensor:
        return scale.abs()

    def right_inverse(self, scale: Tensor) -> Tensor:
        if (scale < 0).any():
            raise ValueError("a negative scale of a norm cannot be trained with pool_first")
        return scale


def last_convolution(encoder: Encoder) -> nn.Conv2d:
    """The one whose output channels stand for bins."""
    block = encoder[3]
    assert isinstance(block, ConvBlock)
    assert isinstance(block[0], nn.Conv2d)
    return block[0]


def reparametrize(model: nn.Module, config: TrainingConfig) -> None:
    """Make a fresh model the one that the configuration trains."""
    for module in list(model.modules()):
        if isinstance(module, ConvBlock) and config.pool_first:
            module.pools_first = True
            parametrize.register_parametrization(module[1], "weight", Magnitude())
        if isinstance(module, Encoder) and config.smooth_kernels:
            convolution = last_convolution(module)
            outputs = convolution.out_channels
            smooth = SmoothKernels(outputs, config.smooth_kernels)
            parametrize.register_parametrization(convolution, "weight", smooth)
            with torch.no_grad():  # what the projection has taken of the kernels' size
                convolution.weight = convolution.weight * (outputs / config.smooth_kernels) ** 0.5


def merge(model: nn.Module) -> None:
    """Make it the text's network, of plain parameters and with the same function in evaluation."""
    for module in list(model.modules()):
        if isinstance(module, ConvBlock):
            module.pools_first = False
        if parametrize.is_parametrized(module):
            parametrize.remove_parametrizations(module, "weight", leave_parametrized=True)


def load_plain(model: nn.Module, state: Mapping[str, Tensor]) -> None:
    """Load the parameters of the text's network into a model that is trained otherwise.

    Raises
    ------
    RuntimeError
        If a name or a shape differs.
    ValueError
        If a norm's scale is negative, which ``pool_first`` cannot train.
    """
    tensors = dict(state)
    for path, module in model.named_modules():
        weight = f"{path}.weight"
        if parametrize.is_parametrized(module) and weight in tensors:
            parametrization = module.parametrizations.weight[0]
            inverse = parametrization.right_inverse(tensors.pop(weight))
            tensors[f"{path}.parametrizations.weight.original"] = inverse
    model.load_state_dict(tensors)

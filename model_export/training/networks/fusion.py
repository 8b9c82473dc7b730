"""Frequency attention fusion (FAF): from one spectrum per bin to the broadband spectrum."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from model_export.training.networks import NUM_BINS


class FrequencyAttentionFusion(nn.Module):
    """FAF: P(theta) = sum_f alpha_f P(f, theta) / sum_f alpha_f.

    alpha = sigmoid(W2 ReLU(W1 GAP(P))), where GAP is the mean over the angles. The paper does not
    divide the sum; divided, the fused spectrum is a convex combination and stays within [0, 1], as
    its target does. No weight belongs to an angle, so a rotated spectrum fuses to a rotated one.
    """

    def __init__(self, num_bins: int = NUM_BINS, bottleneck: int = 16) -> None:
        super().__init__()
        self.squeeze = nn.Linear(num_bins, bottleneck, bias=False)
        self.excite = nn.Linear(bottleneck, num_bins, bias=False)

    def average(self) -> None:
        """Weigh all bins alike for good: the ablation of the attention."""
        torch.nn.init.zeros_(self.excite.weight)  # a sigmoid of zero is the same everywhere
        self.requires_grad_(False)

    def attention(self, spectrum: Tensor, bins: Tensor | None = None) -> Tensor:
        """Weights (B, F) in (0, 1) of the spectra (B, F, A), which may be those of some bins."""
        chosen = slice(None) if bins is None else bins
        squeeze = self.squeeze.weight[:, chosen]  # (16, F)
        pooled = spectrum.mean(-1) * (self.squeeze.in_features / squeeze.shape[1])  # (B, F)
        hidden = torch.relu(pooled @ squeeze.T)  # (B, 16)
        return torch.sigmoid(hidden @ self.excite.weight[chosen].T)  # (B, F)

    def forward(self, spectrum: Tensor, bins: Tensor | None = None) -> Tensor:
        alpha = self.attention(spectrum, bins)  # (B, F)
        fused = torch.einsum("bf,bfa->ba", alpha, spectrum)  # (B, A)
        return fused / alpha.sum(-1, keepdim=True)

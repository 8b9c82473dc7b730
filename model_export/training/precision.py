"""Precision of training: bfloat16 where the processor multiplies it."""

from __future__ import annotations

from functools import cache

import torch
from torch import Tensor


def training_precision(features: Tensor, *, training: bool) -> torch.autocast:
    """Autocast to bfloat16 in training, on the device of ``features``; float32 everywhere else.

    bfloat16 halves the convolutions' cost on a CPU that has it. On others torch emulates it: 16
    windows through the light network take 5.2 s instead of 0.3 s (AMD EPYC, Zen 3).
    """
    device = features.device.type
    return torch.autocast(device, torch.bfloat16, enabled=training and _has_bfloat16(device))


@cache
def _has_bfloat16(device: str) -> bool:
    if device != "cpu":
        return True
    able = torch.cpu.get_capabilities()
    return bool(able.get("avx512_bf16") or able.get("amx_bf16"))

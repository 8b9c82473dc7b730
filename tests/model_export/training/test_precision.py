"""Training is in bfloat16 where the processor multiplies it, and nowhere else."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
import torch
from torch.nn import functional

from model_export.training import precision

pytestmark = pytest.mark.torch


@pytest.fixture(autouse=True)
def forgotten() -> Iterator[None]:
    """Results for another processor are not cached."""
    precision._has_bfloat16.cache_clear()
    yield
    precision._has_bfloat16.cache_clear()


@pytest.mark.parametrize(
    ("able", "training", "found"),
    [
        ({"avx2": True}, True, torch.float32),
        ({"avx512_bf16": True}, True, torch.bfloat16),
        ({"amx_bf16": True}, True, torch.bfloat16),
        ({"amx_bf16": True}, False, torch.float32),
    ],
)
def test_convolutions_are_in_what_the_processor_multiplies(
    able: dict[str, Any], training: bool, found: torch.dtype, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: able)
    features = torch.ones(1, 1, 4, 4)
    with precision.training_precision(features, training=training):
        assert functional.conv2d(features, torch.ones(1, 1, 3, 3)).dtype == found

"""DOANet: its size, and the steps that its convolutions leave of a window."""

from __future__ import annotations

import pytest
import torch

from model_export.baselines.doanet import DoanetTrunk, WaveformTrunk

pytestmark = pytest.mark.torch


def test_it_has_the_size_that_its_repository_states() -> None:
    trunk = WaveformTrunk(4, 1.0)
    parameters = sum(parameter.numel() for parameter in trunk.parameters())
    assert parameters + 2 * 1025 == pytest.approx(67.9e6, rel=0.01)


@pytest.mark.parametrize(("samples", "steps"), [(16000, 43), (16640, 69)])
def test_a_second_of_audio_is_long_enough_for_all_layers(samples: int, steps: int) -> None:
    trunk = WaveformTrunk(4, 1 / 64)
    assert trunk.layers(torch.zeros(1, 4, samples)).shape[-1] == steps


def test_the_matched_trunk_keeps_all_frames_until_its_maximum() -> None:
    trunk = DoanetTrunk(4, width=1 / 16)
    assert trunk.layers(torch.zeros(1, 8 * 257, 64)).shape == (1, 64, 64)

"""Transformer: its size, its patches, and the phases that it needs."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from overfitting import windows

from model_export.baselines.transformer import (
    NUM_PATCHES,
    PatchEmbedding,
    Transformer,
    TransformerTrunk,
)

pytestmark = pytest.mark.torch


def test_it_has_the_size_of_the_publication_with_shared_encoders() -> None:
    network = Transformer(2)
    parts = (network.patches, network.encoder, network.integration, network.norm)
    ours = sum(parameter.numel() for part in parts for parameter in part.parameters())
    phases = 2 * 16 * 16 * 1024
    assert ours - phases + 2 * 1025 == pytest.approx(38.2e6, rel=0.005)


def test_its_patches_cover_the_whole_map() -> None:
    patches = PatchEmbedding(1, 8)
    blank = patches(torch.zeros(1, 1, 129, 61))
    assert blank.shape == (1, 1 + NUM_PATCHES, 8)
    for row, column, patch in ((0, 0, 0), (128, 60, NUM_PATCHES - 1)):
        spot = torch.zeros(1, 1, 129, 61)
        spot[..., row, column] = 1
        changed = (patches(spot) - blank).abs().sum(-1)[0].nonzero().flatten()
        assert changed.tolist() == [1 + patch]


def test_a_matched_trunks_patches_are_as_many() -> None:
    trunk = TransformerTrunk(4, width=1 / 16)
    assert trunk.patches(torch.zeros(1, 8, 257, 64)).shape == (1, 1 + NUM_PATCHES, 64)


def test_phases_are_relative_to_the_first_microphone() -> None:
    audio = np.repeat(windows(1), 2, axis=1)
    audio[:, 1] = -audio[:, 1]
    level, cosine, sine = np.moveaxis(Transformer(2, width=1 / 16).features(audio), 2, 0)
    assert level.shape == (2, 2, 129, 61)
    np.testing.assert_allclose(level[:, 0], level[:, 1], atol=1e-5)
    np.testing.assert_allclose(cosine[:, 0], 1, atol=1e-5)
    np.testing.assert_allclose(cosine[:, 1], -1, atol=1e-5)
    np.testing.assert_allclose(sine, 0, atol=1e-5)

"""Seeded parameters and a handful of scenes for the tests of learned methods."""

from __future__ import annotations

import pytest
import torch
from overfitting import talkers

from model_export.simulation.protocol import SimulatedScene


@pytest.fixture(autouse=True)
def seeded() -> None:
    torch.manual_seed(0)


@pytest.fixture(scope="session")
def one_of_each_count() -> list[SimulatedScene]:
    """One, two and three talkers: methods have outputs for each."""
    return talkers((1, 2, 3))


@pytest.fixture(scope="session")
def scenes() -> list[SimulatedScene]:
    return talkers()

"""Sizes of the experiments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Scale:
    """Numbers of scenes and epochs that all experiments share."""

    name: str
    train_scenes: int
    epochs: int
    pretraining_epochs: int
    """Epochs of self-supervised spatial correlation learning, on the same scenes without labels"""
    test_scenes: int
    """Scenes in each cell of the main table"""
    sweep_scenes: int
    """Scenes at each point of a curve, and in each cell of another room or array"""
    labelled_directions: int
    """Directions of a one-shot fine-tuning, one scene each"""
    tuning_epochs: int
    reduced: bool
    """Whether networks that are too heavy for a CPU are narrower than cited"""
    batch_size: int = 16


SCALES: Mapping[str, Scale] = {
    scale.name: scale
    for scale in (
        Scale("smoke", 12, 1, 1, 4, 2, 6, 1, reduced=True, batch_size=6),
        Scale("small", 2400, 5, 4, 120, 60, 72, 10, reduced=True),
        # As in the paper: 100 training scenes per degree and count, 25 test scenes per degree.
        Scale("paper", 72_000, 100, 400, 9000, 9000, 360, 50, reduced=False, batch_size=32),
    )
}

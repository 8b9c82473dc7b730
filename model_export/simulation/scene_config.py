"""Contents of training scenes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class SceneConfig:
    """Contents of a training scene: probabilities, unless a field says otherwise.

    ``singles.SinglesBank.draw`` says which fields apply to single talkers of a bank.
    """

    source_counts: tuple[float, ...] = (0.0, 0.55, 0.35, 0.10)
    """Probability of 0, 1, 2, ... talkers"""
    min_separation: float = np.deg2rad(12.0)
    """Radians between talkers"""
    snr_db: tuple[float, float] = (-5.0, 35.0)
    """Signal-to-noise ratio against all noise, uniform"""
    noisy: float = 0.0
    """Share of the scenes whose ratio is drawn from ``noisy_snr_db``; the paper's code has 0.6"""
    noisy_snr_db: tuple[float, float] = (-10.0, 30.0)
    """Signal-to-noise ratio of noisy scenes, uniform; the paper's code has the same"""
    symmetric: bool = False
    """Whether single talkers are turned and mirrored at random, as their array allows"""
    level_difference_db: float = 3.0
    """Talkers differ by up to this much"""
    position_error: float = 0.0015
    """Metres, standard deviation of the microphones against their nominal places"""
    diffuse: float = 0.5
    recorded: float = 0.4
    """Share of the diffuse noises that are recorded, if recordings are given"""
    coupled: float = 0.15
    machine: float = 0.15
    """A fan at one place, which is no talker; more often where nobody talks"""
    crosstalk: float = 0.15
    band_limit: float = 0.12
    quantised: float = 0.2
    late: float = 0.0
    """All talkers begin inside the window, as a stream hears them first"""

    @property
    def known_count(self) -> int | None:
        """The number of talkers, where all scenes have the same."""
        possible = [count for count, chance in enumerate(self.source_counts) if chance]
        return possible[0] if len(possible) == 1 else None

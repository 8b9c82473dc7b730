"""Elevated talkers: the errors on the sphere, and a small run of the whole command."""

from __future__ import annotations

import re

import numpy as np
import pytest

from model_export.evaluation.methods import PEER, Methods
from model_export.evaluation.spatial import errors_deg, measure_spatial, spatial_cells
from model_export.evaluation.workers import Inputs, Workers
from model_export.simulation.synthesis import synthetic_voice


def test_errors_are_great_circle_angles_and_a_missed_talker_is_a_right_angle() -> None:
    ahead, left, up = np.eye(3)
    between = (ahead + up) / np.sqrt(2)
    assert errors_deg(np.array([up, left]), np.array([between, left])) == pytest.approx([45, 0])
    assert errors_deg(np.array([left]), np.array([ahead, left])) == pytest.approx([90, 0])
    assert errors_deg(np.zeros((0, 3)), np.array([up])) == pytest.approx([90])


def test_every_method_finds_a_talker_above_or_below() -> None:
    cell = spatial_cells()[0]
    assert cell.name == "tetrahedron 50 mm, 1 talker, RT60 0.3 s"
    voices = [synthetic_voice(np.random.default_rng(seed), 1.2) for seed in range(3)]
    with Workers.start(Inputs(Methods([]), voices, 1)) as workers:
        table = measure_spatial(workers, 3, [cell])
    rows = re.findall(r"^\| (\S.*?) \| ([0-9.]+) \(.* to .*\)° \|", table, re.MULTILINE)
    assert {name for name, _ in rows} == {
        "norm_music",
        "srp_phat",
        PEER,
        "pyroomacoustics SRP-PHAT",
    }
    assert all(float(median) < 10 for _, median in rows), table

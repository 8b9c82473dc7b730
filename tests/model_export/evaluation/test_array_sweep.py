"""Arrays of 2 to 64 microphones: the model reports the talker, also with more than in training."""

from __future__ import annotations

import numpy as np
import pytest

from model_export.evaluation.array_sweep import (
    SHAPES,
    Case,
    Outcome,
    cases,
    ring,
    sweep,
    table,
)
from model_export.simulation.rigid_sphere import rigid_sphere_response
from model_export.simulation.synthesis import synthetic_voice
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray
from service.inference.bundle import Bundle
from service.inference.localizer import localizer_of
from service.inference.registry import BundleRegistry

DRY, LIVE = 0.0, 0.2
"""RT60 in seconds"""
SWEPT = [
    Case("line, 25 mm", 2, DRY, 15.0),
    *(Case("ring r 200 mm", number, DRY, 5.0) for number in (4, 8, 16, 26, 32, 48, 64)),
    *(Case("level grid, 42 mm", number, DRY, 30.0) for number in (4, 26, 32, 64)),
    *(Case("sphere r 42 mm", number, LIVE, 15.0) for number in (8, 16, 32)),
    *(Case("rigid sphere r 42 mm", number, DRY, 30.0) for number in (8, 26, 32)),
    *(Case("line, 25 mm", number, LIVE, 30.0) for number in (8, 48)),
]


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return BundleRegistry.load().get("any-array")


@pytest.fixture(scope="module")
def speech() -> list[FloatArray]:
    rng = np.random.default_rng(2)
    return [synthetic_voice(rng, 1.04) for _ in range(8)]


@pytest.mark.parametrize("case", SWEPT, ids=str)
def test_the_talker_is_reported_and_nobody_else(
    case: Case, bundle: Bundle, speech: list[FloatArray]
) -> None:
    (outcome,) = sweep([case], speech, bundle, seed=3)
    assert (outcome.neural, outcome.others) == (True, 0)


def test_every_array_is_swept() -> None:
    swept = list(cases())
    assert {each.microphones for each in swept} >= {2, 3, 4, 8, 16, 32, 64}
    assert {each.shape for each in swept} == set(SHAPES)
    for each in swept:
        MicrophoneArray(each.shape, SHAPES[each.shape](each.microphones))


@pytest.mark.parametrize("number", [16, 32])
def test_sensor_noise_is_nobody_to_many_microphones(number: int, bundle: Bundle) -> None:
    rng = np.random.default_rng(number)
    array = MicrophoneArray("ring", ring(number, 0.05))
    noise = rng.standard_normal((1, number, 16640)).astype(np.float32)
    (estimate,) = localizer_of(bundle, array).estimate(noise, None, 3)
    assert estimate.sources == ()


def test_a_rigid_sphere_scatters_as_physics_has_it() -> None:
    """Small ones delay by 3/2 of their radius; large ones double the pressure in front."""
    radius = 0.042
    ends = radius * np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0]])
    response = rigid_sphere_response(ends, np.array([10.0, 40_000.0]), np.array([1.0, 0, 0]))
    phase = 2 * np.pi * 10 * radius / 343
    np.testing.assert_allclose(
        np.angle(response[:, 0]), 1.5 * phase * np.array([1, -1, 0]), atol=1e-5
    )
    assert abs(response[0, 1]) == pytest.approx(2, rel=0.01)


def test_the_table_counts_by_the_number_of_microphones() -> None:
    def outcome(number: int, *found: bool, others: int = 0) -> Outcome:
        return Outcome(Case("ring r 50 mm", number, 0.0, 30.0), *found, others)

    rows = table(
        [outcome(4, True, True), outcome(8, True, False), outcome(8, False, True, others=2)]
    )
    assert rows.splitlines()[2:] == [
        "| 4 | 1 | 1 | 1 | 0 | 0 |",
        "| 8 | 2 | 1 | 1 | 1 | 2 |",
        "| all | 3 | 2 | 2 | 1 | 2 |",
    ]

"""Symmetries of arrays: how many there are, and that a seen scene is one that could be heard."""

from __future__ import annotations

import numpy as np
import pytest

from model_export.simulation.arrays import named_array
from model_export.simulation.protocol import SceneProtocol, simulate_scene
from model_export.simulation.symmetry import symmetries
from model_export.simulation.synthesis import synthetic_voice
from service.doa.presets import preset
from service.inference.classical import ClassicalLocalizer

SQUARE = preset("respeaker-usb-4mic-v2")


@pytest.mark.parametrize(
    ("name", "expected"),
    [("respeaker-usb-4mic-v2", 8), ("6-mic ring r 36 mm", 12), ("irregular 4-mic", 1)],
)
def test_symmetries_are_those_of_the_array(name: str, expected: int) -> None:
    found = symmetries(named_array(name))
    assert len({(view.sign, round(view.turn, 4)) for view in found}) == len(found) == expected
    assert (found[0].sign, found[0].turn) == (1, 0)


def test_a_view_is_what_the_array_hears_of_turned_and_mirrored_sources() -> None:
    voice = synthetic_voice(np.random.default_rng(0), 1.0)
    scene = simulate_scene(SceneProtocol(orders=(0, 0)), [voice], [3])
    localizer = ClassicalLocalizer("srp_phat", SQUARE)
    for view in symmetries(SQUARE):
        (estimate,) = localizer.estimate(scene.audio[view.permutation][None], 1, 1)
        error = estimate.sources[0].azimuth - view.azimuth(scene.azimuth)[0]
        assert abs((error + np.pi) % (2 * np.pi) - np.pi) < np.deg2rad(3)

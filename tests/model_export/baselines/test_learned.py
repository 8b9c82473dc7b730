"""Properties of every learned method that outputs directions itself, in both tracks."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from overfitting import overfitted, untrained_parameters, windows

from model_export.baselines.learned import learned_methods
from model_export.baselines.network import BaselineNetwork, LearnedMethod
from model_export.simulation.arrays import named_array
from model_export.simulation.protocol import SimulatedScene

pytestmark = pytest.mark.torch

METHODS = learned_methods()
ARRAYS = {4: named_array("respeaker-usb-4mic-v2"), 6: named_array("6-mic ring r 36 mm")}
TRACKS = ("cited", "matched")


def network_of(name: str, track: str, num_microphones: int = 4) -> BaselineNetwork:
    """A network at the width that one CPU thread can train."""
    method = METHODS[name]
    if track == "cited":
        return method.cited(num_microphones, width=method.cited_width)
    return method.matched(num_microphones, width=method.trunk_width)


@pytest.mark.parametrize("num_microphones", [4, 6])
@pytest.mark.parametrize("track", TRACKS)
@pytest.mark.parametrize("name", METHODS)
def test_it_takes_any_number_of_microphones(name: str, track: str, num_microphones: int) -> None:
    network = network_of(name, track, num_microphones).eval()
    audio, array = windows(num_microphones), ARRAYS[num_microphones]
    features = network.features(audio)
    assert features.dtype == np.float32
    assert len(features) == 2
    with torch.no_grad():
        prediction = network(torch.from_numpy(features), array)
    assert prediction.count.shape == (2, 4)
    if prediction.spectrum is not None:
        assert prediction.spectrum.shape == (2, 360)
    else:
        assert [vectors.shape for vectors in prediction.vectors] == [(2, m, 2) for m in (1, 2, 3)]


@pytest.mark.parametrize("track", TRACKS)
@pytest.mark.parametrize("name", METHODS)
def test_a_window_is_localized_as_in_a_batch_and_as_loud_as_it_may_be(
    name: str, track: str
) -> None:
    network = network_of(name, track).eval()
    audio = windows(4)
    one, both = network.features(4 * audio[:1]), network.features(audio)
    np.testing.assert_allclose(one[0], both[0], rtol=1e-3, atol=1e-3)
    answer = LearnedMethod(network).localize(audio[0], ARRAYS[4], 2)
    assert len(answer.azimuth) <= 2
    assert ((answer.azimuth >= 0) & (answer.azimuth < 2 * np.pi)).all()


@pytest.mark.parametrize("track", TRACKS)
@pytest.mark.parametrize("name", METHODS)
def test_every_parameter_has_a_finite_gradient(
    name: str, track: str, one_of_each_count: list[SimulatedScene]
) -> None:
    assert untrained_parameters(network_of(name, track), one_of_each_count) == []


STEPS = {
    ("crnn", "cited"): 100,
    ("crnn", "matched"): 80,
    ("transformer", "cited"): 120,
    ("transformer", "matched"): 100,
    ("doanet", "cited"): 80,
    ("doanet", "matched"): 40,
    ("deepdae", "cited"): 60,
    ("deepdae", "matched"): 60,
}


@pytest.mark.learns
@pytest.mark.parametrize(("name", "track"), STEPS)
def test_it_learns(name: str, track: str, scenes: list[SimulatedScene]) -> None:
    # Six scenes, three of each count, where a step is expensive.
    few = scenes[2:] if (name, track) == ("transformer", "cited") else scenes
    assert overfitted(network_of(name, track), few, STEPS[name, track]) < 3.0

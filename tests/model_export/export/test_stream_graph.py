"""The stream graph of the covariance network against the network on the whole window."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import nn

from model_export.export.bundle import export_onnx
from model_export.export.parameters import trained_model
from model_export.export.stream_graph import StreamingWeightsNetwork, stream_graph
from model_export.training.config import Trunk
from model_export.training.weights import Separable, WeightsNetwork
from model_export.training.weights_task import WeightsTask
from service.doa.types import FloatArray
from service.inference.bundle import load_bundle
from service.inference.engine import Engine
from service.inference.registry import EMBEDDED_MODELS

pytestmark = pytest.mark.torch

BINS, FRAMES = 256, 64
REACH = 3 + 4 + 8 + 8 + 16
"""Number of past frames that the network sees; the first ones see the window's zero padding"""


@cache
def embedded_graph() -> Engine:
    """The embedded bundle's stream graph."""
    engine = load_bundle(EMBEDDED_MODELS / "any-array").covariance_stream
    assert engine is not None
    return engine


def untrained(trunk: Trunk) -> WeightsNetwork:
    """A network with random parameters and statistics, as if trained."""
    torch.manual_seed(0)
    network = WeightsNetwork(trunk)
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.running_mean = torch.randn(module.num_features) / 4
            module.running_var = torch.rand(module.num_features) + 0.5
    return network.eval()


@cache
def embedded() -> WeightsNetwork:
    task = trained_model(load_bundle(EMBEDDED_MODELS / "any-array")).task
    assert isinstance(task, WeightsTask)
    return task.model.network.eval()


@pytest.fixture(scope="module")
def features() -> FloatArray:
    rng = np.random.default_rng(0)
    return rng.standard_normal((1, 5, FRAMES, BINS)).astype(np.float32)


Step = Callable[[list[FloatArray]], list[FloatArray]]
"""Maps features and states to weights, attentions and the next states"""


def exported(network: WeightsNetwork, folder: Path) -> Engine:
    path = folder / "stream.onnx"
    export_onnx(stream_graph(network, BINS), path)
    return Engine(path.read_bytes(), path.name)


@pytest.fixture(scope="module", params=["strided", "separable"])
def untrained_network(request: pytest.FixtureRequest) -> WeightsNetwork:
    return untrained(request.param)


def in_torch(network: WeightsNetwork) -> Step:
    streaming = StreamingWeightsNetwork(network)

    def step(inputs: list[FloatArray]) -> list[FloatArray]:
        with torch.no_grad():
            return [each.numpy() for each in streaming(*map(torch.from_numpy, inputs))]

    return step


def differences(
    step: Step, network: WeightsNetwork, features: FloatArray, lengths: Iterable[int]
) -> float:
    """Largest difference of a window in steps from a whole window, relative to its maximum."""
    with torch.no_grad():
        expected = [each.numpy()[0] for each in network(torch.from_numpy(features))]
    ahead = network.lookahead
    found = [np.zeros((FRAMES + ahead, BINS)) for _ in expected]
    initial = StreamingWeightsNetwork(network).initial_state(1, BINS)
    state, position = [each.numpy() for each in initial.values()], 0
    for length in lengths:
        (*outputs,) = step([features[:, :, position : position + length], *state])
        state = outputs[2:]
        for kept, output in zip(found, outputs[:2], strict=True):
            kept[position : position + output.shape[1]] = output[0]
        position = min(position + length, FRAMES)
        if position == FRAMES:
            break
    # The newest frames have zeros for their future, as a window's last ones do.
    return max(
        float(np.abs(kept[ahead:] - whole)[REACH:].max() / np.abs(whole).max())
        for kept, whole in zip(found, expected, strict=True)
    )


LENGTHS = st.lists(st.integers(1, 12), min_size=FRAMES, max_size=FRAMES)
FEW = settings(
    max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@FEW
@given(lengths=LENGTHS)
def test_steps_of_any_length_give_the_window(
    lengths: list[int], untrained_network: WeightsNetwork, features: FloatArray
) -> None:
    step = in_torch(untrained_network)
    assert differences(step, untrained_network, features, lengths) < 1e-3


@FEW
@given(lengths=LENGTHS)
def test_steps_of_the_embedded_graph_give_the_window(
    lengths: list[int], features: FloatArray
) -> None:
    assert differences(embedded_graph().run, embedded(), features, lengths) < 1e-3


@pytest.mark.learns
def test_an_exported_graph_is_the_embedded_one(features: FloatArray, tmp_path: Path) -> None:
    engine = exported(embedded(), tmp_path)
    inputs = [features[:, :, :6], *engine.initial_state()]
    for found, expected in zip(engine.run(inputs), embedded_graph().run(inputs), strict=True):
        assert np.abs(found - expected).max() < 1e-4


@pytest.mark.learns
def test_steps_of_untrained_graphs_give_the_window(
    untrained_network: WeightsNetwork, features: FloatArray, tmp_path: Path
) -> None:
    engine = exported(untrained_network, tmp_path)
    for lengths in ([1] * FRAMES, [5] * FRAMES, [12, 1, 7, 2] * FRAMES):
        assert differences(engine.run, untrained_network, features, lengths) < 1e-3


def test_the_embedded_graph_is_the_embedded_networks(features: FloatArray) -> None:
    inputs = [features[:, :, :6], *embedded_graph().initial_state()]
    ours, theirs = in_torch(embedded())(inputs), embedded_graph().run(inputs)
    for found, expected in zip(ours, theirs, strict=True):
        assert np.abs(found - expected).max() < 1e-4


def test_a_separated_convolution_is_trained_as_what_it_serves_as() -> None:
    torch.manual_seed(1)
    block = Separable(8, 5).double()
    block.norm.eval()
    hidden = torch.randn(2, 8, 12, 10, dtype=torch.float64)
    trained = block(hidden)
    served = block.eval()(hidden)
    torch.testing.assert_close(trained, served)
    later = hidden.clone()
    later[:, :, 7:] += 1
    changed = (block(later) != served).any(dim=3).any(dim=1).any(dim=0)
    assert changed.nonzero().min() == 6

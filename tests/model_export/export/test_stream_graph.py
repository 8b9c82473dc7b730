"""The stream graph of the covariance network against the network on the whole window."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import nn

from model_export.export.bundle import export_onnx
from model_export.export.parameters import trained_model
from model_export.export.stream_graph import stream_graph
from model_export.training.config import Trunk
from model_export.training.task import WeightsTask
from model_export.training.weights import Separable, WeightsNetwork
from service.doa.types import FloatArray
from service.inference.bundle import load_bundle
from service.inference.engine import Engine
from service.inference.registry import EMBEDDED_MODELS

pytestmark = pytest.mark.torch

BINS, FRAMES = 256, 64
REACH = 3 + 4 + 8 + 8 + 16
"""Frames that the network looks back; before them it saw the window's zero padding"""


def untrained(trunk: Trunk) -> WeightsNetwork:
    """Random parameters, and statistics as if there had been a training."""
    torch.manual_seed(0)
    network = WeightsNetwork(trunk)
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.running_mean = torch.randn(module.num_features) / 4
            module.running_var = torch.rand(module.num_features) + 0.5
    return network.eval()


def embedded() -> WeightsNetwork:
    task = trained_model(load_bundle(EMBEDDED_MODELS / "any-array")).task
    assert isinstance(task, WeightsTask)
    return task.model.network.eval()


@pytest.fixture(scope="module", params=["embedded", "strided", "separable"])
def network(request: pytest.FixtureRequest) -> WeightsNetwork:
    return embedded() if request.param == "embedded" else untrained(request.param)


@pytest.fixture(scope="module")
def features() -> FloatArray:
    rng = np.random.default_rng(0)
    return rng.standard_normal((1, 5, FRAMES, BINS)).astype(np.float32)


@pytest.fixture(scope="module")
def engine(network: WeightsNetwork, tmp_path_factory: pytest.TempPathFactory) -> Engine:
    path = Path(tmp_path_factory.mktemp("stream")) / "stream.onnx"
    export_onnx(stream_graph(network, BINS), path)
    return Engine(path.read_bytes(), path.name)


@settings(
    max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(steps=st.lists(st.integers(1, 12), min_size=FRAMES, max_size=FRAMES))
def test_steps_of_any_length_give_the_window(
    steps: list[int], engine: Engine, network: WeightsNetwork, features: FloatArray
) -> None:
    with torch.no_grad():
        expected = [each.numpy()[0] for each in network(torch.from_numpy(features))]
    ahead = network.lookahead
    found = [np.zeros((FRAMES + ahead, BINS)) for _ in expected]
    state, position = engine.initial_state(), 0
    for step in steps:
        length = min(step, FRAMES - position)
        if length == 0:
            break
        (*outputs,) = engine.run([features[:, :, position : position + length], *state])
        state = outputs[2:]
        for kept, output in zip(found, outputs[:2], strict=True):
            kept[position : position + length + ahead] = output[0]
        position += length
    for kept, whole in zip(found, expected, strict=True):
        # The newest frames saw zeros behind them, as a window's last ones do.
        difference = np.abs(kept[ahead:] - whole)[REACH:]
        assert difference.max() < 1e-3 * np.abs(whole).max()


def test_the_embedded_stream_graph_is_the_embedded_networks(
    features: FloatArray, tmp_path: Path
) -> None:
    export_onnx(stream_graph(embedded(), BINS), tmp_path / "stream.onnx")
    ours = Engine((tmp_path / "stream.onnx").read_bytes(), "stream.onnx")
    theirs = load_bundle(EMBEDDED_MODELS / "any-array").covariance_stream
    assert theirs is not None
    inputs = [features[:, :, :6], *theirs.initial_state()]
    for found, expected in zip(ours.run(inputs), theirs.run(inputs), strict=True):
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

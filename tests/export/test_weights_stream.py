"""The stream graph of the covariance network against the network on the whole window."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from model_export.export import export_onnx
from model_export.parameters import trained_model
from model_export.tasks import WeightsTask
from model_export.weights import WeightsNetwork
from model_export.weights_stream import stream_graph
from service.doa.types import FloatArray
from service.inference.bundle import load_bundle
from service.inference.engine import Engine
from service.inference.registry import EMBEDDED_MODELS

pytestmark = pytest.mark.torch

BINS, FRAMES = 256, 64
REACH = 3 + 4 + 8 + 8 + 16
"""Frames that the network looks back; before them it saw the window's zero padding"""


@pytest.fixture(scope="module")
def network() -> WeightsNetwork:
    task = trained_model(load_bundle(EMBEDDED_MODELS / "any-array")).task
    assert isinstance(task, WeightsTask)
    return task.model.network.eval()


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
    engine: Engine, features: FloatArray
) -> None:
    embedded = load_bundle(EMBEDDED_MODELS / "any-array").covariance_stream
    assert embedded is not None
    inputs = [features[:, :, :6], *embedded.initial_state()]
    for ours, theirs in zip(engine.run(inputs), embedded.run(inputs), strict=True):
        assert np.abs(ours - theirs).max() < 1e-4

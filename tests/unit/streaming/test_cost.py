"""Estimates of what streams cost, against what was measured (``tests/bench/costs.py``)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from neuralmusic.protocol.client_messages import Start
from service.streaming.cost import ORDINARY, StreamCost, stream_cost


def start(
    microphones: int, sample_rate: int = 16_000, channels: int | None = None, **fields: Any
) -> Start:
    angles = 2 * np.pi * np.arange(microphones) / microphones
    ring = [(0.1 * float(np.cos(a)), 0.1 * float(np.sin(a)), 0.0) for a in angles]
    audio = {
        "encoding": "pcm_f32le",
        "sample_rate": sample_rate,
        "channels": channels or microphones,
    }
    return Start.model_validate(
        {"type": "start", "audio": audio, "array": {"positions_m": ring}, **fields}
    )


def cost(begun: Start, interval_ms: int) -> StreamCost:
    return stream_cost(begun, interval_ms)


@pytest.mark.parametrize(
    ("begun", "interval_ms", "measured"),
    [
        (start(4), 100, 0.068),
        (start(4), 20, 0.301),
        (start(4), 1000, 0.020),
        (start(8), 100, 0.098),
        (start(16), 100, 0.148),
        (start(32), 100, 0.323),
        (start(4, method="music"), 100, 0.019),
        (start(16, method="music"), 100, 0.096),
        (start(32, method="music"), 1000, 0.063),
        (start(4, 384_000, method="music"), 1000, 0.070),
        (start(32, 384_000, 64, method="music"), 1000, 0.764),
    ],
)
def test_estimates_are_within_a_factor_of_what_was_measured(
    begun: Start, interval_ms: int, measured: float
) -> None:
    estimate = cost(begun, interval_ms).share
    assert measured / 1.6 < estimate < 1.6 * measured


def test_a_robot_s_stream_is_ordinary_and_others_are_heavy() -> None:
    robot = cost(Start.model_validate({**start(4).model_dump(), "array": {"name": "uma-8"}}), 100)
    assert not robot.heavy
    assert robot.share < 2 * ORDINARY.share
    assert not cost(start(4, 48_000), 100).heavy
    assert cost(start(32), 100).heavy  # its steps hold up the others
    assert cost(start(4), 20).heavy
    assert cost(start(64), 20).share > 1  # and no core can carry this one


def test_height_costs_more() -> None:
    flat = start(4)
    assert flat.array.positions_m is not None
    raised = [(x, y, 0.02 * (x > 0)) for x, y, _ in flat.array.positions_m]
    high = Start.model_validate({**flat.model_dump(), "array": {"positions_m": raised}})
    upper = Start.model_validate({**flat.model_dump(), "hemisphere": "upper"})
    assert cost(high, 100) == cost(upper, 100)
    assert cost(high, 100).share > cost(flat, 100).share

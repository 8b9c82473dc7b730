"""``neuralmusic bench --json``: the figures that scripts read, and what they are of the times."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from neuralmusic.cli import main
from service.bench.window import Timing
from service.cli.bench import THREAD_VARIABLES

STAGES = {"stft", "covariance_net", "count_net", "evd", "spectrum", "fusion", "peaks"}


def test_it_says_what_every_stage_costs(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in THREAD_VARIABLES:
        monkeypatch.setenv(name, "1")
    flags = ["--threads", "1", "--repeats", "3", "--microphones", "4", "8"]
    assert main(["bench", "--json", *flags]) == 0
    said: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert list(said["arrays"]) == ["4", "8"]
    for figures in (said, *said["arrays"].values()):
        for name in ("neural_window_ms", "norm_music_window_ms", "stream_hop_ms"):
            assert set(figures[name]) == {"median", "p99"}
        assert set(figures["stages_ms"]) >= STAGES
        # The stages are parts of the window: none alone can cost more than a few windows.
        assert max(figures["stages_ms"].values()) < 3 * figures["neural_window_ms"]["median"]
    assert said["microphones"] == said["arrays"]["4"]["microphones"] == 4
    assert {"norm_music", "neural"} <= set(said["times_faster_than_pyroomacoustics"])


def test_figures_are_those_of_the_times() -> None:
    times = Timing(np.array([3.0, 1.0, 2.0, 5.0, 4.0]))
    assert (times.median, times.p99) == (3.0, pytest.approx(4.96))
    slower = Timing(np.array([6.0, 4.0, 2.0, 20.0, 12.0]))
    assert times.faster_than(slower) == (2.0, 3.0, 4.0)


@pytest.mark.parametrize("flag", ["--repeats", "--threads"])
def test_nothing_cannot_be_timed(flag: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", flag, "0"]) == 2
    assert capsys.readouterr().err == f"error: {flag} must be at least 1, but is 0\n"

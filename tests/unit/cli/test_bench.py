"""``neuralmusic bench --json``: the figures that scripts read."""

from __future__ import annotations

import json
from typing import Any

import pytest

from service.cli import main
from service.cli.bench import THREAD_VARIABLES

STAGES = {"stft", "covariance_net", "count_net", "evd", "spectrum", "fusion", "peaks"}


def test_it_says_what_every_stage_costs(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in THREAD_VARIABLES:
        monkeypatch.setenv(name, "1")
    flags = ["--threads", "1", "--repeats", "6", "--microphones", "4", "8"]
    assert main(["bench", "--json", *flags]) == 0
    said: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert list(said["arrays"]) == ["4", "8"]
    for figures in (said, *said["arrays"].values()):
        for name in ("neural_window_ms", "norm_music_window_ms", "stream_hop_ms"):
            assert 0 < figures[name]["median"] <= figures[name]["p99"]
        assert set(figures["stages_ms"]) >= STAGES
        assert all(value > 0 for value in figures["stages_ms"].values())
        # The stages are parts of the window: none alone can cost more than a few windows.
        assert max(figures["stages_ms"].values()) < 3 * figures["neural_window_ms"]["median"]
    assert said["microphones"] == said["arrays"]["4"]["microphones"] == 4
    ratios = said["times_faster_than_pyroomacoustics"]
    for ratio in ratios.values():
        assert 0 < ratio["p25"] <= ratio["median"] <= ratio["p75"]


@pytest.mark.parametrize("flag", ["--repeats", "--threads"])
def test_nothing_cannot_be_timed(flag: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", flag, "0"]) == 2
    assert capsys.readouterr().err == f"error: {flag} must be at least 1, but is 0\n"

"""The evaluation of heads that turn finds what poses are worth."""

from __future__ import annotations

import numpy as np

from model_export.evaluation.tracking import turning
from model_export.evaluation.tracking.turning import TURNS, Turn, TurnScores, steady
from model_export.simulation.synthesis import synthetic_voice


def test_a_turning_head_is_followed_by_its_poses() -> None:
    voices = [synthetic_voice(np.random.default_rng(seed), 4.0) for seed in range(2)]
    scores = {}
    for told in (True, False):
        turn = Turn("one", steady(60), (200.0,), told=told)
        rng = np.random.default_rng(1)
        audio = turning.simulate(turn, voices, rng)[:, :48_000]
        found = TurnScores()
        turning._score(turn, list(turning.follow(turn, audio, rng)), found)
        scores[told] = np.abs(found.errors).mean()
    assert scores[True] < 4
    assert scores[False] > 30
    assert len({turn.name for turn in TURNS}) == len(TURNS)

"""The measurement of noise profiles on a few scenes of synthetic voices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from model_export.__main__ import main
from model_export.evaluation import ego_noise
from model_export.evaluation.ego_noise import NOISES, Score, learnt, table
from service.doa.presets import preset

pytestmark = pytest.mark.torch


def test_a_profile_holds_the_noises_place() -> None:
    noise = learnt(NOISES["motor: all from one place, behind"], seed=1)
    assert noise.seconds == pytest.approx(5.0, abs=0.05)
    values, vectors = np.linalg.eigh(noise.covariance[48])  # 1.5 kHz
    assert values[-1] > 100 * values[-2]
    place = np.array([-0.1, 0.0, 0.0])
    distance = np.linalg.norm(preset("respeaker-usb-4mic-v2").positions - place, axis=1)
    wave = np.exp(-2j * np.pi * 1500 * distance / 343) / distance
    cosine = np.abs(np.vdot(vectors[:, -1], wave)) / np.linalg.norm(wave)
    assert cosine == pytest.approx(1.0, abs=0.01)


def test_the_table_says_what_was_measured() -> None:
    score = Score(np.array([1.0, 2.0, 30.0]), np.array([0.5, 0.5, 0.5]), 7.0)
    row = table([("neural", "learnt", score)]).splitlines()[-1]
    assert row == "| `neural` | learnt | 2.0° | 11.0° | 67% | 7 | 0.5° | 100% |"


def test_the_page_has_a_table_for_every_noise(
    corpus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    some = dict(list(NOISES.items())[:2])
    monkeypatch.setattr(ego_noise, "NOISES", some)
    out = tmp_path / "ego-noise.md"
    command = ["ego-noise", "--speech-commands", str(corpus), "--scenes", "1", "--alone", "1.5"]
    assert main([*command, "--out", str(out)]) == 0
    page = out.read_text()
    assert [line[5:] for line in page.splitlines() if line.startswith("## A ")] == list(some)
    assert page.count("| `neural` | learnt |") == len(some)

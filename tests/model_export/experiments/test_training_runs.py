"""Trainings of the comparison: resumable, told apart, scored by their estimates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from model_export.baselines.heads import SpectrumHead
from model_export.baselines.method import Card, Estimate
from model_export.baselines.network import BaselineNetwork, Prediction
from model_export.baselines.shipped import ShippedBundle
from model_export.experiments import study
from model_export.experiments.cells import Cell
from model_export.experiments.scene_set import SceneSet
from model_export.experiments.study import score
from model_export.experiments.training import Budget, Training, describe, fit
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.inference.bundle import load_bundle
from service.inference.registry import EMBEDDED_MODELS

pytestmark = pytest.mark.torch

SQUARE = preset("respeaker-usb-4mic-v2")
CARD = Card("tiny", "Tiny", "learned", "no publication")


class Tiny(BaselineNetwork):
    card = CARD

    def __init__(self) -> None:
        super().__init__()
        self.layer = nn.Linear(4, 16)
        self.head = SpectrumHead(16)

    def features(self, audio: np.ndarray) -> np.ndarray:
        return audio[..., :100].std(axis=-1).astype(np.float32)

    def forward(
        self, features: Tensor, array: MicrophoneArray, counts: Tensor | None = None
    ) -> Prediction:
        return self.head(self.layer(features).relu())


def tiny() -> Tiny:
    torch.manual_seed(0)
    return Tiny()


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> SceneSet:
    rng = np.random.default_rng(0)
    made = (
        (rng.standard_normal((4, 16640)), rng.uniform(0, 2 * np.pi, 1 + index % 2))
        for index in range(8)
    )
    return SceneSet.write(tmp_path_factory.mktemp("set"), made, SQUARE)


class Interrupted(Exception):
    pass


def test_an_interrupted_training_goes_on_where_it_stopped(tmp_path: Path, scenes: SceneSet) -> None:
    budget = Budget(epochs=50, batch_size=4)
    steps: list[int] = []
    whole = fit(tiny(), scenes, budget, tmp_path / "whole", 1, lambda step, *_: steps.append(step))
    assert steps == list(range(1, 101))

    def interrupt(step: int, *_: object) -> None:
        if step == 60:
            raise Interrupted

    with pytest.raises(Interrupted):
        fit(tiny(), scenes, budget, tmp_path / "parts", 1, interrupt)
    later: list[int] = []
    parts = fit(tiny(), scenes, budget, tmp_path / "parts", 1, lambda step, *_: later.append(step))
    assert later == list(range(51, 101))  # from the last checkpoint
    for one, other in zip(whole.parameters(), parts.parameters(), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-4)


def test_a_folder_holds_one_training(tmp_path: Path) -> None:
    budget = Budget(1, 4)
    describe(tmp_path, Training("crnn"), budget)
    describe(tmp_path, Training("crnn"), budget)
    with pytest.raises(ValueError, match="holds another training"):
        describe(tmp_path, Training("crnn", share=0.2), budget)


def test_trainings_that_differ_have_folders_of_their_own() -> None:
    variants = [
        Training("crnn"),
        Training("crnn", "cited"),
        Training("crnn", share=0.2),
        Training("crnn", scenes="train-5"),
        Training("crnn", tuned_to="room B labelled"),
        Training("neuralmusic", pretrained=True),
        Training("neuralmusic", attention=False),
    ]
    assert len({training.key for training in variants}) == len(variants)


class Oracle:
    """A method that answers with the first directions of a list, as many as it is told."""

    card = CARD

    def __init__(self, counts: bool, truth: SceneSet, offset: float) -> None:
        self.counts, self._truth, self._offset, self._index = counts, truth, offset, 0

    def localize(
        self, audio: np.ndarray, array: MicrophoneArray, num_sources: int | None = None
    ) -> Estimate:
        sources = self._truth.sources(self._index)
        self._index += 1
        count = 1 if num_sources is None else num_sources
        return Estimate(sources[:count] + self._offset)


def test_scores_are_those_of_the_answers(scenes: SceneSet) -> None:
    right = score(Oracle(True, scenes, np.deg2rad(2.0)), scenes, Cell("x"))
    assert right["maae_deg"] == pytest.approx(2.0)
    assert right["count_accuracy"] == 1.0
    # Half of the scenes have two sources, one of which is missed: it counts 90 degrees.
    unknown = score(Oracle(True, scenes, 0.0), scenes, Cell("x", count_known=False))
    assert unknown["maae_deg"] == pytest.approx(90 / 2 / 2)
    assert unknown["count_accuracy"] == 0.5


def test_a_method_that_cannot_count_is_told_the_count_everywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scenes: SceneSet
) -> None:
    monkeypatch.setattr(study, "classical", lambda: {"oracle": Oracle(False, scenes, 0.0)})
    place = tmp_path / "scenes" / "test-1"
    sources = ((scenes.window(i), scenes.sources(i)) for i in range(len(scenes)))
    SceneSet.write(place, sources, scenes.array)
    cells = [Cell("test-1"), Cell("test-1", count_known=False)]
    found = study.Study(tmp_path, "smoke", tmp_path).scored([study.Contender("oracle")], cells)
    for cell in cells:
        assert found["oracle"][cell]["count_accuracy"] == 1.0
    assert len(list((tmp_path / "scores").rglob("*.json"))) == 1  # scored once


def test_another_bundle_of_the_same_name_is_scored_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    before = study.Contender("any-array").key
    assert study.Contender("paper").key != before
    embedded = load_bundle(EMBEDDED_MODELS / "any-array")
    newer = replace(embedded, files=replace(embedded.files, sha256="0" * 64))
    monkeypatch.setattr(study, "shipped", lambda: {"any-array": ShippedBundle(newer)})
    assert study.Contender("any-array").key not in (before, "any-array")


def test_only_the_first_scenes_count_where_a_cell_says_so(scenes: SceneSet) -> None:
    assert score(Oracle(True, scenes, 0.0), scenes, Cell("x", first=3))["scenes"] == 3

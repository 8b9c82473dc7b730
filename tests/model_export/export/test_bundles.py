"""The whole training side in small: rooms, a few steps, export, and serving the bundle."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from model_export.__main__ import main
from model_export.export.bundle import digest
from model_export.export.parameters import trained_model
from model_export.training.config import PAPER
from service.audio.recording import Recording
from service.doa.presets import preset
from service.inference.bundle import load_bundle
from service.inference.registry import BundleRegistry
from service.recordings.localize import localize_recording
from service.recordings.results import LocalizeOptions

ROOT = Path(__file__).parents[3]


def check_run(run: Path) -> None:
    curves = (run / "curves.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in curves] == ["step", "2", "4"]
    assert json.loads((run / "config.json").read_text())["seed"] == 1


def check_bundle(folder: Path) -> None:
    bundle = load_bundle(folder)
    assert bundle.manifest.parity["max_abs_difference"] <= 1e-3
    assert bundle.manifest.training["scenes"] == 16
    state = trained_model(bundle).task.model.state_dict()
    assert bundle.manifest.training["parameters"] == digest(state)
    for graph in (bundle.manifest.covariance, bundle.manifest.source_count):
        assert graph.inputs[0].shape[0] == "batch"
    for path in folder.glob("*.onnx"):  # the exporter writes stack traces with the machine's paths
        assert str(ROOT).encode() not in path.read_bytes()
    with Recording.open(ROOT / "examples" / "two-talkers.flac") as recording:
        options = LocalizeOptions(preset("respeaker-usb-4mic-v2"), num_sources=1, hop_s=2.0)
        result = localize_recording(recording, options, BundleRegistry([bundle]))
    assert result.method == "neural"
    assert all(len(window.estimate.sources) <= 1 for window in result.windows)


def test_the_paper_s_stages_become_a_bundle_that_serves(
    paper_run: Path, paper_bundle: Path
) -> None:
    check_run(paper_run / "sscl")
    check_run(paper_run / "paper")
    check_bundle(paper_bundle)
    manifest = json.loads((paper_bundle / "bundle.json").read_text())
    assert manifest["level_exponent"] == PAPER.level_exponent > 0


@pytest.mark.learns
def test_from_rooms_to_a_bundle_of_any_array_that_serves(corpus: Path, tmp_path: Path) -> None:
    rooms, run, out = (tmp_path / name for name in ("rooms", "run", "bundles"))
    assert main(["rooms", "--out", str(rooms), "--chunks", "1"]) == 0
    data = ["--rooms", str(rooms), "--speech-commands", str(corpus)]
    train = ["train", "--config", "any-array", "--run", str(run), "--smoke"]
    assert main([*train, *data]) == 0
    check_run(run)
    export = ["export", "--run", str(run), "--out", str(out), "--counting-scenes", "64"]
    assert main([*export, *data]) == 0
    check_bundle(out)


def test_a_wrong_corpus_folder_is_explained(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "00000.npz").touch()
    command = ["train", "--run", str(tmp_path / "run"), "--rooms", str(tmp_path)]
    assert main([*command, "--speech-commands", str(tmp_path)]) == 2
    assert "validation_list.txt" in capsys.readouterr().err

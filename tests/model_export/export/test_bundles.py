"""The whole training side in small: rooms, a few steps, export, and the bundle serves."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from model_export.__main__ import main
from service.audio.recording import Recording
from service.doa.presets import preset
from service.inference.bundle import load_bundle
from service.inference.registry import BundleRegistry
from service.recordings.localize import localize_recording
from service.recordings.results import LocalizeOptions


@pytest.fixture(scope="module")
def rooms(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rooms")
    assert main(["rooms", "--out", str(folder), "--chunks", "1"]) == 0
    return folder


@pytest.mark.parametrize("config", ["any-array", "paper"])
def test_from_rooms_to_a_bundle_that_serves(
    config: str, corpus: Path, rooms: Path, tmp_path: Path
) -> None:
    run, out = tmp_path / "run", tmp_path / "bundles" / config
    data = ["--rooms", str(rooms), "--speech-commands", str(corpus)]
    train = ["train", "--config", config, "--run", str(run), "--smoke", *data]
    if config == "paper":
        first = str(tmp_path / "sscl")
        assert main(["train", "--config", "paper-sscl", "--run", first, "--smoke", *data]) == 0
        train += ["--init", first]
    assert main(train) == 0
    curves = (run / "curves.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in curves] == ["step", "2", "4"]
    assert json.loads((run / "config.json").read_text())["seed"] == 1
    export = ["export", "--run", str(run), "--out", str(out), "--counting-scenes", "64"]
    assert main([*export, *data]) == 0
    bundle = load_bundle(out)
    assert bundle.manifest.parity["max_abs_difference"] <= 1e-3
    assert bundle.manifest.training["scenes"] == 16
    for graph in (bundle.manifest.covariance, bundle.manifest.source_count):
        assert graph.inputs[0].shape[0] == "batch"
    for path in out.glob("*.onnx"):  # the exporter writes stack traces with the machine's paths
        assert str(Path(__file__).parents[3]).encode() not in path.read_bytes()
    sample = Path(__file__).parents[3] / "examples" / "two-talkers.flac"
    with Recording.open(sample) as recording:
        options = LocalizeOptions(preset("respeaker-usb-4mic-v2"), num_sources=1, hop_s=2.0)
        result = localize_recording(recording, options, BundleRegistry([bundle]))
    assert result.method == "neural"
    assert all(len(window.estimate.sources) <= 1 for window in result.windows)


def test_a_run_continues_where_it_was_interrupted(
    corpus: Path, rooms: Path, tmp_path: Path
) -> None:
    command = ["train", "--run", str(tmp_path), "--smoke", "--rooms", str(rooms)]
    command += ["--speech-commands", str(corpus)]
    assert main(command) == 0
    finished = (tmp_path / "curves.csv").read_text()
    assert main(command) == 0  # all steps are done: nothing is trained again
    assert (tmp_path / "curves.csv").read_text() == finished
    settings = json.loads((tmp_path / "config.json").read_text())
    (tmp_path / "config.json").write_text(json.dumps({**settings, "seed": 2}))
    assert main(command) == 2  # other settings in the same folder are refused


def test_a_wrong_corpus_folder_is_explained(
    rooms: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["train", "--run", str(tmp_path / "run"), "--rooms", str(rooms)]
    assert main([*command, "--speech-commands", str(tmp_path)]) == 2
    assert "validation_list.txt" in capsys.readouterr().err

"""Fine-tuning: a bundle holds its parameters, learns from recordings, is refused if worse."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import soundfile
import torch

from model_export.__main__ import main
from model_export.export.bundle import digest
from model_export.export.parameters import TrainedModel, trained_model
from model_export.finetuning.finetune import FineTuning, finetune, train
from model_export.finetuning.heldout import hold_out
from model_export.finetuning.labelled_recordings import load_recordings
from model_export.finetuning.labelled_scenes import Augmentation, LabelledScenes
from model_export.finetuning.labels import LABELS
from model_export.finetuning.own_room import write_own_room
from model_export.simulation.room_bank import RoomBank
from model_export.simulation.rooms import RoomSpec
from model_export.simulation.synthesis import synthetic_voice
from model_export.training.variants import collate
from neuralmusic.errors import BundleCorrupt
from service.cli.inputs import read_array
from service.doa.array import MicrophoneArray
from service.doa.features import coherence_features, unit_vectors_and_power
from service.doa.types import FloatArray
from service.inference.bundle import MANIFEST, PARAMETERS, file_sha256, load_bundle
from service.inference.descriptors import NUM_DESCRIPTORS
from service.inference.registry import EMBEDDED_MODELS, self_test

pytestmark = pytest.mark.torch

ARRAY = "respeaker-usb-4mic-v2"
AS_RECORDED = FineTuning(
    steps=10,
    batch_size=4,
    learning_rate=2e-3,
    augmentation=Augmentation(mixtures=0.0, noise=0.0),
)
SHORT = FineTuning(steps=10, batch_size=4, learning_rate=2e-3, validation_share=0.25)


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The embedded bundle under another name, with a coarser grid to train on."""
    folder = tmp_path_factory.mktemp("bundles") / "tiny"
    shutil.copytree(EMBEDDED_MODELS / "any-array", folder)
    path = folder / MANIFEST
    manifest = json.loads(path.read_text()) | {"name": "tiny", "version": "1.2.3"}
    manifest["training"]["config"]["grid_size"] = 72
    state = trained_model(load_bundle(folder)).task.model.state_dict()
    manifest["training"]["parameters"] = digest(state)
    path.write_text(json.dumps(manifest))
    return folder


@pytest.fixture(scope="module")
def regression(paper_bundle: Path) -> Path:
    return paper_bundle


@pytest.fixture(scope="module")
def own_room(tmp_path_factory: pytest.TempPathFactory, square: MicrophoneArray) -> Path:
    """Recordings of eight directions by a mismatched array beside its fan."""
    folder = tmp_path_factory.mktemp("own-room")
    rng = np.random.default_rng(0)
    voices = [synthetic_voice(rng, 0.8) for _ in range(6)]
    room = RoomSpec((4.0, 3.0, 2.5), (2.1, 1.4, 1.0), max_order=1)
    write_own_room(
        folder, square, voices, voices, directions=8, test_recordings=1, seconds=1.5, room=room
    )
    return folder


def command(bundle: Path, own_room: Path, out: Path, *options: str) -> list[str]:
    data = ["--recordings", str(own_room / "recordings"), "--array", ARRAY]
    short = ["--steps", "2", "--validation-share", "0.25"]
    return ["finetune", "--bundle", str(bundle), *data, "--out", str(out), *short, *options]


def test_the_parameters_give_the_graphs_outputs(
    weights: Path, square: MicrophoneArray, plane_waves: Callable[..., FloatArray]
) -> None:
    bundle = load_bundle(weights)
    model = trained_model(bundle)
    spectra = bundle.stft.transform(plane_waves(square, [70.0])[None])[:, :, 1:]
    features = np.swapaxes(coherence_features(*unit_vectors_and_power(spectra)), 2, 3).copy()
    with torch.no_grad():
        outputs = model.task.model.network(torch.from_numpy(features))
        assert model.source_count is not None
        counted = model.source_count(torch.ones(1, 4, NUM_DESCRIPTORS))
    for given, graph in zip(outputs, bundle.covariance.run([features]), strict=True):
        np.testing.assert_allclose(given.numpy(), graph, rtol=1e-4, atol=1e-5)
    descriptors = np.ones((1, 4, NUM_DESCRIPTORS), np.float32)
    for given, graph in zip(counted, bundle.source_count.run([descriptors]), strict=True):
        np.testing.assert_allclose(given.numpy(), graph, rtol=1e-4, atol=1e-5)


@pytest.mark.learns
def test_the_parameters_of_the_papers_networks(regression: Path) -> None:
    """Graphs with any number of windows, of networks with batch statistics of their own."""
    bundle = load_bundle(regression)
    model = trained_model(bundle).task.model
    for windows in (1, 3):
        features = np.random.default_rng(0).standard_normal((windows, 8, 257, 64), np.float32)
        for network, graph in (
            (model.covariance, bundle.covariance),
            (model.count, bundle.source_count),
        ):
            with torch.no_grad():
                given = network(torch.from_numpy(features)).numpy()
            (exported,) = graph.run([features])
            np.testing.assert_allclose(given, exported, rtol=0, atol=1e-4)


def test_changed_parameters_are_noticed(weights: Path, tmp_path: Path) -> None:
    for path in weights.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    with (tmp_path / PARAMETERS).open("ab") as file:
        file.write(b"more")
    with pytest.raises(BundleCorrupt, match=f"{PARAMETERS} differs from its hash"):
        load_bundle(tmp_path)


def without_parameters(weights: Path, folder: Path) -> Path:
    for path in weights.iterdir():
        if path.name != PARAMETERS:
            (folder / path.name).write_bytes(path.read_bytes())
    manifest = json.loads((folder / "bundle.json").read_text())
    del manifest["files"][PARAMETERS]
    (folder / "bundle.json").write_text(json.dumps(manifest))
    return folder


def test_a_bundle_without_parameters_serves_but_cannot_be_tuned(
    weights: Path,
    own_room: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    old = tmp_path / "old"
    old.mkdir()
    self_test(load_bundle(without_parameters(weights, old)))
    assert main(command(old, own_room, tmp_path / "new")) == 2
    assert "the bundle tiny holds no parameters.npz" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_parameters_of_other_networks_are_refused(weights: Path, tmp_path: Path) -> None:
    for path in weights.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    np.savez(tmp_path / PARAMETERS, **{"model.other": np.zeros(3, np.float32)})
    manifest = json.loads((tmp_path / "bundle.json").read_text())
    manifest["files"][PARAMETERS] = file_sha256(tmp_path / PARAMETERS)
    (tmp_path / "bundle.json").write_text(json.dumps(manifest))
    with pytest.raises(ValueError, match="does not fit the networks of this version"):
        trained_model(load_bundle(tmp_path))


def test_whole_directions_are_held_out(own_room: Path, square: MicrophoneArray) -> None:
    recordings = load_recordings(own_room / "recordings", square)
    tuned, held = hold_out([*recordings, *recordings], 0.25)
    assert sorted(r.direction for r in held) == [90, 90, 270, 270]
    assert len(tuned) == 12
    with pytest.raises(ValueError, match="the recordings have only 1:"):
        hold_out(recordings[:1], 0.25)


@torch.no_grad()
def loss(model: TrainedModel, scenes: LabelledScenes) -> float:
    """The loss on a window of every recording, as recorded."""
    batch = collate(model.config, np.random.default_rng(0), scenes.windows(1))
    return float(model.task.losses(batch)["loss"])


@pytest.mark.learns
@pytest.mark.parametrize("variant", ["weights", "regression"])
def test_training_fits_the_recordings_and_is_deterministic(
    variant: str, request: pytest.FixtureRequest, own_room: Path, square: MicrophoneArray
) -> None:
    bundle = load_bundle(request.getfixturevalue(variant))
    scenes = LabelledScenes(load_recordings(own_room / "recordings", square), square)
    first, second = trained_model(bundle), trained_model(bundle)
    before = loss(first, scenes)
    _, array = train(first, scenes, square, AS_RECORDED)
    assert loss(first, scenes) < 0.95 * before
    _, again = train(second, scenes, square, AS_RECORDED)
    np.testing.assert_array_equal(again.positions, array.positions)
    assert digest(first.task.model.state_dict()) == digest(second.task.model.state_dict())


def record_around(
    folder: Path,
    array: MicrophoneArray,
    plane_waves: Callable[..., FloatArray],
    labels: Sequence[int],
) -> Path:
    """Recordings of every 45 degrees in ``folder``/recordings, labelled with ``labels``."""
    recordings = folder / "recordings"
    recordings.mkdir()
    rows = ["file,azimuth_deg"]
    for index, azimuth in enumerate(labels):
        audio = plane_waves(array, [45 * index], seconds=1.5, seed=index)
        soundfile.write(recordings / f"{index}.wav", audio.T, 16000)
        rows.append(f"{index}.wav,{azimuth}")
    (recordings / LABELS).write_text("\n".join(rows))
    return folder


@pytest.mark.learns
def test_an_array_that_is_mounted_turned_is_found_out(
    weights: Path, tmp_path: Path, square: MicrophoneArray, plane_waves: Callable[..., FloatArray]
) -> None:
    mounted = square.rotated(np.deg2rad(4.0))
    record_around(tmp_path, mounted, plane_waves, range(0, 360, 45))
    recordings = load_recordings(tmp_path / "recordings", square)
    settings = FineTuning(steps=20, batch_size=4, validation_share=0.25)
    outcome = finetune(load_bundle(weights), recordings, square, tmp_path / "new", settings)
    assert outcome.before["as recorded"]["maae_deg"] > 3.5
    assert outcome.after["as recorded"]["maae_deg"] < 2.0
    assert outcome.better
    start, new = (load_bundle(f).manifest.training for f in (weights, tmp_path / "new"))
    assert new["parameters"] == start["parameters"]  # only the array changed
    towards = np.arctan2(*outcome.array.positions[:, 1::-1].T) - np.deg2rad([45, 135, 225, 315])
    turned = np.angle(np.exp(1j * towards).mean())
    assert np.rad2deg(turned) == pytest.approx(4.0, abs=1.5)


def test_simulated_scenes_take_their_share_of_the_steps(
    weights: Path, own_room: Path, tmp_path: Path, square: MicrophoneArray
) -> None:
    recordings = load_recordings(own_room / "recordings", square)
    scenes, model = LabelledScenes(recordings, square), trained_model(load_bundle(weights))
    batch = collate(model.config, np.random.default_rng(0), scenes.windows(1)[:4])
    few = replace(SHORT, steps=2, simulated=1.0)
    simulated = iter([batch] * 3)
    _, array = train(model, scenes, square, few, simulated)
    assert len(list(simulated)) == 1
    np.testing.assert_allclose(array.positions, square.positions)  # they are of other arrays
    (tmp_path / "0.npz").touch()
    with pytest.raises(ValueError, match="give --learning-rate"):
        finetune(
            load_bundle(weights),
            recordings,
            square,
            tmp_path / "new",
            replace(SHORT, learning_rate=None),
            bank=RoomBank(tmp_path),
        )


def changed(model: torch.nn.Module, start: torch.nn.Module) -> set[str]:
    state = start.state_dict()
    return {k.split(".")[0] for k, v in model.state_dict().items() if not torch.equal(v, state[k])}


def test_only_the_parts_that_recordings_can_teach_change(
    weights: Path, regression: Path, own_room: Path, square: MicrophoneArray
) -> None:
    scenes = LabelledScenes(load_recordings(own_room / "recordings", square), square)
    few = replace(SHORT, steps=1)
    tuned, start = (trained_model(load_bundle(regression)) for _ in range(2))
    train(tuned, scenes, square, few)
    assert changed(tuned.task.model, start.task.model) == {"covariance"}
    tuned, start = (trained_model(load_bundle(weights)) for _ in range(2))
    train(tuned, scenes, square, few)
    before = dict(start.task.model.named_buffers())
    for name, statistics in tuned.task.model.named_buffers():
        assert torch.equal(statistics, before[name])


@pytest.mark.learns
def test_from_a_bundle_and_recordings_to_a_bundle(
    weights: Path, own_room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "models" / "mine"
    test = ["--test", str(own_room / "test"), "--name", "mine", "--force"]
    test += ["--learning-rate", "1e-4"]
    assert main(command(weights, own_room, out, *test)) == 0
    printed = capsys.readouterr().out
    for row in ("8 recordings of 8 directions", "as recorded", "two talkers", "test recordings"):
        assert row in printed
    start, bundle = load_bundle(weights), load_bundle(out)
    self_test(bundle)
    training = bundle.manifest.training
    assert bundle.manifest.name == "mine"
    assert bundle.manifest.scores == {}
    assert training["fine_tuning"]["from"] == {
        "name": "tiny",
        "version": "1.2.3",
        "parameters": start.manifest.training["parameters"],
    }
    assert training["fine_tuning"]["recordings"] == 6
    assert training["parameters"] != start.manifest.training["parameters"]
    assert training["parameters"] == digest(trained_model(bundle).task.model.state_dict())
    array = read_array(f"@{out / 'array.json'}")
    assert array.positions.tolist() == training["fine_tuning"]["array"]["positions_m"]
    assert f"localize with --array @{out / 'array.json'}" in printed
    assert main(command(weights, own_room, out)) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.learns
def test_a_worse_bundle_is_not_written(
    weights: Path,
    tmp_path: Path,
    square: MicrophoneArray,
    plane_waves: Callable[..., FloatArray],
    capsys: pytest.CaptureFixture[str],
) -> None:
    # All labels are wrong but those of the held-out directions, 90 and 270.
    labels = [10, 55, 90, 145, 190, 235, 270, 325]
    folder = record_around(tmp_path, square, plane_waves, labels)
    models = tmp_path / "models"
    assert main(command(weights, folder, models / "worse", "--steps", "8")) == 2
    captured = capsys.readouterr()
    assert "no better than before, so nothing was written" in captured.err
    assert "as recorded" in captured.out  # the table still says how much worse
    assert list(models.iterdir()) == []


def test_training_that_diverges_says_so(
    weights: Path, own_room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command(weights, own_room, tmp_path / "nan", "--learning-rate", "1e6")) == 2
    assert "diverged: take a smaller --learning-rate" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--name", "My Bundle"], "'My Bundle' cannot name a bundle"),
        (["--rooms", "rooms"], "both --rooms and --speech-commands"),
        (["--array", "respeaker-usb-4mic"], "did you mean 'respeaker-usb-4mic-v2'"),
        (["--steps", "0"], "steps and batch_size must be positive"),
        (["--validation-share", "0.9"], "at most 0.5"),
        (["--bundle", "nowhere"], "nowhere holds no bundle.json"),
    ],
)
def test_wrong_options(
    weights: Path,
    own_room: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    message: str,
) -> None:
    assert main(command(weights, own_room, tmp_path / "new", *options)) == 2
    assert message in capsys.readouterr().err


def test_a_bound_bundle_refuses_other_arrays(
    regression: Path, own_room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = ["--array", "xvf3800-4mic"]
    assert main(command(regression, own_room, tmp_path / "new", *other)) == 2
    assert "the bundle tiny is bound to another array" in capsys.readouterr().err


def test_the_own_room_is_labelled(own_room: Path) -> None:
    rows = (own_room / "recordings" / LABELS).read_text().splitlines()
    assert rows[:2] == ["file,azimuth_deg", "00.wav,0.00"]
    assert soundfile.info(own_room / "recordings" / "07.wav").channels == 4


def test_the_embedded_bundle_still_loads() -> None:
    assert load_bundle(EMBEDDED_MODELS / "any-array").manifest.name == "any-array"

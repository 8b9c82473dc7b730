"""Bundles with a network for every known number of talkers: which one answers, what is refused."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from model_export.__main__ import main
from model_export.export.bundle import digest
from model_export.export.parameters import trained_task
from model_export.export.regression import GRID_SIZE
from model_export.export.run import known_tasks
from model_export.training.config import ANY_ARRAY, PAPER, PAPER_KNOWN, TrainingConfig
from model_export.training.fitting import CHECKPOINT
from model_export.training.regression import RegressionTask
from model_export.training.subspace import delay_products
from model_export.training.task import STFT, steering_delays
from model_export.training.train import load_run
from model_export.training.variants import task_of
from neuralmusic.errors import BundleCorrupt, SelfTestFailed
from service.doa.array import MicrophoneArray
from service.doa.spectrogram import spectrogram_features
from service.doa.steering import azimuth_grid, steering_vectors
from service.doa.types import ComplexArray, FloatArray
from service.inference.bundle import FUSION, GOLDEN, Bundle, file_sha256, load_bundle
from service.inference.registry import EMBEDDED_MODELS, self_test
from service.inference.regression import RegressionLocalizer
from service.inference.stream import stream_localizer_of

pytestmark = pytest.mark.torch

TOLERANCE = 1e-3
COUNTS = [2, 0, 1, 2, 3, 1]
"""Counts of the windows; the bundle has networks of its own for 1 and 2"""


def untrained(folder: Path, config: TrainingConfig, seed: int) -> Path:
    """A run of fresh parameters."""
    folder.mkdir()
    torch.manual_seed(seed)
    model = task_of(config).model
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.mul_(2.5)  # fresh networks hardly hear their input
    torch.save({"model": model.state_dict(), "step": 0}, folder / CHECKPOINT)
    (folder / "config.json").write_text(json.dumps(config.as_dict()))
    return folder


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """Runs for one and for two talkers, and at 0 the one for any number."""
    folder = tmp_path_factory.mktemp("runs")
    configs = (PAPER, *PAPER_KNOWN[:2])
    return {seed: untrained(folder / each.name, each, seed) for seed, each in enumerate(configs)}


@pytest.fixture(scope="module")
def folder(runs: dict[int, Path], corpus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bundles") / "known"
    command = ["export", "--run", str(runs[0]), "--out", str(out), "--name", "known"]
    known = ["--known", str(runs[2]), str(runs[1])]
    assert main([*command, *known, "--speech-commands", str(corpus)]) == 0
    return out


@pytest.fixture(scope="module")
def tasks(runs: dict[int, Path]) -> dict[int, RegressionTask]:
    """The trained networks by number, without the bundle."""
    loaded, records = known_tasks(task(runs[0]), [runs[1], runs[2]])
    assert list(records) == ["1", "2"]
    return {0: task(runs[0]), **loaded}


def task(run: Path) -> RegressionTask:
    loaded = load_run(run)[1]
    assert isinstance(loaded, RegressionTask)
    return loaded


@pytest.fixture(scope="module")
def spectra(square: MicrophoneArray) -> ComplexArray:
    """Spectra (B, N, F, L) of windows of noise from one direction each."""
    rng = np.random.default_rng(0)
    azimuth = np.linspace(0, 5, len(COUNTS))
    steering = steering_vectors(square.positions, STFT.frequencies, azimuth)  # (F, N, B)
    source = rng.standard_normal((2, len(COUNTS), 257, 64))
    heard = np.einsum("fnb,bfl->bnfl", steering, source[0] + 1j * source[1])
    return (heard + 0.1 * rng.standard_normal(heard.shape)).astype(np.complex64)


@torch.no_grad()
def alone(task: RegressionTask, spectra: ComplexArray, num_sources: int) -> FloatArray:
    """Fused spectrum (A,) of one window by a network of its own, in torch."""
    features = spectrogram_features(spectra[None], level_exponent=task.config.level_exponent)
    delays = steering_delays(task.array.positions[None], azimuth_grid(GRID_SIZE))
    frequencies = torch.from_numpy(STFT.frequencies).float()
    products = delay_products(torch.from_numpy(delays), frequencies)[0]
    count = torch.tensor([max(num_sources, 1)])
    fused: FloatArray = task.model(torch.from_numpy(features), products, count).fused[0].numpy()
    return fused


@dataclass
class Counter:
    """A count network that is sure of these counts."""

    counts: Sequence[int]

    def run(self, inputs: Sequence[FloatArray]) -> list[FloatArray]:
        assert len(inputs[0]) == len(self.counts)
        return [10 * np.eye(5, dtype=np.float32)[list(self.counts)]]


def counting(folder: Path, counts: Sequence[int]) -> Bundle:
    return replace(load_bundle(folder), source_count=Counter(counts))  # type: ignore[arg-type]


def test_every_window_is_answered_by_the_network_of_its_count_in_order(
    folder: Path, tasks: dict[int, RegressionTask], spectra: ComplexArray
) -> None:
    bundle = counting(folder, COUNTS)
    estimates = RegressionLocalizer(bundle, tasks[0].array).localize(spectra, None, 4)
    for estimate, window, count in zip(estimates, spectra, COUNTS, strict=True):
        by = {each: alone(tasks[each], window, count) for each in tasks}
        own = count if count in tasks else 0
        np.testing.assert_allclose(estimate.spectrum, by.pop(own), atol=TOLERANCE)
        assert all(
            np.abs(estimate.spectrum - other).max() > 10 * TOLERANCE for other in by.values()
        )
        assert len(estimate.sources) <= count


@pytest.mark.parametrize("asked", [1, 2, 3])
def test_the_number_that_is_asked_for_chooses_whatever_is_counted(
    folder: Path, tasks: dict[int, RegressionTask], spectra: ComplexArray, asked: int
) -> None:
    localizer = RegressionLocalizer(counting(folder, [1, 2]), tasks[0].array)
    estimates = localizer.localize(spectra[:2], asked, 4)
    for estimate, window in zip(estimates, spectra, strict=False):
        expected = alone(tasks[asked if asked in tasks else 0], window, asked)
        np.testing.assert_allclose(estimate.spectrum, expected, atol=TOLERANCE)


@pytest.mark.parametrize(("asked", "counted"), [(2, 1), (None, 2), (None, 3)])
def test_a_stream_takes_the_same_network(
    folder: Path,
    tasks: dict[int, RegressionTask],
    spectra: ComplexArray,
    asked: int | None,
    counted: int,
) -> None:
    bundle = counting(folder, [counted])
    stream = stream_localizer_of("neural", bundle, tasks[0].array, STFT)
    for part in np.split(spectra[0], 4, axis=-1):
        stream.push(part)
    count = asked or counted
    expected = alone(tasks[count if count in tasks else 0], spectra[0], count)
    np.testing.assert_allclose(stream.estimate(asked, 4).spectrum, expected, atol=TOLERANCE)


def test_the_manifest_tells_what_every_network_was_trained_on(
    folder: Path, tasks: dict[int, RegressionTask]
) -> None:
    manifest = load_bundle(folder).manifest
    assert sorted(manifest.covariance_by_count) == [1, 2]
    for count in (1, 2):
        record = manifest.training["known"][str(count)]
        assert record["config"]["name"] == f"paper-{count}"
        assert record["parameters"] == digest(tasks[count].model.state_dict())
    with np.load(folder / "parameters.npz") as arrays:
        for name, tensor in tasks[2].model.covariance.state_dict().items():
            np.testing.assert_array_equal(arrays[f"known_2.covariance.{name}"], tensor.numpy())


def test_a_network_is_trained_further_from_its_bundle(
    folder: Path, tasks: dict[int, RegressionTask], spectra: ComplexArray
) -> None:
    start = trained_task(folder, known_count=2)
    further = RegressionTask(replace(PAPER_KNOWN[1], starts_from=None))
    further.start_from(start.task)
    further.model.eval()
    for window in spectra[:2]:
        np.testing.assert_allclose(
            alone(further, window, 2), alone(tasks[2], window, 2), atol=TOLERANCE
        )
    with pytest.raises(ValueError, match="trained with level_exponent"):
        RegressionTask(replace(PAPER_KNOWN[1], level_exponent=0.0)).start_from(start.task)


def test_a_bundle_gives_the_networks_that_no_run_has(
    folder: Path, runs: dict[int, Path], tasks: dict[int, RegressionTask], tmp_path: Path
) -> None:
    other = untrained(tmp_path / "other", PAPER_KNOWN[1], 7)
    known, records = known_tasks(tasks[0], [other, folder])
    same, other_state = tasks[1].model.covariance.state_dict(), task(other).model.state_dict()
    for name, tensor in known[1].model.covariance.state_dict().items():
        torch.testing.assert_close(tensor, same[name], rtol=0, atol=0)
    assert records["1"] == load_bundle(folder).manifest.training["known"]["1"]
    assert records["2"]["parameters"] == digest(other_state)
    with pytest.raises(ValueError, match="has no network for one number"):
        known_tasks(tasks[0], [EMBEDDED_MODELS / "any-array"])


@pytest.mark.learns
def test_the_scenes_of_a_bundle_and_of_what_is_trained_from_it_add_up(
    folder: Path, corpus: Path, singles: Path, tmp_path: Path
) -> None:
    path = folder / "bundle.json"
    fields = json.loads(path.read_text())
    fields["training"]["known"]["2"]["scenes"] = 1000
    copied = Path(shutil.copytree(folder, tmp_path / "copy"))
    (copied / "bundle.json").write_text(json.dumps(fields))
    command = ["train", "--config", "paper-2", "--run", str(tmp_path / "run"), "--smoke"]
    speech = ["--speech-commands", str(corpus), "--singles", str(singles)]
    assert main([*command, *speech, "--init", str(copied)]) == 0
    out = ["--out", str(tmp_path / "out"), "--speech-commands", str(corpus)]
    known = ["--known", str(tmp_path / "run"), str(copied)]
    assert main(["export", "--run", str(copied), *out, *known]) == 0
    training = load_bundle(tmp_path / "out").manifest.training
    assert training["known"]["2"]["scenes"] == 1000 + 4 * 4
    assert training["known"]["1"] == fields["training"]["known"]["1"]


@pytest.fixture
def copy(folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(folder, tmp_path / "copy"))


def rehash(folder: Path, name: str) -> None:
    path = folder / "bundle.json"
    fields = json.loads(path.read_text())
    fields["files"][name] = file_sha256(folder / name)
    path.write_text(json.dumps(fields))


def change(folder: Path, file: str, edit: Callable[[dict[str, FloatArray]], object]) -> None:
    """Edit the arrays of a file of the bundle, with its hash."""
    with np.load(folder / file) as archive:
        arrays = dict(archive)
    edit(arrays)
    np.savez(folder / file, **arrays)  # type: ignore[arg-type]
    rehash(folder, file)


def test_another_network_of_a_count_is_refused(copy: Path) -> None:
    shutil.copyfile(copy / "covariance_1.onnx", copy / "covariance_2.onnx")
    with pytest.raises(BundleCorrupt, match=r"covariance_2\.onnx differs from its hash"):
        load_bundle(copy)
    rehash(copy, "covariance_2.onnx")
    with pytest.raises(SelfTestFailed, match="golden"):
        self_test(load_bundle(copy))


def test_a_network_of_a_count_that_is_missing_is_named(copy: Path) -> None:
    (copy / "covariance_2.onnx").unlink()
    with pytest.raises(BundleCorrupt, match=r"lacks covariance_2\.onnx"):
        load_bundle(copy)
    path = copy / "bundle.json"
    fields = json.loads(path.read_text())
    del fields["files"]["covariance_2.onnx"]
    path.write_text(json.dumps(fields))
    with pytest.raises(BundleCorrupt, match=r"lacks covariance_2\.onnx"):
        load_bundle(copy)


@pytest.mark.parametrize("ending", ["", "_1", "_2"])
def test_every_network_is_in_the_self_test(copy: Path, ending: str) -> None:
    change(copy, FUSION, lambda arrays: arrays.update({f"floor{ending}": np.float32(1.0)}))
    with pytest.raises(SelfTestFailed, match="golden"):
        self_test(load_bundle(copy))


@pytest.mark.parametrize(
    ("file", "name"), [(FUSION, "excite_2"), (GOLDEN, "spectra_0"), (GOLDEN, "spectra_2")]
)
def test_an_array_that_is_missing_is_named(copy: Path, file: str, name: str) -> None:
    change(copy, file, lambda arrays: arrays.pop(name))
    with pytest.raises(BundleCorrupt, match=rf"{file} lacks .*{name}"):
        self_test(load_bundle(copy))


@pytest.mark.parametrize(
    ("config", "reason"),
    [
        (replace(PAPER_KNOWN[1], level_exponent=0.0), "trained with level_exponent 0.0.* has 0.15"),
        (replace(PAPER_KNOWN[1], array="matrix-voice"), "trained with array matrix-voice"),
        (
            replace(PAPER_KNOWN[1], level_exponent=0.0, phase_reference="absolute"),
            "trained with phase_reference absolute",
        ),
        (PAPER, "not trained for one number"),
        (ANY_ARRAY, "not trained for one number"),
        (PAPER_KNOWN[0], "is the second for 1 talkers"),
    ],
)
def test_runs_that_do_not_belong_together_are_refused(
    tmp_path: Path, runs: dict[int, Path], config: TrainingConfig, reason: str
) -> None:
    other = untrained(tmp_path / "other", config, 3)
    with pytest.raises(ValueError, match=reason):
        known_tasks(task(runs[0]), [runs[1], other])

"""The paper's pipeline under training: geometry, losses, scores, learning."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from model_export.simulation.scenes import WINDOW_SAMPLES, Scene
from model_export.training.config import ANY_ARRAY, PAPER
from model_export.training.regression import (
    RegressionBatch,
    RegressionTask,
    collate_regression,
    counted_projector,
    rotated_products,
    subspace_distance,
)
from model_export.training.subspace import signal_projector
from model_export.training.task import STFT
from model_export.training.variants import task_of
from service.doa.evd import signal_subspace
from service.doa.fusion import attention_fusion, attention_weights, normalise
from service.doa.music import signal_power
from service.doa.presets import preset
from service.doa.steering import azimuth_grid, steering_vectors

pytestmark = pytest.mark.torch


ARRAY = preset("respeaker-usb-4mic-v2")
CONFIG = replace(PAPER, grid_size=72, bin_step=1)


def plane_waves(rng: np.random.Generator, *azimuths_deg: float) -> Scene:
    """Anechoic noise bursts from these azimuths, with sensor noise 30 dB below."""
    azimuth = np.deg2rad(np.array(azimuths_deg, dtype=float))
    frequencies = np.fft.rfftfreq(WINDOW_SAMPLES, 1 / STFT.sample_rate)
    steering = steering_vectors(ARRAY.positions, frequencies, azimuth)  # (F, N, M)
    bursts = np.repeat(rng.uniform(0.1, 1, (len(azimuth), 65)), 256, axis=1)
    sources = np.fft.rfft(bursts * rng.standard_normal((len(azimuth), WINDOW_SAMPLES)))
    audio = np.fft.irfft(np.einsum("fnm,mf->nf", steering, sources), WINDOW_SAMPLES)
    audio += 0.02 * rng.standard_normal(audio.shape)
    return Scene(audio.astype(np.float32), ARRAY.positions, azimuth)


def batch_of(*scenes: tuple[float, ...]) -> RegressionBatch:
    rng = np.random.default_rng(0)
    return collate_regression(CONFIG, rng, [plane_waves(rng, *azimuths) for azimuths in scenes])


@pytest.fixture
def task() -> RegressionTask:
    torch.manual_seed(0)
    return RegressionTask(CONFIG)


def turned(batch: RegressionBatch, angle: float) -> RegressionBatch:
    """The batch with array and labels turned by a further angle in radians."""
    return replace(batch, rotation=batch.rotation + angle, azimuth=batch.azimuth + angle)


def fused(task: RegressionTask, batch: RegressionBatch) -> Tensor:
    products = rotated_products(task.array, batch.rotation, batch.grid[None])[0]
    fused: Tensor = task.model(batch.features, products, batch.mask.sum(-1)).fused
    return fused


@torch.no_grad()
def test_turning_array_and_labels_turns_the_spectrum_and_keeps_the_loss(
    task: RegressionTask,
) -> None:
    task.model.eval()
    batch = batch_of((20.0,), (100.0, 250.0))
    steps = 13
    rotated = turned(batch, steps * 2 * np.pi / CONFIG.grid_size)
    torch.testing.assert_close(
        fused(task, rotated), fused(task, batch).roll(steps, -1), rtol=1e-3, atol=1e-4
    )
    before, after = task.losses(batch), task.losses(rotated)
    for name in before:
        torch.testing.assert_close(after[name], before[name], rtol=1e-3, atol=1e-4)


@torch.no_grad()
def test_turning_the_labels_alone_changes_the_loss(task: RegressionTask) -> None:
    task.model.eval()
    batch = batch_of((20.0,))
    spoiled = replace(turned(batch, 1.0), rotation=batch.rotation)
    assert abs(task.losses(spoiled)["spectrum"] - task.losses(batch)["spectrum"]) > 1e-5


def test_batches_are_turned_at_random_and_their_audio_is_not() -> None:
    rng = np.random.default_rng(0)
    scene = plane_waves(rng, 20.0)
    first, second = (
        collate_regression(CONFIG, rng, [scene]),
        collate_regression(CONFIG, rng, [scene]),
    )
    assert first.rotation != second.rotation
    torch.testing.assert_close(first.features, second.features)
    for batch in (first, second):
        label = (batch.azimuth[0, 0] - batch.rotation).item()
        assert np.rad2deg(label) == pytest.approx(20.0, abs=1e-3)


@torch.no_grad()
def test_the_service_computes_the_same_fused_spectra(task: RegressionTask) -> None:
    task.model.eval()
    batch = replace(batch_of((20.0,), (100.0, 250.0)), rotation=torch.tensor(0.0))
    model = task.model
    parts = model.covariance(batch.features).numpy()
    steering = steering_vectors(ARRAY.positions, STFT.frequencies, azimuth_grid(CONFIG.grid_size))
    for scene, num_sources in enumerate((1, 2)):
        covariance = parts[scene, :, 0] + 1j * parts[scene, :, 1]
        power = signal_power(signal_subspace(covariance, num_sources), steering)
        spectra = normalise(1 / (1 - np.minimum(power, 1) + model.log_floor.exp().item()))
        attention = attention_weights(
            spectra, model.fusion.squeeze.weight.numpy(), model.fusion.excite.weight.numpy()
        )
        np.testing.assert_allclose(
            fused(task, batch)[scene], attention_fusion(spectra, attention), atol=1e-4
        )


def test_projectors_of_mixed_counts_are_those_of_each_scene_alone() -> None:
    torch.manual_seed(0)
    root = torch.randn(6, 5, 4, 4, dtype=torch.complex64)
    covariance = root @ root.mH
    counts = torch.tensor([2, 0, 1, 4, 3, 1])
    projectors = counted_projector(covariance, counts)
    for scene, count in enumerate([2, 1, 1, 3, 3, 1]):  # 0 and 4 of 4 leave one subspace
        torch.testing.assert_close(projectors[scene], signal_projector(covariance[scene], count))


def test_the_subspace_distance_is_zero_at_the_truth_and_one_across_it() -> None:
    azimuth = torch.deg2rad(torch.tensor([[70.0, 0.0, 0.0, 0.0]]))
    mask = torch.tensor([[True, False, False, False]])
    products = rotated_products(ARRAY, torch.tensor(0.0), azimuth)
    steering = steering_vectors(ARRAY.positions, STFT.frequencies, azimuth[0, :1].numpy())
    truth = torch.from_numpy(steering @ steering.conj().swapaxes(-1, -2))[None] / 4
    across = torch.eye(4) - truth
    assert subspace_distance(truth, products, mask).item() == pytest.approx(0, abs=1e-5)
    assert subspace_distance(across, products, mask).item() == pytest.approx(1, abs=1e-5)
    assert subspace_distance(across, products, torch.zeros_like(mask)).item() == 0


def test_the_loss_is_the_weighted_sum_and_reaches_every_parameter(task: RegressionTask) -> None:
    losses = task.losses(batch_of((20.0,), (100.0, 250.0), ()))
    expected = losses["spectrum"] + 0.5 * losses["count"] + losses["subspace"]
    torch.testing.assert_close(losses["loss"], expected)
    losses["loss"].backward()
    for name, parameter in task.model.named_parameters():
        assert parameter.grad is not None, name
        assert torch.isfinite(parameter.grad).all(), name
        assert parameter.grad.any(), name


def test_scenes_without_a_source_train_the_count_alone(task: RegressionTask) -> None:
    losses = task.losses(batch_of((), ()))
    assert losses["spectrum"] == 0
    assert losses["subspace"] == 0
    losses["loss"].backward()
    gradients = [parameter.grad for parameter in task.model.covariance.parameters()]
    assert not any(gradient is not None and gradient.any() for gradient in gradients)


def test_the_variant_s_task_needs_an_array() -> None:
    assert isinstance(task_of(PAPER), RegressionTask)
    with pytest.raises(ValueError, match="name its preset"):
        RegressionTask(ANY_ARRAY)


@torch.no_grad()
def test_half_of_the_bins_form_the_spectra_that_all_of_them_would(task: RegressionTask) -> None:
    task.model.eval()
    batch = batch_of((20.0,), (100.0, 250.0))
    half = replace(batch, bins=torch.arange(0, 257, 2))
    for name, value in task.losses(half).items():
        assert value.item() == pytest.approx(task.losses(batch)[name].item(), rel=0.05), name
    drawn = [
        collate_regression(
            replace(CONFIG, bin_step=2),
            np.random.default_rng(seed),
            [plane_waves(np.random.default_rng(0), 20.0)],
        ).bins
        for seed in range(8)
    ]
    assert {int(bins[0]) for bins in drawn} == {0, 1}
    assert all((bins.diff() == 2).all() and bins[-1] >= 255 for bins in drawn)


@torch.no_grad()
def test_scores_are_the_errors_of_the_peaks_that_the_service_picks(task: RegressionTask) -> None:
    task.model.eval()
    batch = batch_of((20.0,), (100.0, 250.0), ())
    scores = task.scores(batch)
    assert scores["error_deg"].shape == (2,)
    assert scores["count_accuracy"].shape == (3,)
    azimuth = np.rad2deg(batch.azimuth[0, 0].item())
    spectrum = fused(task, replace(batch, grid=torch.from_numpy(azimuth_grid(360)).float()))[0]
    nearest = abs((spectrum.argmax().item() - azimuth + 180) % 360 - 180)
    assert scores["error_deg"][0].item() == pytest.approx(nearest, abs=1)


def test_a_known_count_trains_no_count_branch() -> None:
    task = RegressionTask(replace(CONFIG, count_weight=0.0))
    batch = batch_of((20.0,))
    losses = task.losses(batch)
    assert "count" not in losses
    with torch.no_grad():
        assert "count_accuracy" not in task.scores(batch)
    losses["loss"].backward()
    assert all(parameter.grad is None for parameter in task.model.count.parameters())


@pytest.mark.learns
def test_the_pipeline_learns_four_scenes() -> None:
    torch.manual_seed(0)
    task = RegressionTask(CONFIG)
    batch = batch_of((20.0,), (130.0,), (205.0,), (310.0,))
    optimizer = torch.optim.Adam(task.model.parameters(), 1e-3)
    for _ in range(60):
        task.model.train()
        losses = task.losses(batch)
        optimizer.zero_grad()
        losses["loss"].backward()
        optimizer.step()
    task.model.eval()
    with torch.no_grad():
        scores = task.scores(batch)
    assert scores["error_deg"].max() < 5
    assert scores["count_accuracy"].min() == 1


def test_without_attention_the_bins_count_alike_and_stay_so_in_training() -> None:
    torch.manual_seed(0)
    task = RegressionTask(replace(CONFIG, attention=False))
    optimizer = torch.optim.AdamW(task.model.parameters(), lr=0.1, weight_decay=0.1)
    task.losses(batch_of((20.0,)))["loss"].backward()
    optimizer.step()
    spectrum = torch.rand(2, STFT.num_bins, 72)
    torch.testing.assert_close(task.model.fusion(spectrum), spectrum.mean(1))
    bins = torch.arange(1, STFT.num_bins, 2)
    some = task.model.fusion(spectrum[:, bins], bins)
    torch.testing.assert_close(some, spectrum[:, bins].mean(1))

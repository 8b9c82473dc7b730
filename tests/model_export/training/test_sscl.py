"""Self-supervised pretraining: masks, what the encoder may see, learning, and the transfer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from model_export.__main__ import main
from model_export.simulation.scenes import WINDOW_SAMPLES, Scene
from model_export.training.config import ANY_ARRAY, PAPER, PAPER_SSCL, TrainingConfig
from model_export.training.masking import MASKED_SHARE, draw_mask, masked_features
from model_export.training.networks.encoder import Encoder
from model_export.training.regression import RegressionTask
from model_export.training.sscl import (
    MaskedBatch,
    ReconstructionDecoder,
    SsclTask,
    collate_masked,
    load_encoder,
)
from model_export.training.task import STFT
from model_export.training.variants import task_of
from service.doa.presets import preset
from service.doa.spectrogram import spectrogram_features
from service.doa.steering import steering_vectors
from service.doa.types import ComplexArray

pytestmark = pytest.mark.torch

ARRAY = preset(PAPER_SSCL.array or "")
FIRST, SECOND = (
    replace(config, level_exponent=0.0, smooth_kernels=0, pool_first=False)
    for config in (PAPER_SSCL, PAPER)
)
"""Both stages of the text's plain parameters"""


def plane_wave(rng: np.random.Generator, azimuth_deg: float) -> Scene:
    """An anechoic noise burst, with sensor noise 30 dB below."""
    frequencies = np.fft.rfftfreq(WINDOW_SAMPLES, 1 / STFT.sample_rate)
    steering = steering_vectors(ARRAY.positions, frequencies, np.deg2rad([azimuth_deg]))[..., 0]
    source = np.fft.rfft(rng.standard_normal(WINDOW_SAMPLES))
    audio = np.fft.irfft(steering.T * source, WINDOW_SAMPLES)
    audio += 0.03 * rng.standard_normal(audio.shape)
    return Scene(audio.astype(np.float32), ARRAY.positions, np.deg2rad([azimuth_deg]))


def pair() -> MaskedBatch:
    """The same scene twice."""
    scene = plane_wave(np.random.default_rng(1), 70.0)
    return collate_masked(np.random.default_rng(0), [scene] * 2)


def noise_spectra(scenes: int = 3) -> ComplexArray:
    rng = np.random.default_rng(0)
    shape = (scenes, 4, 257, 64)
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)


def test_masks_cover_the_stated_share_in_spans_bands_and_cells() -> None:
    rng = np.random.default_rng(0)
    kinds = {"time": 0, "frequency": 0, "cells": 0}
    shares = []
    for _ in range(600):
        mask = draw_mask(rng, 257, 64)
        shares.append(mask.mean())
        frames, bins = mask.all(axis=0), mask.all(axis=1)
        if frames.any():
            kinds["time"] += 1
            assert mask.sum() == 257 * frames.sum()
            assert (np.diff(np.flatnonzero(frames)) == 1).all()
        elif bins.any():
            kinds["frequency"] += 1
            assert mask.sum() == 64 * bins.sum()
            assert (np.diff(np.flatnonzero(bins)) == 1).all()
        else:
            kinds["cells"] += 1
    assert min(kinds.values()) > 150
    low, high = MASKED_SHARE
    assert low - 0.02 < min(shares) < low + 0.05
    assert high - 0.05 < max(shares) < high + 0.02


@pytest.mark.parametrize("microphone", range(4))
def test_features_tell_nothing_of_the_masked_cells_of_the_microphone(microphone: int) -> None:
    spectra, chosen = noise_spectra(), np.full(3, microphone)
    mask = np.stack([draw_mask(np.random.default_rng(i), 257, 64) for i in range(3)])
    features = masked_features(spectra, chosen, mask)
    spoiled = spectra.copy()
    spoiled[:, microphone] *= np.where(mask, 17j, 1)
    np.testing.assert_array_equal(masked_features(spoiled, chosen, mask), features)


@pytest.mark.parametrize("microphone", range(4))
def test_masked_cells_keep_the_other_microphones_whole(microphone: int) -> None:
    spectra, chosen = noise_spectra(), np.full(3, microphone)
    mask = np.stack([draw_mask(np.random.default_rng(i), 257, 64) for i in range(3)])
    features = masked_features(spectra, chosen, mask)
    # Imaginary parts of microphones 1 to 3 stand behind the four real parts and the level.
    imaginary = np.concatenate([np.zeros((3, 1, 257, 64)), features[:, 5:]], axis=1)
    vectors = (features[:, :4] + 1j * imaginary).transpose(0, 2, 3, 1)[mask]
    truth = np.delete(spectra, microphone, axis=1).transpose(0, 2, 3, 1)[mask]
    np.testing.assert_array_equal(vectors[:, microphone], 0)
    others = np.delete(vectors, microphone, axis=1)
    # The same vector up to one phase and scale: collinear, and of unit norm.
    overlap = np.abs((others.conj() * truth).sum(-1)) / np.linalg.norm(truth, axis=-1)
    np.testing.assert_allclose(overlap, 1, atol=1e-5)


def test_unmasked_cells_and_microphones_differ_from_plain_features_by_the_level_only() -> None:
    spectra, chosen = noise_spectra(), np.array([0, 1, 3])
    mask = np.stack([draw_mask(np.random.default_rng(i), 257, 64) for i in range(3)])
    features, plain = masked_features(spectra, chosen, mask), spectrogram_features(spectra)
    unmasked = np.broadcast_to(~mask[:, None], features.shape).copy()
    unmasked[:, 4] = False  # relative to the window's mean level, to which masked cells add less
    np.testing.assert_array_equal(features[unmasked], plain[unmasked])


def test_a_microphone_never_contributes_to_its_own_reconstruction() -> None:
    torch.manual_seed(0)
    task = SsclTask(PAPER_SSCL)
    batch = pair()
    spoiled = batch.spectra.clone()
    spoiled[torch.arange(2), batch.microphone] = 5
    model = task.model.eval()
    torch.testing.assert_close(
        model(batch.features, spoiled, batch.microphone),
        model(batch.features, batch.spectra, batch.microphone),
    )
    coefficients = ReconstructionDecoder(4)(torch.randn(1, 257, 64))
    assert not coefficients.diagonal(dim1=-2, dim2=-1).any()
    assert coefficients.abs().sum() > 0


def test_only_loud_masked_cells_count() -> None:
    scene = plane_wave(np.random.default_rng(0), 10.0)
    audio = scene.audio.copy()
    audio[:, : WINDOW_SAMPLES // 2] *= 1e-3
    batch = collate_masked(np.random.default_rng(0), [replace(scene, audio=audio)] * 12)
    cells = batch.cells
    assert not cells[:, :, :31].any()
    # Half the frames are loud, and 40 to 75 % of them are masked, less evenly in spans.
    assert 0.15 < cells.float().mean() < 0.42


def test_the_loss_is_the_share_of_the_power_that_is_missing() -> None:
    task = SsclTask(PAPER_SSCL)
    batch = pair()
    torch.nn.init.zeros_(task.model.decoder.linear.weight)
    torch.nn.init.zeros_(task.model.decoder.linear.bias)
    with torch.no_grad():
        assert task.scores(batch)["unexplained"].item() == pytest.approx(1, abs=1e-5)


@pytest.mark.learns
def test_the_task_learns_and_reaches_every_parameter() -> None:
    torch.manual_seed(0)
    task = task_of(PAPER_SSCL)
    rng = np.random.default_rng(0)
    batch = collate_masked(rng, [plane_wave(rng, azimuth) for azimuth in (20, 130, 205, 310)])
    optimizer = torch.optim.Adam(task.model.parameters(), 3e-3)
    losses = []
    for _ in range(15):
        task.model.train()
        loss = task.losses(batch)["loss"]
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    # The best direction-independent combination leaves more than a third; the truth next to none.
    assert losses[-1] < 0.3
    for name, parameter in task.model.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.any(), name


def test_the_supervised_stage_takes_the_encoder_and_nothing_else() -> None:
    torch.manual_seed(0)
    start, task = SsclTask(FIRST), RegressionTask(SECOND)
    start.model.encoder[0][1].running_mean += 3  # statistics belong to it, too
    before = {name: value.clone() for name, value in task.model.state_dict().items()}
    task.start_from(start)
    after = task.model.state_dict()
    encoder = start.model.encoder.state_dict()
    assert set(after) == set(before)
    for name, value in after.items():
        prefix, _, rest = name.partition("encoder.")
        expected = encoder[rest] if prefix == "covariance." and rest else before[name]
        torch.testing.assert_close(value, expected, rtol=0, atol=0)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (replace(SECOND, array="av163-circle8"), "array respeaker-usb-4mic-v2"),
        (replace(SECOND, phase_reference="absolute"), "phase_reference first"),
        (replace(SECOND, level_exponent=0.1), "level_exponent 0.0"),
    ],
)
def test_an_encoder_for_other_inputs_is_refused(config: TrainingConfig, message: str) -> None:
    task = RegressionTask(config)
    with pytest.raises(ValueError, match=message):
        task.start_from(SsclTask(FIRST))


def test_an_encoder_of_another_shape_or_with_other_names_is_refused() -> None:
    start = SsclTask(FIRST)
    with pytest.raises(ValueError, match="does not fit"):
        load_encoder(Encoder(6), start, SECOND)
    start.model.encoder[0] = torch.nn.Identity()  # type: ignore[assignment]
    with pytest.raises(ValueError, match="does not fit"):
        load_encoder(Encoder(4), start, SECOND)


def test_other_kinds_of_runs_are_no_first_stage() -> None:
    for task in (RegressionTask(PAPER), SsclTask(PAPER_SSCL)):
        with pytest.raises(ValueError, match="sscl"):
            task.start_from(task_of(ANY_ARRAY))


def test_the_variant_needs_an_array_and_features_that_it_can_mask() -> None:
    with pytest.raises(ValueError, match="name its preset"):
        SsclTask(ANY_ARRAY)
    with pytest.raises(ValueError, match="phase_reference"):
        SsclTask(replace(FIRST, phase_reference="absolute"))


@pytest.mark.learns
def test_both_stages_run_from_the_command_line(
    corpus: Path, singles: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    data = ["--rooms", str(tmp_path), "--speech-commands", str(corpus)]
    speech = [*data[2:], "--singles", str(singles), "--smoke"]
    supervised = ["train", "--config", "paper", "--run", str(second), *speech]
    assert main(["train", "--config", "paper-sscl", "--run", str(first), *speech]) == 0
    header, *rows = (first / "curves.csv").read_text().splitlines()
    assert header == "step,time,loss,unexplained"
    assert [row.split(",")[0] for row in rows] == ["2", "4"]
    assert main(supervised) == 2
    assert "paper-sscl" in capsys.readouterr().err
    assert main([*supervised, "--init", str(first)]) == 0
    assert main([*supervised[:4], str(tmp_path / "third"), *speech, "--scratch"]) == 0
    assert main(["train", "--config", "paper", "--run", "x", "--scratch", *data[2:]]) == 2
    assert "--singles" in capsys.readouterr().err
    assert (second / "checkpoint.pt").exists()
    assert main(["export", "--run", str(first), "--out", str(tmp_path / "x"), *data]) == 2
    assert "paper" in capsys.readouterr().err

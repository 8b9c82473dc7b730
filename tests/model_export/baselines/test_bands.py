"""Narrow bands: the same covariances from audio and from the matched track's features."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from overfitting import truth_of

from model_export.baselines.bands import (
    band_bins,
    band_snapshots,
    gram_planes,
    hermitian_planes,
    ideal_covariance,
    lagged_covariances,
    matched_snapshots,
    planes,
)
from model_export.baselines.matched import matched_features
from model_export.baselines.network import Truth
from model_export.simulation.protocol import SimulatedScene
from model_export.training.task import STFT
from service.doa.covariance import sample_covariance
from service.doa.presets import preset
from service.doa.steering import steering_vectors

pytestmark = pytest.mark.torch

ARRAY = preset("respeaker-usb-4mic-v2")
BINS = band_bins(10)


def test_bands_are_spread_over_the_speech_band() -> None:
    frequencies = STFT.frequencies[list(BINS)]
    assert abs(frequencies[0] - 300) < 16
    assert abs(frequencies[-1] - 3500) < 16
    assert np.ptp(np.diff(BINS)) <= 1


def test_covariances_are_the_service_s_with_a_trace_of_n(scenes: list[SimulatedScene]) -> None:
    audio = np.stack([scene.audio for scene in scenes])
    covariance = lagged_covariances(band_snapshots(audio, BINS), 1)[:, :, 0].numpy()
    wanted = sample_covariance(STFT.transform(audio)[..., :64][:, :, list(BINS)])
    wanted *= 4 / np.trace(wanted, axis1=-2, axis2=-1)[..., None, None]
    np.testing.assert_allclose(covariance, wanted, atol=1e-4)


def test_the_matched_features_have_the_same_covariances(scenes: list[SimulatedScene]) -> None:
    audio = np.stack([scene.audio for scene in scenes])
    features = torch.from_numpy(matched_features(audio))
    matched = lagged_covariances(matched_snapshots(features, BINS), 1)
    torch.testing.assert_close(
        matched, lagged_covariances(band_snapshots(audio, BINS), 1), atol=1e-3, rtol=0
    )


def test_a_lag_pairs_a_frame_with_a_later_one() -> None:
    snapshots = torch.zeros(1, 2, 1, 5, dtype=torch.complex64)
    snapshots[0, 0, 0, 1], snapshots[0, 1, 0, 3] = 2j, 3.0
    covariance = lagged_covariances(snapshots, 3)[0, 0]
    assert covariance[2, 0, 1].item() == pytest.approx(6j / 3)
    assert covariance[1].abs().max() == 0
    assert covariance[2, 1, 0].item() == 0


def test_the_ideal_covariance_is_that_of_plane_waves_and_zero_without_any() -> None:
    azimuth = torch.tensor([[0.3, 2.0, 0.0], [1.0, 0.0, 0.0]])
    truth = Truth(azimuth, torch.tensor([[True, True, False], [False, False, False]]))
    frequencies = STFT.frequencies[list(BINS)]
    ideal = ideal_covariance(ARRAY, truth, frequencies)
    steering = steering_vectors(ARRAY.positions, frequencies, azimuth[0, :2].numpy())
    wanted = steering @ steering.conj().swapaxes(-1, -2) / 2
    np.testing.assert_allclose(ideal[0].numpy(), wanted, atol=1e-5)
    assert ideal[1].abs().max() == 0


def test_planes_compute_as_the_complex_matrices_that_they_stand_for() -> None:
    root = torch.randn(3, 4, 4, dtype=torch.complex64)
    gram = root @ root.mH + 0.5 * torch.eye(4)
    torch.testing.assert_close(gram_planes(planes(root), 0.5), planes(gram))
    torch.testing.assert_close(hermitian_planes(planes(root)), planes(0.5 * (root + root.mH)))


def test_ideal_covariances_are_near_those_of_scenes_almost_without_reverberation(
    scenes: list[SimulatedScene],
) -> None:
    """Conventions of labels, arrays and spectra agree: the truth fits better than its mirror."""
    audio = np.stack([scene.audio for scene in scenes])
    sample = lagged_covariances(band_snapshots(audio, BINS), 1)[:, :, 0]
    truth = truth_of(scenes)
    mirrored = Truth(-truth.azimuth, truth.mask)
    array, frequencies = scenes[0].array, STFT.frequencies[list(BINS)]
    right = (ideal_covariance(array, truth, frequencies) - sample).abs().mean((1, 2, 3))
    wrong = (ideal_covariance(array, mirrored, frequencies) - sample).abs().mean((1, 2, 3))
    single = truth.count == 1
    assert (right[single] < wrong[single]).all()

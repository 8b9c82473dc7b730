"""Properties of all covariance and subspace methods of the comparison, as cited and matched."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from overfitting import talkers, untrained_parameters
from torch import Tensor, nn

from model_export.baselines.bands import planes
from model_export.baselines.hybrids import hybrid_methods
from model_export.baselines.matched import MatchedSubspace
from model_export.baselines.music import HybridNetwork
from model_export.baselines.network import MAX_TALKERS, BaselineNetwork, Truth, decoded
from model_export.simulation.protocol import SimulatedScene
from model_export.training.task import STFT
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.steering import steering_vectors

pytestmark = pytest.mark.torch

WIDTH = 0.06
METHODS = hybrid_methods()
NAMES = sorted(METHODS)
HYBRIDS = [name for name in NAMES if METHODS[name].card.kind == "hybrid"]
POSITIVE = ("subspacenet", "transmusic")
"""Methods whose covariances have no negative eigenvalue by construction"""
TRACKS = ("cited", "matched")
SIX = MicrophoneArray(
    "circle of six",
    np.array([[0.05 * np.cos(a), 0.05 * np.sin(a), 0.0] for a in np.arange(6) * np.pi / 3]),
)
ARRAYS = {4: preset("respeaker-usb-4mic-v2"), 6: SIX}


@pytest.fixture(scope="module")
def one_to_three() -> list[SimulatedScene]:
    return talkers((1, 2, 3))


def network_of(name: str, track: str, microphones: int = 4) -> BaselineNetwork:
    baseline = METHODS[name]
    if track == "cited":
        return baseline.cited(microphones, width=WIDTH)
    return baseline.matched(microphones, width=WIDTH)


def features_of(network: BaselineNetwork, microphones: int = 4) -> Tensor:
    rng = np.random.default_rng(0)
    audio = rng.standard_normal((2, microphones, STFT.num_samples(64)), dtype=np.float32)
    return torch.from_numpy(network.features(audio))


def covariance_of(network: BaselineNetwork) -> nn.Module:
    """The network from features to covariances."""
    if isinstance(network, HybridNetwork):
        return network.covariance
    assert isinstance(network, MatchedSubspace)
    return network.trunk


def music_spectrum_of(
    network: BaselineNetwork, features: Tensor, array: MicrophoneArray, counts: Tensor
) -> Tensor:
    """Spectrum (B, 360) of a method, also of those that output directions."""
    if isinstance(network, HybridNetwork):
        return network.music_of(features, array, counts).spectrum.mean(1)
    spectrum = network(features, array, counts).spectrum
    assert spectrum is not None
    return spectrum


@pytest.mark.parametrize("microphones", [4, 6])
@pytest.mark.parametrize("track", TRACKS)
@pytest.mark.parametrize("name", NAMES)
@torch.no_grad()
def test_a_spectrum_within_bounds_or_angles_for_every_count(
    name: str, track: str, microphones: int
) -> None:
    network = network_of(name, track, microphones).eval()
    prediction = network(features_of(network, microphones), ARRAYS[microphones])
    assert prediction.count.shape == (2, MAX_TALKERS + 1)
    if prediction.spectrum is None:
        assert [a.shape for a in prediction.angles] == [(2, 1), (2, 2), (2, 3)]
    else:
        assert prediction.spectrum.shape == (2, 360)
        assert 0 <= prediction.spectrum.min() <= prediction.spectrum.max() <= 1 + 1e-6


@pytest.mark.parametrize("microphones", [4, 6])
@pytest.mark.parametrize("track", TRACKS)
@pytest.mark.parametrize("name", HYBRIDS)
@torch.no_grad()
def test_covariances_are_hermitian_and_positive_where_the_method_says_so(
    name: str, track: str, microphones: int
) -> None:
    network = network_of(name, track, microphones)
    parts = covariance_of(network)(features_of(network, microphones))
    matrix = torch.complex(parts[:, :, 0], parts[:, :, 1])
    assert matrix.shape[2:] == (microphones, microphones)
    torch.testing.assert_close(matrix, matrix.mH)
    if name in POSITIVE:
        assert torch.linalg.eigvalsh(matrix).min() > 0


@pytest.mark.parametrize("track", TRACKS)
@pytest.mark.parametrize("name", NAMES)
def test_every_parameter_has_a_finite_gradient(
    name: str, track: str, one_to_three: list[SimulatedScene]
) -> None:
    assert untrained_parameters(network_of(name, track), one_to_three) == []


@pytest.mark.parametrize("track", TRACKS)
@pytest.mark.parametrize("name", NAMES)
def test_silence_without_sources_has_a_finite_loss_and_gradients(name: str, track: str) -> None:
    network = network_of(name, track).train()
    silence = np.zeros((3, 4, STFT.num_samples(64)), dtype=np.float32)
    features = torch.from_numpy(network.features(silence))
    truth = Truth(torch.zeros(3, MAX_TALKERS), torch.zeros(3, MAX_TALKERS, dtype=torch.bool))
    prediction = network(features, ARRAYS[4], truth.count)
    loss = network.loss(prediction, truth, ARRAYS[4])
    loss.backward()
    assert loss.isfinite()
    gradients = [p.grad for p in network.parameters() if p.grad is not None]
    assert any(gradient.any() for gradient in gradients)
    assert all(gradient.isfinite().all() for gradient in gradients)


@pytest.mark.parametrize("track", TRACKS)
@pytest.mark.parametrize("name", HYBRIDS)
@torch.no_grad()
def test_turning_the_array_turns_the_spectrum(name: str, track: str) -> None:
    network = network_of(name, track).eval()
    assert network.steered
    features, counts, array = features_of(network), torch.tensor([1, 2]), ARRAYS[4]
    straight = music_spectrum_of(network, features, array, counts)
    turned = music_spectrum_of(network, features, array.rotated(np.deg2rad(30)), counts)
    torch.testing.assert_close(turned, straight.roll(30, -1), rtol=1e-3, atol=1e-3)
    assert (turned - straight).abs().max() > 0.01


class IdealCovariance(nn.Module):
    """Covariances of plane waves, whatever the features."""

    def __init__(self, array: MicrophoneArray, bins: list[int], azimuth_deg: list[float]) -> None:
        super().__init__()
        azimuth = np.deg2rad(np.array(azimuth_deg))
        steering = steering_vectors(array.positions, STFT.frequencies[bins], azimuth)
        noise = 0.01 * np.eye(len(array.positions), dtype=np.complex64)
        covariance = steering @ steering.conj().swapaxes(-1, -2) + noise
        self.register_buffer("parts", planes(torch.from_numpy(covariance)))

    def forward(self, features: Tensor) -> Tensor:
        parts: Tensor = self.parts.expand(len(features), *self.parts.shape)
        return parts


@pytest.mark.parametrize("azimuth_deg", [[73.0], [200.0, 290.0]])
@pytest.mark.parametrize("track", TRACKS)
@pytest.mark.parametrize("name", HYBRIDS)
@torch.no_grad()
def test_music_names_the_directions_of_ideal_covariances(
    name: str, track: str, azimuth_deg: list[float]
) -> None:
    network = network_of(name, track).eval()
    if isinstance(network, HybridNetwork):
        frequencies = network.music.frequencies
    else:
        assert isinstance(network, MatchedSubspace)
        frequencies = network.frequencies
    bins = (frequencies * STFT.n_fft / STFT.sample_rate).astype(int).tolist()
    ideal = IdealCovariance(ARRAYS[4], bins, azimuth_deg)
    setattr(network, "covariance" if isinstance(network, HybridNetwork) else "trunk", ideal)
    features, counts = features_of(network), torch.tensor([len(azimuth_deg)] * 2)
    spectrum = music_spectrum_of(network, features, ARRAYS[4], counts)
    prediction = network(features, ARRAYS[4], counts)
    found = decoded(type(prediction)(prediction.count, spectrum=spectrum), len(azimuth_deg)).azimuth
    np.testing.assert_allclose(np.sort(np.rad2deg(found)), azimuth_deg, atol=0.5)


def test_cards_name_the_methods_and_widths_are_at_most_the_cited_size() -> None:
    assert NAMES == ["da_music", "deepmusic", "subspacenet", "transmusic", "unet_rootmusic"]
    for name, baseline in METHODS.items():
        assert baseline.cited(4, width=WIDTH).card is baseline.card, name
        assert baseline.matched(4, width=WIDTH).card is baseline.card, name
        assert 0 < baseline.cited_width <= 1
        assert 0 < baseline.trunk_width <= 1

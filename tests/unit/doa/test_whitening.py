"""Whitening against the generalised eigenvalue problem and against noises known by construction."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from neuralmusic.errors import NoiseCalibrationFailed, NoiseMismatch
from service.doa.array import MicrophoneArray
from service.doa.covariance import sample_covariance
from service.doa.presets import preset
from service.doa.steering import azimuth_grid, steering_vectors
from service.doa.stft import Stft
from service.doa.types import ComplexArray, FloatArray
from service.doa.whitening import (
    LOADING,
    NoiseCovariance,
    NoiseEstimator,
    Whitening,
    learn_noise,
)

SQUARE = preset("respeaker-usb-4mic-v2")
STFT = Stft()
BINS = STFT.num_bins


def random_covariance(rng: np.random.Generator, bins: int, rank: int = 9) -> ComplexArray:
    factor = rng.standard_normal((bins, 4, rank)) + 1j * rng.standard_normal((bins, 4, rank))
    return factor @ np.conj(np.swapaxes(factor, -1, -2)) / rank


def noise_of(covariance: ComplexArray) -> NoiseCovariance:
    return NoiseCovariance(covariance.astype(np.complex64), SQUARE, STFT, 5.0)


def white(seconds: float, level: float = 0.01, seed: int = 0) -> FloatArray:
    rng = np.random.default_rng(seed)
    samples = rng.standard_normal((4, round(seconds * 16000)), dtype=np.float32)
    return np.float32(level) * samples


def test_whitened_eigenvalues_are_the_generalised_ones() -> None:
    rng = np.random.default_rng(3)
    received, noise = random_covariance(rng, BINS), random_covariance(rng, BINS)
    whitening = Whitening.of(noise_of(noise), loading=0.0)
    w = whitening.matrices.astype(np.complex128)
    np.testing.assert_allclose(w, np.conj(np.swapaxes(w, -1, -2)), atol=1e-6)
    for index in range(0, BINS, 16):
        values, vectors = np.linalg.eigh(w[index] @ received[index] @ w[index])
        expected, generalised = scipy.linalg.eigh(received[index], noise[index])
        # The scale of W(f) is free: that of the weakest direction of Q is 1.
        scale = np.linalg.eigvalsh(noise[index])[0]
        np.testing.assert_allclose(values, scale * expected, rtol=1e-4)
        for e, u in zip(generalised.T, vectors.T, strict=True):
            back = w[index] @ u
            cosine = np.abs(np.vdot(e, back)) / np.linalg.norm(e) / np.linalg.norm(back)
            assert cosine == pytest.approx(1.0, abs=1e-5)


def test_music_in_whitened_space_has_the_denominator_of_the_generalised_noise_vectors() -> None:
    rng = np.random.default_rng(4)
    received, noise = random_covariance(rng, 1)[0], random_covariance(rng, 1)[0]
    whitening = Whitening.of(noise_of(np.repeat(noise[None], BINS, axis=0)), loading=0.0)
    steering = steering_vectors(SQUARE.positions, np.array([2000.0]), azimuth_grid(36))
    one = whitening.band(slice(0, 1))
    a, w = one.steering(steering)[0], one.matrices[0]
    np.testing.assert_allclose(np.linalg.norm(a, axis=0) ** 2, 4.0, rtol=1e-5)
    _, vectors = np.linalg.eigh(w @ received @ w)
    denominator = 4 - np.abs(np.conj(vectors[:, -1]) @ a) ** 2
    # e^H a of the generalised noise vectors, whose Q-norm is 1, over the length of Q^(-1/2) a.
    _, generalised = scipy.linalg.eigh(received, noise)
    raw = np.sum(np.abs(np.conj(generalised[:, :3].T) @ steering[0]) ** 2, axis=0)
    length = np.einsum("na,nm,ma->a", np.conj(steering[0]), np.linalg.inv(noise), steering[0])
    np.testing.assert_allclose(denominator, 4 * raw / length.real, rtol=1e-3)


def test_spatially_white_noise_of_any_colour_changes_nothing() -> None:
    colour = np.logspace(-8, 2, BINS)[:, None, None]
    whitening = Whitening.of(noise_of(colour * np.eye(4)))
    np.testing.assert_allclose(whitening.matrices, np.broadcast_to(np.eye(4), (BINS, 4, 4)))
    silent = np.zeros((BINS, 4, 4))
    np.testing.assert_allclose(Whitening.of(noise_of(silent)).matrices[7], np.eye(4))


def test_a_noise_from_one_place_is_taken_down_by_the_loading_and_nothing_else_is() -> None:
    a = steering_vectors(SQUARE.positions, STFT.frequencies, np.array([0.7]))[..., 0]  # (F, N)
    whitening = Whitening.of(noise_of(a[:, :, None] * np.conj(a[:, None, :])))
    gain = np.linalg.norm(np.einsum("fnm,fm->fn", whitening.matrices, a), axis=-1) / 2
    expected = np.sqrt(LOADING / (4 + LOADING))  # -46 dB
    np.testing.assert_allclose(gain, expected, rtol=1e-3)
    other = np.array([1.0, -1.0, 0.0, 0.0]) * np.exp(1j * np.angle(a))  # orthogonal to a
    kept = np.einsum("fnm,fm->fn", whitening.matrices, other.astype(np.complex64))
    np.testing.assert_allclose(kept, other, atol=2e-3)  # a is rounded to float32


def test_noise_learnt_from_audio_is_white_afterwards() -> None:
    rng = np.random.default_rng(5)
    mixing = rng.standard_normal((4, 4))
    learnt = learn_noise([(mixing @ white(8)).astype(np.float32)], SQUARE, STFT)
    assert learnt.seconds == pytest.approx(8, abs=0.05)
    other = STFT.transform((mixing @ white(8, seed=1)).astype(np.float32))
    whitened = sample_covariance(Whitening.of(learnt, loading=1e-6).apply(other))
    values = np.linalg.eigvalsh(whitened)[2:-2]
    # 500 frames of 4 channels, learnt from as many: eigenvalues within a factor of about two.
    assert np.all(values[:, -1] < 2.5 * values[:, 0])
    raw = np.linalg.eigvalsh(sample_covariance(other))[2:-2]
    assert np.median(raw[:, -1] / raw[:, 0]) > 10


def test_blocks_of_any_length_give_the_average_over_frames() -> None:
    spectra = STFT.transform(white(3))
    parts = NoiseEstimator(SQUARE, STFT)
    for part in np.array_split(spectra, 7, axis=-1):
        parts.add(part)
    expected = sample_covariance(spectra)
    np.testing.assert_allclose(parts.finish().covariance, expected, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("seconds", [0.0, 0.02, 0.8])
def test_too_little_noise_is_refused(seconds: float) -> None:
    with pytest.raises(NoiseCalibrationFailed, match=r"at least 1\.0 s, better 5"):
        learn_noise([white(seconds)], SQUARE, STFT)


def test_a_second_is_enough() -> None:
    assert learn_noise([white(1.0)], SQUARE, STFT).seconds > 0.9


def test_silent_microphones_are_refused_and_named() -> None:
    audio = white(2)
    audio[2] = 0
    with pytest.raises(NoiseCalibrationFailed, match="microphone 2 is silent"):
        learn_noise([audio], SQUARE, STFT)
    with pytest.raises(NoiseCalibrationFailed, match="microphone 0, 1, 2, 3 is silent"):
        learn_noise([white(2, level=1e-6)], SQUARE, STFT)
    learn_noise([white(2, level=1e-4)], SQUARE, STFT)  # -80 dBFS is a quiet fan


def test_numbers_that_are_none_are_refused() -> None:
    audio = white(2)
    audio[1, 5000] = np.nan
    with pytest.raises(NoiseCalibrationFailed, match="NaN"):
        learn_noise([audio], SQUARE, STFT)


def test_a_profile_of_another_array_or_of_other_frames_is_refused() -> None:
    noise = learn_noise([white(2)], SQUARE, STFT)
    moved = MicrophoneArray("moved", SQUARE.positions + np.array([0.1, 0.0, 0.3]))
    assert Whitening.fitting(noise, moved, STFT).matrices.shape == (BINS, 4, 4)
    with pytest.raises(NoiseMismatch, match="the 4 microphones of respeaker-usb-4mic-v2"):
        Whitening.fitting(noise, preset("respeaker-4mic-hat"), STFT)
    with pytest.raises(NoiseMismatch, match="1024 samples every 256 at 16000 Hz"):
        Whitening.fitting(noise, SQUARE, Stft(16000, 1024, 256))

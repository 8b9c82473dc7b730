"""Mel levels and correlations against delays, tones and the library's transform."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.fft

from model_export.baselines.features import (
    framed_spectra,
    gcc_filter_bank,
    gcc_phat,
    log_mel,
    mel_filters,
    pairs,
)
from service.doa.types import FloatArray

N_FFT = 1024
LAGS = np.arange(-12.0, 13.0)
DELAYS = np.array([0, 4, -7])
"""Delays of three microphones in samples"""


def delayed_noise(batch: int = 2) -> FloatArray:
    """Noise (B, 3, T) at three microphones."""
    noise = np.random.default_rng(0).standard_normal((batch, 1, 8192)).astype(np.float32)
    return np.concatenate([np.roll(noise, delay, axis=-1) for delay in DELAYS], axis=1)


def test_correlations_peak_at_the_delay_of_every_pair_and_frame() -> None:
    spectra = framed_spectra(delayed_noise(), 512, 256, N_FFT)
    correlations = gcc_phat(spectra, LAGS)
    assert correlations.shape == (2, 3, 31, len(LAGS))
    first, second = pairs(3)
    expected = DELAYS[first] - DELAYS[second]
    peaks = LAGS[correlations.argmax(-1)]
    np.testing.assert_array_equal(peaks, np.broadcast_to(expected[None, :, None], peaks.shape))


def test_correlations_at_whole_lags_are_the_inverse_transform() -> None:
    spectra = framed_spectra(delayed_noise(1), 512, 256, N_FFT)[0]
    cross = spectra[0] * spectra[2].conj()
    whole = scipy.fft.irfft(cross / np.abs(cross), axis=-1)
    np.testing.assert_allclose(
        gcc_phat(spectra, LAGS)[1], whole[:, LAGS.astype(int)], rtol=0, atol=1e-5
    )


def test_correlations_peak_between_samples_where_the_delay_does() -> None:
    frequencies = np.arange(N_FFT // 2 + 1) / N_FFT
    spectra = np.stack([np.exp(-2j * np.pi * frequencies * 2.25), np.ones_like(frequencies)])
    lags = np.arange(-20, 21) / 4
    correlation = gcc_phat(spectra[:, None].astype(np.complex64), lags)[0, 0]
    assert lags[correlation.argmax()] == 2.25
    assert correlation.max() == pytest.approx(1, abs=1e-3)


def test_a_band_correlates_what_sounds_in_it() -> None:
    """Low frequencies are delayed by 3 samples, high ones by -5."""
    frequencies = np.arange(N_FFT // 2 + 1) / N_FFT
    delay = np.where(frequencies < 0.125, 3, -5)  # 2 kHz
    spectra = np.stack([np.exp(-2j * np.pi * frequencies * delay), np.ones_like(frequencies)])
    filters = mel_filters(10, N_FFT, 100.0)
    bands = gcc_filter_bank(np.repeat(spectra[:, None], 2, 1), filters, LAGS)[0]
    assert bands.shape == (10, len(LAGS))
    peaks = LAGS[bands.argmax(-1)]
    centres = filters.argmax(-1) / N_FFT
    np.testing.assert_array_equal(peaks[centres > 0.17], -5)
    np.testing.assert_array_equal(peaks[centres < 0.09], 3)
    np.testing.assert_allclose(bands.max(-1)[centres > 0.17], 1, atol=1e-5)


def test_bands_of_all_frequencies_are_the_correlation_of_all() -> None:
    spectra = framed_spectra(delayed_noise(), 512, 256, N_FFT)
    everything = np.ones((1, N_FFT // 2 + 1), np.float32)
    np.testing.assert_allclose(
        gcc_filter_bank(spectra, everything, LAGS)[..., 0, :],
        gcc_phat(spectra, LAGS).mean(-2),
        rtol=0,
        atol=1e-5,
    )


def test_mel_filters_cover_their_band_and_nothing_else() -> None:
    filters = mel_filters(40, 2048, 100.0, 8000.0)
    frequencies = np.arange(1025) * 16000 / 2048
    centres = frequencies[filters.argmax(-1)]
    assert (np.diff(centres) > 0).all()
    inside = (frequencies > centres[0]) & (frequencies < centres[-1])
    np.testing.assert_allclose(filters.sum(0)[inside], 1, atol=1e-5)
    assert (filters[:, frequencies <= 100] == 0).all()
    # Equal steps of mel: 1000 Hz is 1000 mel, 8000 Hz is 2840.
    below = np.searchsorted(centres, 1000.0) / 40
    assert below == pytest.approx((1000 - 150.5) / (2840 - 150.5), abs=0.03)


@pytest.mark.parametrize("frequency", [250.0, 1000.0, 3100.0, 6000.0])
def test_a_tone_is_loudest_in_its_band(frequency: float) -> None:
    tone = np.sin(2 * np.pi * frequency * np.arange(8192) / 16000).astype(np.float32)
    audio = np.stack([tone, 0.5 * tone])
    filters = mel_filters(64, 2048)
    levels = log_mel(framed_spectra(audio, 1600, 160, 2048), filters)
    nearest = filters[:, round(frequency * 2048 / 16000)].argmax()
    assert (abs(levels.argmax(-1) - nearest) <= 1).all()
    np.testing.assert_allclose((levels[0] - levels[1]).max(-1), np.log(4), atol=0.01)
    np.testing.assert_allclose(
        log_mel(framed_spectra(8 * audio, 1600, 160, 2048), filters), levels, rtol=0, atol=1e-3
    )


def test_silence_has_finite_features() -> None:
    spectra = framed_spectra(np.zeros((1, 2, 4096), np.float32), 512, 256, N_FFT)
    filters = mel_filters(10, N_FFT)
    for features in (
        log_mel(spectra, filters),
        gcc_phat(spectra, LAGS),
        gcc_filter_bank(spectra, filters, LAGS),
    ):
        assert np.isfinite(features).all()

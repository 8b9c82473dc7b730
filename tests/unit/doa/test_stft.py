"""The STFT against scipy's and against a sinusoid's known spectrum."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
from hypothesis import given
from hypothesis import strategies as st

from service.doa.stft import Stft, StreamingStft


def test_agrees_with_scipy() -> None:
    audio = np.random.default_rng(1).standard_normal((3, 4000)).astype(np.float32)
    stft = Stft()
    reference = scipy.signal.ShortTimeFFT(
        scipy.signal.get_window("hann", 512, fftbins=True), hop=256, fs=16000, phase_shift=None
    )
    # scipy centres frame p on sample p * hop; ours begins there.
    expected = reference.stft(audio, p0=1, p1=1 + stft.num_frames(4000))
    np.testing.assert_allclose(stft.transform(audio), expected, atol=2e-3)


def test_a_sinusoid_stands_in_its_bin() -> None:
    stft = Stft()
    time = np.arange(16640) / 16000
    spectra = stft.transform(np.cos(2 * np.pi * 1000.0 * time).astype(np.float32))
    assert spectra.shape == (257, 64)
    assert (np.abs(spectra).argmax(axis=0) == 32).all()
    assert stft.frequencies[32] == pytest.approx(1000.0)


def test_channels_are_transformed_one_by_one() -> None:
    audio = np.random.default_rng(2).standard_normal((2, 3, 2000)).astype(np.float32)
    stft = Stft()
    together = stft.transform(audio)
    for index in np.ndindex(2, 3):
        np.testing.assert_allclose(together[index], stft.transform(audio[index]), atol=1e-5)


@pytest.mark.parametrize("frames", [1, 2, 64])
def test_frames_and_samples_are_inverse(frames: int) -> None:
    stft = Stft()
    assert stft.num_frames(stft.num_samples(frames)) == frames
    assert stft.num_frames(stft.num_samples(frames) - 1) == frames - 1


@given(sizes=st.lists(st.integers(0, 1200), max_size=12))
def test_any_split_of_the_audio_gives_the_same_frames(sizes: list[int]) -> None:
    stft = Stft()
    audio = np.random.default_rng(1).standard_normal((2, sum(sizes))).astype(np.float32)
    streaming = StreamingStft(stft, 2)
    pieces = np.split(audio, np.cumsum(sizes)[:-1], axis=1) if sizes else []
    found = [streaming.push(piece) for piece in pieces]
    frames = np.concatenate(found, axis=-1) if found else np.zeros((2, 257, 0))
    assert frames.shape[-1] == stft.num_frames(audio.shape[1])
    if frames.shape[-1]:
        assert np.array_equal(frames, stft.transform(audio))

"""Short-time Fourier transform of multichannel audio.

Conventions
-----------
Frame l covers samples [l hop, l hop + n_fft) without centring or padding, so a frame never looks
into the future. Spectra are one-sided, F = n_fft/2 + 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.fft

from service.doa.types import ComplexArray, FloatArray


@dataclass(frozen=True, slots=True)
class Stft:
    """Framing, window and transform; the values are part of a model bundle's contract."""

    sample_rate: int = 16000
    """Hertz"""
    n_fft: int = 512
    """Samples per frame and transform length"""
    hop: int = 256
    """Samples between frames"""

    @property
    def num_bins(self) -> int:
        return self.n_fft // 2 + 1

    @property
    def frequencies(self) -> FloatArray:
        """(F,) bin centres in hertz."""
        return np.arange(self.num_bins) * (self.sample_rate / self.n_fft)

    def num_frames(self, num_samples: int) -> int:
        """Whole frames in ``num_samples`` samples."""
        return max(0, 1 + (num_samples - self.n_fft) // self.hop)

    def num_samples(self, num_frames: int) -> int:
        """Samples that ``num_frames`` frames cover."""
        return (num_frames - 1) * self.hop + self.n_fft

    def transform(self, audio: FloatArray) -> ComplexArray:
        """Transform audio into one spectrum per frame.

        Parameters
        ----------
        audio : (..., T) float32
            At least ``n_fft`` samples; a tail shorter than a hop is left out.

        Returns
        -------
        spectra : (..., F, L) complex64
            In memory frames come before bins.
        """
        step = audio.strides[-1]
        frames = np.lib.stride_tricks.as_strided(
            audio,
            (*audio.shape[:-1], self.num_frames(audio.shape[-1]), self.n_fft),
            (*audio.strides[:-1], self.hop * step, step),
            writeable=False,
        )
        windowed = (frames * hann(self.n_fft)).astype(np.float32, copy=False)
        # scipy's transform takes half of numpy's time.
        spectra = scipy.fft.rfft(windowed, axis=-1, overwrite_x=True)
        transposed: ComplexArray = np.swapaxes(spectra, -1, -2)
        return transposed


class StreamingStft:
    """The STFT of audio that comes in pieces: every frame is transformed once.

    Any split of the same audio gives the same frames.
    """

    def __init__(self, stft: Stft, num_channels: int) -> None:
        self._stft = stft
        self._rest = np.zeros((num_channels, 0), dtype=np.float32)

    def push(self, audio: FloatArray) -> ComplexArray:
        """Take audio (N, T) float32 of any length, give the frames (N, F, L) that it completes."""
        joined = np.concatenate([self._rest, audio], axis=1)
        frames = self._stft.num_frames(joined.shape[1])
        self._rest = joined[:, frames * self._stft.hop :]
        if frames == 0:
            return np.zeros((len(joined), self._stft.num_bins, 0), dtype=np.complex64)
        return self._stft.transform(joined)


@lru_cache(maxsize=8)
def hann(length: int) -> FloatArray:
    """Periodic Hann window, (length,) float32."""
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(length) / length)
    return window.astype(np.float32)

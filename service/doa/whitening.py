"""A robot's own noise as a covariance per frequency, and the whitening that removes it.

Conventions
-----------
Q(f) = E[x x^H] of the noise alone. W(f) is Hermitian and proportional to Q(f)^(-1/2), so that MUSIC
on W R W with steering vectors W a solves the generalised eigenvalue problem R e = lambda Q e, as
HARK's GEVD-MUSIC does (Nakamura et al., 2009): lambda is the same and e = W u.

Scale
-----
The generalised problem leaves W's scale per frequency free. Here the direction in which Q(f) is
weakest keeps a gain of 1 and every other is attenuated. W is the identity for spatially white noise
of any colour, and sound from elsewhere keeps its spectrum: the `weights` networks take levels
relative to the window's mean, and have not learnt spectra divided by a noise's.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np

from neuralmusic.errors import NoiseCalibrationFailed, NoiseMismatch
from service.doa.array import MicrophoneArray
from service.doa.silence import SILENCE
from service.doa.steering import direction_steering
from service.doa.stft import Stft
from service.doa.types import ComplexArray, FloatArray

LOADING = 1e-4
"""Diagonal loading against Q's mean eigenvalue. It attenuates a fan that all microphones hear alike
by at most 10 log10(N / 1e-4) dB, 46 for four microphones. With 26 or 36 dB, motors 30 dB above the
microphones' own noise still stand out; talkers are found equally well with all three."""
MIN_SECONDS = 1.0
FRAMES_PER_MICROPHONE = 8
"""Least frames per microphone; the eigenvalues of white noise then spread by a factor of 4"""


@dataclass(frozen=True, slots=True, eq=False)
class NoiseCovariance:
    """The noise that an array hears from the robot alone."""

    covariance: ComplexArray
    """(F, N, N) complex64, Hermitian, for all bins of the STFT"""
    array: MicrophoneArray
    stft: Stft
    seconds: float
    """Seconds of audio that it was learnt from"""


class NoiseEstimator:
    """Averages the covariance of noise over spectra added step by step."""

    def __init__(self, array: MicrophoneArray, stft: Stft) -> None:
        microphones = array.num_microphones
        self._array = array
        self._stft = stft
        self._sum = np.zeros((stft.num_bins, microphones, microphones), dtype=np.complex128)
        self._frames = 0

    def add(self, spectra: ComplexArray) -> None:
        """Add further frames, as spectra (N, F, L) of all bins."""
        by_bin = np.swapaxes(spectra, 0, 1)  # (F, N, L)
        self._sum += by_bin @ np.conj(np.swapaxes(by_bin, -1, -2))
        self._frames += spectra.shape[-1]

    @property
    def seconds(self) -> float:
        """Seconds of audio added so far."""
        return self._frames * self._stft.hop / self._stft.sample_rate

    def finish(self) -> NoiseCovariance:
        """The covariance of all added audio.

        Raises
        ------
        NoiseCalibrationFailed
            If there is too little audio, or silence in one or all of the channels.
        """
        microphones = self._array.num_microphones
        frames = FRAMES_PER_MICROPHONE * microphones
        needed = max(MIN_SECONDS, frames * self._stft.hop / self._stft.sample_rate)
        # The STFT loses up to a frame at the beginning.
        if self._frames == 0 or self.seconds + self._stft.n_fft / self._stft.sample_rate < needed:
            raise NoiseCalibrationFailed(
                f"{self.seconds:.1f} s of noise are too few to learn it: record at least "
                f"{needed:.1f} s, better 5, of the robot's own noise alone"
            )
        covariance = self._sum / self._frames
        power = np.einsum("fnn->n", covariance).real
        # Parseval: a Hann window has a mean square of 3/8, and one side holds half the power.
        mean_square = 2 * power / (self._stft.n_fft**2 * 3 / 8)
        if not np.isfinite(mean_square).all():
            raise NoiseCalibrationFailed("the noise holds samples that are NaN or infinite")
        silent = [str(index) for index in np.flatnonzero(mean_square < SILENCE)]
        if silent:
            raise NoiseCalibrationFailed(
                f"microphone {', '.join(silent)} is silent: switch the robot's fans and motors on, "
                "and check that the right channels were recorded"
            )
        return NoiseCovariance(
            covariance.astype(np.complex64), self._array, self._stft, self.seconds
        )


def learn_noise(
    blocks: Iterable[FloatArray], array: MicrophoneArray, stft: Stft
) -> NoiseCovariance:
    """The covariance of the noise in blocks of audio (N, T), each of any length.

    Raises
    ------
    NoiseCalibrationFailed
        If there is too little audio, or silence in one or all of the channels.
    """
    estimator = NoiseEstimator(array, stft)
    for block in blocks:
        if block.shape[-1] >= stft.n_fft:
            estimator.add(stft.transform(block))
    return estimator.finish()


class Whitening:
    """Hermitian matrices W(f) that make a noise spatially white.

    Parameters
    ----------
    matrices : (F, N, N) complex64
    """

    def __init__(self, matrices: ComplexArray) -> None:
        self.matrices = matrices

    @classmethod
    def of(cls, noise: NoiseCovariance, *, loading: float = LOADING) -> Self:
        """W(f) = sqrt(q) Q(f)^(-1/2) of the loaded Q with its least eigenvalue q."""
        covariance = noise.covariance.astype(np.complex128)
        microphones = covariance.shape[-1]
        mean = np.einsum("fnn->f", covariance).real / microphones
        # Bins without any noise, such as above the edge of a low-pass filter, stay as they are.
        loaded = np.maximum(loading * mean, np.finfo(np.float32).tiny)
        values, vectors = np.linalg.eigh(covariance)
        # Rounding leaves small negative ones, relative to the largest bin's.
        values = np.maximum(values, 0) + loaded[:, None]
        gain = np.sqrt(values[:, :1] / values)  # (F, N), at most 1
        matrices = (vectors * gain[:, None, :]) @ np.conj(np.swapaxes(vectors, -1, -2))
        return cls(matrices.astype(np.complex64))

    @classmethod
    def fitting(cls, noise: NoiseCovariance, array: MicrophoneArray, stft: Stft) -> Self:
        """Whitening for audio of ``array`` in spectra of ``stft``.

        Raises
        ------
        NoiseMismatch
            If the noise was learnt with another array or other frames.
        """
        if not noise.array.matches(array):
            raise NoiseMismatch(
                f"the noise profile was learnt with the {noise.array.num_microphones} microphones "
                f"of {noise.array.name}, not with {array.name}: learn the noise with the array "
                "that you localize with"
            )
        if noise.stft != stft:
            raise NoiseMismatch(
                f"the noise profile holds frames of {_frames(noise.stft)}, but {_frames(stft)} are "
                "needed: learn the noise again with this version and model"
            )
        return cls.of(noise)

    def band(self, bins: slice) -> Whitening:
        """The whitening for some of the bins."""
        return Whitening(self.matrices[bins])

    def apply(self, spectra: ComplexArray) -> ComplexArray:
        """W x of spectra (..., N, F, L), the same shape, complex64."""
        by_bin = np.swapaxes(spectra, -3, -2)  # (..., F, N, L)
        whitened: ComplexArray = np.swapaxes(self.matrices @ by_bin, -3, -2)
        return whitened

    def steering(self, steering: ComplexArray) -> ComplexArray:
        """W a of steering vectors (F, N, A), scaled to ||a||^2 = N again.

        The scale keeps the denominator of MUSIC, a^H a - ||U^H a||^2, comparable between azimuths.
        Weighing azimuths by their gain under W loses talkers: with its square root, 79 % of the
        talkers beside a motor are found within 10 degrees instead of 100 %.
        """
        whitened = self.matrices @ steering
        norm = np.linalg.norm(whitened, axis=-2, keepdims=True)
        scaled: ComplexArray = whitened * (np.sqrt(np.float32(steering.shape[-2])) / norm)
        return scaled


def whitened_steering(
    whitening: Whitening | None,
    positions: FloatArray,
    frequencies: FloatArray,
    directions: FloatArray,
) -> ComplexArray:
    """Steering vectors (F, N, P) of directions (P, 3), whitened where there is a whitening."""
    steering = direction_steering(positions, frequencies, directions)
    return steering if whitening is None else whitening.steering(steering)


def _frames(stft: Stft) -> str:
    return f"{stft.n_fft} samples every {stft.hop} at {stft.sample_rate} Hz"

"""A noise profile as a file: ``NoiseCovariance`` in an npz without pickle.

Members: ``format`` (the version, 1), ``name`` (the array's), ``positions`` (N, 3) float64 in
metres, ``sample_rate`` in hertz, ``n_fft`` and ``hop`` in samples, ``seconds`` of audio that it was
learnt from, ``covariance`` (F, N, N) complex64. Members are stored uncompressed, and every header
is compared with the size of its member, so that no more is allocated than the file holds.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from neuralmusic.errors import InvalidGeometry, NoiseProfileInvalid
from neuralmusic.protocol.client_messages import MAX_SAMPLE_RATE, MIN_SAMPLE_RATE
from neuralmusic.protocol.names import MAX_LABEL, is_label
from service.doa.array import MAX_MICROPHONES, MicrophoneArray
from service.doa.stft import Stft
from service.doa.whitening import NoiseCovariance
from service.inference.manifest import MAX_FFT
from service.inference.npz import read_npz

FORMAT = 1
MAX_BYTES = 8 * (MAX_FFT // 2 + 1) * MAX_MICROPHONES**2 + 2**16
"""Most bytes of a file: covariances of the longest frames and the most microphones, and room for
the rest; profiles of four microphones have 34 kB"""
MAX_SECONDS = 1e6
"""Most seconds that a profile may claim; a week has fewer"""
HERMITIAN = 1e-4
"""Largest asymmetry against the largest value; float32 leaves less"""
MEMBERS = {
    "format": (np.dtype(np.int64), 0),
    "name": (np.dtype(f"<U{MAX_LABEL}"), 0),
    "positions": (np.dtype(np.float64), 2),
    "sample_rate": (np.dtype(np.int64), 0),
    "n_fft": (np.dtype(np.int64), 0),
    "hop": (np.dtype(np.int64), 0),
    "seconds": (np.dtype(np.float64), 0),
    "covariance": (np.dtype(np.complex64), 3),
}
"""Type and number of axes of every member"""
WHAT = "is not a noise profile of this version: write one with neuralmusic noise"


def save_noise(noise: NoiseCovariance, file: Path | BinaryIO) -> None:
    """Write a profile; the same profile gives the same bytes."""
    name = noise.array.name[:MAX_LABEL]
    stft = noise.stft
    values = (FORMAT, name, noise.array.positions, stft.sample_rate, stft.n_fft, stft.hop)
    fields = dict(zip(MEMBERS, (*values, noise.seconds, noise.covariance), strict=True))
    arrays: dict[str, Any] = {
        key: np.asarray(value, dtype=MEMBERS[key][0]) for key, value in fields.items()
    }
    np.savez(file, **arrays)


def noise_bytes(noise: NoiseCovariance) -> bytes:
    """A profile's file in memory."""
    file = io.BytesIO()
    save_noise(noise, file)
    return file.getvalue()


def load_noise(file: Path | BinaryIO) -> NoiseCovariance:
    """Read a profile.

    Raises
    ------
    NoiseProfileInvalid
        If the file is too large, not a profile of this version, or holds impossible values.
    OSError
        If a path cannot be read.
    """
    if isinstance(file, Path):
        with file.open("rb") as opened:
            return load_noise(opened)
    content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise NoiseProfileInvalid(f"the file is larger than {MAX_BYTES} bytes: it {WHAT}")
    try:
        fields = read_npz(content, MEMBERS, most_bytes=MAX_BYTES)
    except ValueError as error:
        raise NoiseProfileInvalid(f"the file {WHAT}") from error
    if any((a.dtype, a.ndim) != MEMBERS[name] for name, a in fields.items()):
        raise NoiseProfileInvalid(f"the file {WHAT}")
    return _profile(fields)


def _profile(fields: Mapping[str, Any]) -> NoiseCovariance:
    """The profile that the members hold, or NoiseProfileInvalid."""
    if (version := int(fields["format"])) != FORMAT:
        raise NoiseProfileInvalid(
            f"the profile has format {version}, this version reads {FORMAT}: learn the noise again"
        )
    stft = Stft(*(int(fields[key]) for key in ("sample_rate", "n_fft", "hop")))
    if not (
        16 <= stft.n_fft <= MAX_FFT
        and 0 < stft.hop <= stft.n_fft
        and MIN_SAMPLE_RATE <= stft.sample_rate <= MAX_SAMPLE_RATE
    ):
        raise NoiseProfileInvalid(f"the profile has impossible frames: {stft}")
    name = str(fields["name"])
    if not is_label(name):
        raise NoiseProfileInvalid("the profile's array has no name that can be shown")
    try:
        array = MicrophoneArray(name, fields["positions"], "a noise profile")
    except InvalidGeometry as error:
        raise NoiseProfileInvalid(f"in the profile's array {error.detail}") from error
    covariance = fields["covariance"]
    if covariance.shape != (stft.num_bins, array.num_microphones, array.num_microphones):
        raise NoiseProfileInvalid(
            f"the profile's covariances are {covariance.shape}, but {array.num_microphones} "
            f"microphones and frames of {stft.n_fft} samples need "
            f"{(stft.num_bins, array.num_microphones, array.num_microphones)}"
        )
    seconds = float(fields["seconds"])
    if not (stft.hop / stft.sample_rate <= seconds <= MAX_SECONDS and _is_covariance(covariance)):
        raise NoiseProfileInvalid("the profile holds no valid covariances: learn the noise again")
    return NoiseCovariance(covariance, array, stft, seconds)


def _is_covariance(matrices: Any) -> bool:
    """Whether matrices are finite, Hermitian up to rounding and not negative on the diagonal."""
    if not np.isfinite(matrices).all():
        return False
    matrices = matrices.astype(np.complex128)  # the largest float32's square is none
    skew = np.abs(matrices - np.conj(np.swapaxes(matrices, -1, -2))).max()
    least = np.linalg.eigvalsh(matrices).min()
    scale = np.abs(matrices).max()
    return bool(scale > 0 and skew <= HERMITIAN * scale and least >= -HERMITIAN * scale)

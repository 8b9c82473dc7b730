"""A noise profile as a file: ``NoiseCovariance`` in an npz without pickle.

Members: ``format`` (the version, 1), ``name`` (the array's), ``positions`` (N, 3) float64 in
metres, ``sample_rate`` in hertz, ``n_fft`` and ``hop`` in samples, ``seconds`` of audio that it was
learnt from, ``covariance`` (F, N, N) complex64. Members are stored uncompressed, and every header
is compared with the size of its member, so that no more is allocated than the file holds.
"""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Mapping
from math import prod
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy

from neuralmusic.errors import InvalidGeometry, NoiseProfileInvalid
from service.doa.array import MAX_MICROPHONES, MicrophoneArray
from service.doa.stft import Stft
from service.doa.whitening import NoiseCovariance
from service.inference.geometry import MAX_NAME

FORMAT = 1
MAX_FFT = 4096
MAX_BYTES = 8 * (MAX_FFT // 2 + 1) * MAX_MICROPHONES**2 + 2**16
"""Most bytes of a file: covariances of the longest frames and the most microphones, and room for
the rest; profiles of four microphones have 34 kB"""
HERMITIAN = 1e-4
"""Largest asymmetry against the largest value; float32 leaves less"""
MEMBERS = {
    "format": (np.dtype(np.int64), 0),
    "name": (np.dtype(f"<U{MAX_NAME}"), 0),
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
    name = noise.array.name[:MAX_NAME]
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
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            fields = {name: _member(archive, name) for name in MEMBERS}
    # An encrypted member raises RuntimeError.
    except (zipfile.BadZipFile, zlib.error, KeyError, ValueError, EOFError, RuntimeError) as error:
        raise NoiseProfileInvalid(f"the file {WHAT}") from error
    return _profile(fields)


def _member(archive: zipfile.ZipFile, name: str) -> Any:
    """One array; raises ValueError unless it is exactly as large as its header says."""
    dtype, axes = MEMBERS[name]
    entry = archive.getinfo(f"{name}.npy")
    if entry.compress_type != zipfile.ZIP_STORED or entry.file_size > MAX_BYTES:
        raise ValueError(f"{name} is compressed or too large")
    data = io.BytesIO(archive.read(entry))
    if npy.read_magic(data) != (1, 0):
        raise ValueError(f"{name} has another header")
    shape, fortran, found = npy.read_array_header_1_0(data)
    rest = data.read()
    if found != dtype or len(shape) != axes or fortran:
        raise ValueError(f"{name} has another type")
    if len(rest) != prod(shape) * dtype.itemsize:
        raise ValueError(f"{name} has another size")
    return np.frombuffer(rest, dtype).reshape(shape)


def _profile(fields: Mapping[str, Any]) -> NoiseCovariance:
    """The profile that the members hold, or NoiseProfileInvalid."""
    if (version := int(fields["format"])) != FORMAT:
        raise NoiseProfileInvalid(
            f"the profile has format {version}, this version reads {FORMAT}: learn the noise again"
        )
    stft = Stft(*(int(fields[key]) for key in ("sample_rate", "n_fft", "hop")))
    if not (16 <= stft.n_fft <= MAX_FFT and 0 < stft.hop <= stft.n_fft and stft.sample_rate > 0):
        raise NoiseProfileInvalid(f"the profile has impossible frames: {stft}")
    try:
        array = MicrophoneArray(str(fields["name"]), fields["positions"], "a noise profile")
    except InvalidGeometry as error:
        raise NoiseProfileInvalid(f"the profile's {error.detail}") from error
    covariance = fields["covariance"]
    if covariance.shape != (stft.num_bins, array.num_microphones, array.num_microphones):
        raise NoiseProfileInvalid(
            f"the profile's covariances are {covariance.shape}, but {array.num_microphones} "
            f"microphones and frames of {stft.n_fft} samples need "
            f"{(stft.num_bins, array.num_microphones, array.num_microphones)}"
        )
    seconds = float(fields["seconds"])
    if not (np.isfinite(seconds) and seconds > 0 and _is_covariance(covariance)):
        raise NoiseProfileInvalid("the profile holds no valid covariances: learn the noise again")
    return NoiseCovariance(covariance, array, stft, seconds)


def _is_covariance(matrices: Any) -> bool:
    """Whether matrices are finite, Hermitian up to rounding and not negative on the diagonal."""
    if not np.isfinite(matrices).all():
        return False
    skew = np.abs(matrices - np.conj(np.swapaxes(matrices, -1, -2))).max()
    least = np.linalg.eigvalsh(matrices.astype(np.complex128)).min()
    scale = np.abs(matrices).max()
    return bool(scale > 0 and skew <= HERMITIAN * scale and least >= -HERMITIAN * scale)

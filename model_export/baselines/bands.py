"""Narrow bands of a window: snapshots, sample covariances and ideal covariances.

The subspace methods of the comparison were published for one narrow band. Here a selection of STFT
bins are the bands and frames their snapshots, scaled to unit mean power over microphones and frames
so that all bands count alike.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from model_export.baselines.network import Truth
from model_export.training.networks import NUM_FRAMES
from model_export.training.task import STFT, steering_delays
from service.doa.array import MicrophoneArray
from service.doa.features import LEVEL_FLOOR, LEVEL_SCALE
from service.doa.types import FloatArray

CITED_BANDS = 10
"""Number of bands as cited, that of DA-MUSIC's broadband variants"""
MATCHED_BANDS = 32
LOWEST, HIGHEST = 300.0, 3500.0
"""Hertz; the band of speech below the spatial aliasing of a 46 mm square"""


def band_bins(count: int) -> tuple[int, ...]:
    """``count`` STFT bins, evenly spaced from ``LOWEST`` to ``HIGHEST``."""
    wanted = np.linspace(LOWEST, HIGHEST, count) * STFT.n_fft / STFT.sample_rate
    return tuple(int(index) for index in wanted.round())


def band_snapshots(audio: FloatArray, bins: Sequence[int]) -> Tensor:
    """Snapshots (B, N, K, 64) complex of windows (B, N, T) in K bins."""
    spectra = STFT.transform(audio)[..., :NUM_FRAMES][:, :, list(bins)]
    return _unit_power(torch.from_numpy(np.ascontiguousarray(spectra)))


def matched_snapshots(features: Tensor, bins: Sequence[int]) -> Tensor:
    """Snapshots (B, N, K, 64) complex from the matched track's features (B, 2N, 257, 64).

    They equal those of ``band_snapshots``, except that microphone 0 has phase zero. Channels 0 to
    N - 1 of the features are real parts of unit vectors, channel N is the level, the others are
    imaginary parts.
    """
    cells = features[:, :, list(bins)].float()
    microphones = cells.shape[1] // 2
    level = cells[:, microphones : microphones + 1]
    power = (torch.exp(level / LEVEL_SCALE) - LEVEL_FLOOR).clamp(min=0)
    imaginary = F.pad(cells[:, microphones + 1 :], (0, 0, 0, 0, 1, 0))
    return _unit_power(power.sqrt() * torch.complex(cells[:, :microphones], imaginary))


def lagged_covariances(snapshots: Tensor, lags: int) -> Tensor:
    """E[x(t) x(t + lag)^H] for lags from 0: (B, K, lags, N, N) from snapshots (B, N, K, L).

    Lag 0 is the sample covariance; its trace is N.
    """
    by_band = snapshots.transpose(1, 2)  # (B, K, N, L)
    frames = by_band.shape[-1]
    products = [
        by_band[..., : frames - lag] @ by_band[..., lag:].mH / (frames - lag) for lag in range(lags)
    ]
    return torch.stack(products, 2)


def ideal_covariance(array: MicrophoneArray, truth: Truth, frequencies: FloatArray) -> Tensor:
    """Covariances (B, K, N, N) complex of noiseless sources of equal power, with a trace of N.

    They are zero where there is no source.
    """
    azimuth = truth.azimuth.double().cpu().numpy()
    delays = np.stack([steering_delays(array.positions, row) for row in azimuth])
    phase = 2 * np.pi * frequencies[:, None, None] * delays[:, None]  # (B, K, N, M)
    steering = torch.from_numpy(np.exp(1j * phase).astype(np.complex64)).to(truth.mask.device)
    share = truth.mask / truth.count.clamp(min=1)[:, None]  # (B, M)
    return (steering * share[:, None, None]) @ steering.mH


def planes(matrix: Tensor) -> Tensor:
    """Real and imaginary part (..., 2, N, N) of complex (..., N, N)."""
    return torch.stack([matrix.real, matrix.imag], -3)


def hermitian_planes(parts: Tensor) -> Tensor:
    """(R + R^H) / 2 of (..., 2, N, N); its eigenvalues may be negative."""
    real, imaginary = parts.unbind(-3)
    return 0.5 * torch.stack([real + real.mT, imaginary - imaginary.mT], -3)


def gram_planes(parts: Tensor, loading: float) -> Tensor:
    """K K^H + loading I from K (..., 2, N, N): Hermitian, no eigenvalue below ``loading``."""
    real, imaginary = parts.unbind(-3)
    identity = loading * torch.eye(real.shape[-1], device=real.device)
    return torch.stack(
        [
            real @ real.mT + imaginary @ imaginary.mT + identity,
            imaginary @ real.mT - real @ imaginary.mT,
        ],
        -3,
    )


def _unit_power(snapshots: Tensor) -> Tensor:
    """Scale snapshots (B, N, K, L) to a mean |x|^2 of 1 in every band."""
    power = (snapshots.real.square() + snapshots.imag.square()).mean((1, 3), keepdim=True)
    return snapshots / power.clamp(min=1e-20).sqrt()

"""Classical broadband localization: MUSIC, NormMUSIC, SRP-PHAT and GCC-PHAT.

Conventions
-----------
Covariances and spectra are those of a band of F bins; every method gives one spectrum (A,) per
window, larger where a source is more likely.

Methods
-------
music : mean over bins of the MUSIC pseudo-spectrum.
norm_music : the same with every bin divided by its maximum (Salvati, Drioli, Foresti, 2014).
srp_phat : steered response power of phase-transformed spectra (DiBiase, 2000).
gcc_phat : the same of phase-transformed covariances, the correlations of all pairs of microphones
    at every azimuth's delays (Knapp, Carter, 1976).
"""

from __future__ import annotations

import numpy as np

from service.doa.evd import signal_subspace
from service.doa.fusion import mean_fusion, normalised_fusion
from service.doa.music import music_spectrum, spectrum_of_power
from service.doa.pair_products import PairProducts
from service.doa.projector import signal_projector
from service.doa.types import ComplexArray, FloatArray


def music(
    covariance: ComplexArray,
    steering: ComplexArray,
    num_sources: int,
    products: PairProducts | None = None,
) -> FloatArray:
    """Broadband MUSIC, the arithmetic mean over bins.

    Parameters
    ----------
    covariance : (..., F, N, N) complex64
    steering : (F, N, A) complex64
    num_sources : int
    products : PairProducts, optional
        Products of the steering vectors; with covariances (F, N, N) they cut the time to a third.

    Returns
    -------
    spectrum : (..., A) float32

    References
    ----------
    Schmidt, 1986.
    """
    return mean_fusion(music_of_bins(covariance, steering, num_sources, products))


def norm_music(
    covariance: ComplexArray,
    steering: ComplexArray,
    num_sources: int,
    products: PairProducts | None = None,
) -> FloatArray:
    """Broadband MUSIC with every bin's spectrum divided by its maximum; parameters as ``music``.

    References
    ----------
    Salvati, Drioli, Foresti, 2014, Incoherent frequency fusion for broadband steered response
    power algorithms in noisy environments.
    """
    return normalised_fusion(music_of_bins(covariance, steering, num_sources, products))


def music_of_bins(
    covariance: ComplexArray,
    steering: ComplexArray,
    num_sources: int,
    products: PairProducts | None,
) -> FloatArray:
    """The MUSIC pseudo-spectrum of every bin (..., F, A); parameters as ``music``."""
    if products is None:
        return music_spectrum(signal_subspace(covariance, num_sources), steering)
    projector = signal_projector(covariance, num_sources)
    return spectrum_of_power(products.projector_power(projector, num_sources))


def srp_phat(
    cross: ComplexArray, steering: ComplexArray, products: PairProducts | None = None
) -> FloatArray:
    """Steered response power with the phase transform.

    The mean over bins, frames and microphone pairs of Re(conj(a_i) a_j x_i conj(x_j)) with unit
    magnitudes: 1 where all pairs agree with one plane wave.

    Parameters
    ----------
    cross : (..., F, N, N) complex64
        ``sample_covariance`` of ``phase_transform``.
    steering : (F, N, A) complex64
    products : PairProducts, optional
        Products of the steering vectors; with cross-spectra (F, N, N) they cut the time to a tenth.

    Returns
    -------
    spectrum : (..., A) float32

    References
    ----------
    DiBiase, 2000, A high-accuracy, low-latency technique for talker localization, eq. (5.2).
    """
    microphones = cross.shape[-1]
    if products is not None:
        response = microphones * products.power(0.0, products.entries(cross))[:, 0]  # (F, A)
    else:
        response = np.sum(np.conj(steering) * (cross @ steering), axis=-2).real  # (..., F, A)
        response -= np.trace(cross, axis1=-2, axis2=-1).real[..., None]
    pairs: FloatArray = mean_fusion(response) / (microphones * (microphones - 1))
    return pairs.astype(np.float32)


def gcc_phat(
    covariance: ComplexArray, steering: ComplexArray, products: PairProducts | None = None
) -> FloatArray:
    """Generalized cross-correlations with the phase transform, a mean over microphone pairs.

    A pair's cross-spectrum is averaged over frames and divided by its magnitude; its inverse
    transform at an azimuth's delay is the pair's vote. Unlike in ``srp_phat`` frames count by their
    power, and a pause between words adds no noise to the phase.

    Parameters
    ----------
    covariance : (..., F, N, N) complex64
    steering : (F, N, A) complex64
    products : PairProducts, optional
        As in ``srp_phat``.

    Returns
    -------
    spectrum : (..., A) float32
        1 where all pairs agree with one plane wave.

    References
    ----------
    Knapp, Carter, 1976, The generalized correlation method for estimation of time delay, table I.
    """
    return srp_phat(phase_transform(covariance), steering, products)


def phase_transform(spectra: ComplexArray) -> ComplexArray:
    """Spectra or cross-spectra of any shape with unit magnitudes, zero where there is nothing."""
    transformed: ComplexArray = spectra / np.maximum(np.abs(spectra), np.finfo(np.float32).tiny)
    return transformed

"""Plane waves on microphones in the surface of a rigid sphere, which scatters them."""

from __future__ import annotations

import numpy as np
import scipy.special

from service.doa.array import SPEED_OF_SOUND
from service.doa.types import ComplexArray, FloatArray


def rigid_sphere_response(
    positions: FloatArray, frequencies: FloatArray, direction: FloatArray
) -> ComplexArray:
    """Response (N, F) of microphones (N, 3) on one sphere to a plane wave from a unit vector (3,).

    Relative to the free field at the sphere's centre: 1 where the sphere is small, 2 in front of a
    large one.

    Parameters
    ----------
    positions : (N, 3) float
        Metres from the sphere's centre.
    frequencies : (F,) float
        Hertz, not 0.
    direction : (3,) float

    References
    ----------
    Rafaely, 2015, Fundamentals of Spherical Array Processing, eq. (2.62); with exp(+j w t), as
    everywhere here, the outgoing waves are Hankel functions of the second kind.
    """
    radius = float(np.linalg.norm(positions, axis=1).mean())
    ka = 2 * np.pi * frequencies * radius / SPEED_OF_SOUND
    cosine = positions @ direction / radius
    response = np.zeros((len(positions), len(frequencies)), dtype=complex)
    for order in range(int(np.ceil(ka.max())) + 12):
        slope = scipy.special.spherical_jn(order, ka, derivative=True)
        slope = slope - 1j * scipy.special.spherical_yn(order, ka, derivative=True)
        radial = (2 * order + 1) * 1j**order * -1j / (ka**2 * slope)
        response += scipy.special.eval_legendre(order, cosine)[:, None] * radial
    return response

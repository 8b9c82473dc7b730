"""Microphone arrays: positions in the array frame, validated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from neuralmusic.errors import InvalidChannelMap, InvalidGeometry
from service.doa.types import FloatArray

MIN_MICROPHONES = 2
MAX_MICROPHONES = 64
MIN_APERTURE = 0.01  # m; below it the delays vanish in the noise
MAX_APERTURE = 2.0
"""Metres. Sound takes 6 ms across, a fifth of the 32 ms frames in which delays are phases; farther
apart the microphones no longer hear the same piece of it. Within a room's distance of so large an
array a talker has no single direction either"""
MAX_DISTANCE = 100.0  # m, from the frame's origin; far away the differences lose their digits
ROUNDING = 1e-6  # m; a ring of 5 mm radius computed from angles may miss 1 cm by a bit
MIN_SPACING = 1e-4  # m; two microphones cannot stand at one point
MIRROR_SPREAD = 2.5e-3
"""Root mean square distance in metres from a line or plane from which microphones tell a direction
from its mirror image. Below it 1 mm of error in the positions turns as much phase as the image
does: of 92 simulated talkers before and behind arrays of less than 2 mm, known to 1 mm, one in four
was found on the wrong side, and of 86 with 2.5 mm and more none"""
SPEED_OF_SOUND = 343.0  # m/s at 20 degrees Celsius


def speed_of_sound(temperature_c: float) -> float:
    """Speed of sound in air in m/s at a temperature in degrees Celsius (Cramer's linear fit)."""
    return 331.3 + 0.606 * temperature_c


@dataclass(frozen=True, slots=True, eq=False)
class MicrophoneArray:
    """The positions of N microphones; channel n of the mapped audio is microphone n.

    Parameters
    ----------
    name : str
        A preset's name, or ``"custom"``.
    positions : (N, 3) float64
        Metres in the array frame (x forward, y left, z up).
    source : str
        Source of the positions.

    Raises
    ------
    InvalidGeometry
        If the positions are not 2 to 64 distinct finite points with an aperture between 1 cm
        and 2 m, or less than 1 cm of it is horizontal.
    """

    name: str
    positions: FloatArray
    source: str = ""
    linear: bool = field(init=False)
    """True where all microphones lie within ``MIRROR_SPREAD`` of one line seen from above, as in a
    vertical plane: the two sides cannot be told apart"""

    def __post_init__(self) -> None:
        positions = np.array(self.positions, dtype=np.float64)
        validate_positions(positions)
        positions.setflags(write=False)
        object.__setattr__(self, "positions", positions)
        spread = np.linalg.svd(self._from_above, compute_uv=False) / np.sqrt(len(positions))
        object.__setattr__(self, "linear", bool(spread[1] < MIRROR_SPREAD))

    @property
    def _from_above(self) -> FloatArray:
        """(N, 2) x and y about their mean."""
        horizontal: FloatArray = self.positions[:, :2] - self.positions[:, :2].mean(axis=0)
        return horizontal

    @property
    def axis(self) -> FloatArray:
        """(2,) unit vector in x and y along which the microphones spread most."""
        axis: FloatArray = np.linalg.svd(self._from_above)[2][0]
        return axis

    @property
    def steered(self) -> FloatArray:
        """(N, 3) positions for steering vectors: those of a linear array moved onto its line.

        What is left beside the line would tell sides by position errors.
        """
        if not self.linear:
            return self.positions
        line = self.positions.copy()
        line[:, :2] += np.outer(self._from_above @ self.axis, self.axis) - self._from_above
        return line

    @property
    def num_microphones(self) -> int:
        return int(self.positions.shape[0])

    @property
    def aperture(self) -> float:
        """Largest distance between two microphones in metres."""
        return float(pairwise_distances(self.positions).max())

    def matches(self, other: MicrophoneArray, tolerance: float = 1e-3) -> bool:
        """Whether both arrays have the same microphones in the same order, up to a translation."""
        if self.num_microphones != other.num_microphones:
            return False
        own = self.positions - self.positions.mean(axis=0)
        others = other.positions - other.positions.mean(axis=0)
        return bool(np.abs(own - others).max() <= tolerance)

    def rotated(self, azimuth: float) -> MicrophoneArray:
        """The array turned counter-clockwise about z by ``azimuth`` radians."""
        cos, sin = np.cos(azimuth), np.sin(azimuth)
        rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return MicrophoneArray(self.name, self.positions @ rotation.T, self.source)


def pairwise_distances(positions: FloatArray) -> FloatArray:
    """Distances between all microphones.

    Parameters
    ----------
    positions : (N, D) float

    Returns
    -------
    distances : (N, N) float
    """
    distances: FloatArray = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    return distances


def validate_positions(positions: FloatArray) -> None:
    """Raise InvalidGeometry unless ``positions`` (N, 3) can be one small array in metres."""
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise InvalidGeometry(
            f"microphone positions must be a list of [x, y, z] in metres, "
            f"but their shape is {positions.shape}"
        )
    count = positions.shape[0]
    if not MIN_MICROPHONES <= count <= MAX_MICROPHONES:
        raise InvalidGeometry(
            f"an array has {MIN_MICROPHONES} to {MAX_MICROPHONES} microphones, but {count} "
            f"position{'s were' if count != 1 else ' was'} given"
        )
    if not np.isfinite(positions).all():
        raise InvalidGeometry("microphone positions must be finite numbers")
    with np.errstate(over="ignore"):
        distances = pairwise_distances(positions)
    aperture = distances.max()
    if aperture > MAX_APERTURE + ROUNDING:
        raise InvalidGeometry(
            f"the outermost microphones are {aperture:g} m apart (at most {MAX_APERTURE:g} m): "
            f"{_unit_hint(aperture)}"
        )
    farthest = np.abs(positions).max()
    if farthest > MAX_DISTANCE:
        raise InvalidGeometry(
            f"a microphone is {farthest:g} m from the origin (at most {MAX_DISTANCE:g} m): give "
            "positions about the array's own middle"
        )
    if 0 < aperture < MIN_APERTURE - ROUNDING:
        raise InvalidGeometry(
            f"the outermost microphones are {aperture * 1000:g} mm apart "
            f"(at least {MIN_APERTURE * 1000:g} mm): {_unit_hint(aperture)}"
        )
    horizontal = pairwise_distances(positions[:, :2]).max()
    if aperture > 0 and horizontal < MIN_APERTURE - ROUNDING:
        raise InvalidGeometry(
            f"seen from above all microphones are within {horizontal * 1000:g} mm (at least "
            f"{MIN_APERTURE * 1000:g} mm): no azimuth can be heard with microphones above each "
            "other; z is up, so check the order of the coordinates"
        )
    first, second = np.unravel_index(
        np.argmin(distances + np.where(np.eye(count, dtype=bool), np.inf, 0.0)), distances.shape
    )
    if distances[first, second] < MIN_SPACING:
        raise InvalidGeometry(
            f"microphones {min(first, second)} and {max(first, second)} stand at the same point: "
            f"give every microphone its own position"
        )


def validate_channel_map(channel_map: Sequence[int], num_microphones: int) -> tuple[int, ...]:
    """Check that the map names one distinct recording channel, from 0, for every microphone."""
    channels = tuple(int(channel) for channel in channel_map)
    if len(channels) != num_microphones:
        raise InvalidChannelMap(
            f"channel_map names {len(channels)} channels, but the array has "
            f"{num_microphones} microphones: name one recording channel per microphone"
        )
    if len(set(channels)) != len(channels):
        raise InvalidChannelMap(f"channel_map {list(channels)} names a channel twice")
    if min(channels) < 0:
        raise InvalidChannelMap(
            f"channel_map {list(channels)} has a negative entry: channels count from 0"
        )
    return channels


def _unit_hint(aperture: float) -> str:
    if MIN_APERTURE <= aperture / 1000 <= MAX_APERTURE and aperture > 20:
        return "positions are in metres; these look like millimetres, divide them by 1000"
    if aperture > MAX_APERTURE and aperture / 100 <= MAX_APERTURE:
        return (
            f"sound takes {1000 * aperture / SPEED_OF_SOUND:.0f} ms across them, too long for "
            "phases of 32 ms frames, and a talker among them is in no single direction; use one "
            "array of up to 2 m at a time, or divide by 100 if these are centimetres"
        )
    if MIN_APERTURE <= aperture * 1000 <= MAX_APERTURE:
        return "positions are in metres; these look like kilometres, multiply them by 1000"
    return "positions are in metres; check their unit"

"""Estimates as messages: the protocol's own result, or ODAS' objects."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from neuralmusic.protocol.degrees import azimuth_deg, degrees, elevation_deg, unit_vector
from neuralmusic.protocol.server_messages import (
    ODAS_HOP_S,
    OdasPotential,
    OdasSource,
    PoseInUse,
    StreamSource,
)
from service.doa.orientation import Orientation
from service.doa.peaks import find_peaks
from service.doa.tracking import Track
from service.inference.results import sphere_rows
from service.streaming.pipeline import Estimate

ODAS_PLACES = 4
"""Directions and tracks of every ODAS object; empty ones are zero"""


def result_fields(
    estimate: Estimate,
    sources: Sequence[StreamSource],
    orientation: Orientation,
    *,
    spectrum: bool,
) -> dict[str, Any]:
    """Fields of ``Result`` except ``seq``, ``lag_ms`` and ``final``."""
    fields: dict[str, Any] = {
        "t_start": round(estimate.t_start, 6),
        "t_end": round(estimate.t_end, 6),
        "capture_time_ns": estimate.capture_time_ns,
        "sources": sources,
        "why_no_source": estimate.why_no_source,
        "spectrum": None,
        "sphere": None,
    }
    if estimate.pose is not None:
        yaw, pitch, roll = map(degrees, estimate.pose.angles)
        fields["pose"] = PoseInUse(yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll)
    if estimate.sphere is not None:
        fields["sphere"] = sphere_rows(orientation.sphere_on_robot(estimate.sphere))
    if spectrum:
        turned = orientation.spectrum_on_robot(estimate.spectrum)
        fields["spectrum"] = [round(value, 4) for value in turned.tolist()]
    return fields


def stream_source(track: Track, orientation: Orientation) -> StreamSource:
    """A track as it is sent, in the robot's frame."""
    azimuth = orientation.on_robot(track.azimuth)
    return StreamSource.model_construct(
        id=track.id,
        azimuth_deg=azimuth_deg(azimuth),
        elevation_deg=elevation_deg(track.elevation),
        unit_vector=unit_vector(azimuth, track.elevation),
        confidence=round(track.confidence, 3),
        active=track.active,
        velocity_deg_s=degrees(track.velocity),
        std_deg=degrees(math.sqrt(track.variance)),
    )


def odas_time_stamp(estimate: Estimate) -> int:
    """The time stamp of an estimate as ODAS counts it, in hops."""
    return round(estimate.t_end / ODAS_HOP_S)


def odas_potentials(estimate: Estimate, orientation: Orientation) -> list[OdasPotential]:
    """ODAS' SSL: the spectrum's four highest peaks."""
    peaks = [p for p in find_peaks(estimate.spectrum, 8) if not orientation.excludes(p.azimuth)]
    places = [(orientation.on_robot(p.azimuth), p.height) for p in peaks[:ODAS_PLACES]]
    filled = [OdasPotential(**_direction(a), E=round(float(h), 3)) for a, h in places]
    empty = OdasPotential(x=0.0, y=0.0, z=0.0, E=0.0)
    return filled + [empty] * (ODAS_PLACES - len(filled))


def odas_sources(estimate: Estimate, orientation: Orientation) -> list[OdasSource]:
    """ODAS' SST: the tracks."""
    filled = [
        OdasSource(
            id=track.id,
            tag="dynamic",
            **_direction(orientation.on_robot(track.azimuth), track.elevation),
            activity=round(track.confidence if track.active else 0.0, 3),
        )
        for track in estimate.tracks[:ODAS_PLACES]
    ]
    empty = OdasSource(id=0, tag="", x=0.0, y=0.0, z=0.0, activity=0.0)
    return filled + [empty] * (ODAS_PLACES - len(filled))


def _direction(azimuth: float, elevation: float | None = None) -> dict[str, float]:
    values = unit_vector(azimuth, elevation)
    return {axis: round(value, 3) for axis, value in zip("xyz", values, strict=True)}

"""The cells of the evaluation: what is simulated, and whether the number of talkers is known."""

from __future__ import annotations

from dataclasses import dataclass

from model_export.simulation.arrays import TEST_ARRAYS
from model_export.simulation.protocol import SceneProtocol
from model_export.simulation.rooms import RoomSpec

HALF_SECOND = 8000
"""Half a second in samples at 16 kHz"""


def small_room(rt60: float) -> RoomSpec:
    """A room of 5 x 4 x 2.8 m; ``rt60`` in seconds."""
    return RoomSpec((5.0, 4.0, 2.8), (2.2, 1.8, 1.1), rt60=rt60)


def living_room(rt60: float) -> RoomSpec:
    """A room of 6 x 5 x 3 m; ``rt60`` in seconds."""
    return RoomSpec((6.0, 5.0, 3.0), (2.8, 2.3, 1.1), rt60=rt60)


def large_room(rt60: float) -> RoomSpec:
    """A room of 10 x 8 x 3.5 m; ``rt60`` in seconds."""
    return RoomSpec((10.0, 8.0, 3.5), (4.2, 3.6, 1.2), rt60=rt60)


@dataclass(frozen=True, slots=True)
class Cell:
    """One row of the results' tables."""

    name: str
    protocol: SceneProtocol
    count_known: bool = True


def _two_talkers(separation_deg: float, rt60: float) -> Cell:
    protocol = SceneProtocol(
        num_sources=2,
        room=living_room(rt60),
        snr_db=20.0,
        separation_deg=separation_deg,
        continuous=True,
    )
    name = f"M=2, {separation_deg:g}° apart, RT60 {rt60:g} s, count unknown"
    return Cell(name, protocol, count_known=False)


PAPER_CELLS = (
    Cell("M=1, order 4, 30 dB", SceneProtocol()),
    Cell("M=1, order 4, 0 dB", SceneProtocol(snr_db=0.0)),
    Cell("M=2, order 4, 30 dB", SceneProtocol(num_sources=2)),
    Cell("M=2, order 0-4, 30 dB", SceneProtocol(num_sources=2, orders=(0, 4))),
    Cell("M=1, order 4, 30 dB, count unknown", SceneProtocol(), count_known=False),
    Cell("M=2, order 4, 30 dB, count unknown", SceneProtocol(num_sources=2), count_known=False),
)
ROOM_CELLS = (
    Cell("M=1, 5x4x2.8 m, RT60 0.35 s", SceneProtocol(room=small_room(0.35))),
    Cell("M=1, 10x8x3.5 m, RT60 0.6 s", SceneProtocol(room=large_room(0.6))),
)
ARRAY_CELLS = (
    Cell("M=1, order 4, 6-mic circular", SceneProtocol(array="respeaker-6mic-circular")),
    *(Cell(f"M=1, order 4, {name}", SceneProtocol(array=name)) for name in TEST_ARRAYS),
)
TALKER_CELLS = tuple(
    _two_talkers(separation_deg, rt60) for rt60 in (0.3, 0.6) for separation_deg in (45, 90, 150)
)
SHORT_CELL = Cell(
    "M=1, 5 dB, RT60 0.6 s, 0.5 s windows, count unknown",
    SceneProtocol(room=living_room(0.6), snr_db=5.0, continuous=True, num_samples=HALF_SECOND),
    count_known=False,
)
CELLS = (*PAPER_CELLS, *ROOM_CELLS, *ARRAY_CELLS, *TALKER_CELLS, SHORT_CELL)

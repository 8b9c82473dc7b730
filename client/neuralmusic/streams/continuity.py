"""One stream out of successive sessions: numbers, time and ids go on where the last one ended.

Every session of the service counts its messages, its seconds and its tracks anew. What a stream's
reader gets counts on: ``seq``, ``t_start``, ``t_end`` and ``timeStamp`` rise, and no id stands for
two sources.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

from neuralmusic.protocol.server_messages import (
    ODAS_HOP_S,
    RESULTS,
    AnyServerMessage,
    Flushed,
    OdasSsl,
    OdasSst,
    Ready,
    Result,
    ServerMessage,
    Summary,
)
from neuralmusic.streams.inbox import NewSession

KEPT_S = 60.0
"""Seconds after which a source at the same place gets another id"""
SAME_PLACE_DEG = 15.0
"""Most degrees between the last direction of a source and its first one in the next session"""

Vector = Sequence[float]
M = TypeVar("M", bound=ServerMessage)


class Continuity:
    """Offsets of the session in progress, and the places of the sources heard last.

    Parameters
    ----------
    live : bool
        Whether stream time goes on during an outage, as its audio is lost.
    """

    def __init__(self, live: bool) -> None:
        self._live = live
        self._session: str | None = None
        self._follows = False
        """Whether another session was before this one"""
        self._first_seq = self._next_seq = 0
        self._offset_s = self._t_end = 0.0
        self._heard = 0.0
        """Clock time of the last result, or of ``ready`` before the first"""
        self._next_id = 1
        self._ids: dict[int, int] = {}
        """The stream's id of every id of the session"""
        self._places: dict[int, tuple[float, Vector]] = {}
        """Clock time and unit vector at which every source was told last, by the stream's id"""
        self._before: dict[int, tuple[float, Vector]] = {}
        """Places of the sessions before, whose ids may be given again"""

    @property
    def offset_s(self) -> float:
        """Seconds of the stream at which the session in progress began."""
        return self._offset_s

    def begin(self, ready: Ready, now: float) -> tuple[Ready, NewSession | None]:
        """The ``ready`` of another session as the stream tells it, and what it follows.

        Parameters
        ----------
        now : float
            Seconds of a monotonic clock, as in ``follow``.
        """
        begun = None
        if self._session is not None:
            self._follows = True
            outage_s = max(now - self._heard, 0.0)
            self._offset_s = self._t_end = self._t_end + (outage_s if self._live else 0.0)
            begun = NewSession(
                ready.session, self._session, round(self._offset_s, 6), round(outage_s, 3)
            )
        self._session, self._heard, self._first_seq = ready.session, now, self._next_seq
        self._before.update(self._places)
        self._ids, self._places = {}, {}
        return self._numbered(ready, {}), begun

    def follow(self, message: AnyServerMessage, now: float) -> AnyServerMessage:
        """A message of the session as the stream tells it."""
        changed: dict[str, Any] = {}
        if isinstance(message, RESULTS):
            self._heard = now
            changed["session"] = self._session
        if isinstance(message, Result):
            places: dict[int, Vector] = {s.id: s.unit_vector for s in message.sources}
            changed.update(self._times(message, "t_start", "t_end"))
            changed["sources"] = self._renamed(message.sources, places, now)
            self._t_end = changed["t_end"]
        elif isinstance(message, (OdasSsl, OdasSst)):
            changed["timeStamp"] = message.timeStamp + round(self._offset_s / ODAS_HOP_S)
            self._t_end = changed["timeStamp"] * ODAS_HOP_S
            if isinstance(message, OdasSst):
                places = {s.id: (s.x, s.y, s.z) for s in message.src if s.id}  # 0 is an empty place
                changed["src"] = self._renamed(message.src, places, now)
        elif isinstance(message, Flushed):
            changed.update(self._times(message, "t_end"))
        elif isinstance(message, Summary):
            changed["sources"] = [
                track.model_copy(
                    update={"id": self._id(track.id), **self._times(track, "first_s", "last_s")}
                )
                for track in message.sources
            ]
        return self._numbered(message, changed)

    def _numbered(self, message: M, changed: dict[str, Any]) -> M:
        seq = self._first_seq + message.seq
        self._next_seq = max(self._next_seq, seq + 1)
        return message.model_copy(update={"seq": seq, **changed})

    def _times(self, message: object, *names: str) -> dict[str, float]:
        return {name: round(getattr(message, name) + self._offset_s, 6) for name in names}

    def _renamed(self, sources: Iterable[Any], places: dict[int, Vector], now: float) -> list[Any]:
        """Sources with the stream's ids; new ones get their id back, or another."""
        new = {source: place for source, place in places.items() if source not in self._ids}
        if new:
            self._recognize(new, now)
        for source, place in places.items():
            self._places[self._id(source)] = now, place
        self._places = _recent(self._places, now)
        return [
            source.model_copy(update={"id": self._ids[source.id]}) if source.id else source
            for source in sources
        ]

    def _recognize(self, new: dict[int, Vector], now: float) -> None:
        """Give sources the ids of earlier sessions' at the same place, nearest pairs first."""
        self._before = _recent(self._before, now)
        pairs = sorted(
            (_angle_deg(place, before), known, source)
            for source, place in new.items()
            for known, (_, before) in self._before.items()
        )
        for angle, known, source in pairs:
            if angle <= SAME_PLACE_DEG and known in self._before and source not in self._ids:
                self._ids[source] = known
                del self._before[known]

    def _id(self, source: int) -> int:
        """The stream's id of a source; the first session's ids are the service's own."""
        if source not in self._ids:
            self._ids[source] = self._next_id if self._follows else source
        self._next_id = max(self._next_id, self._ids[source] + 1)
        return self._ids[source]


def _recent(places: dict[int, tuple[float, Vector]], now: float) -> dict[int, tuple[float, Vector]]:
    return {known: place for known, place in places.items() if now - place[0] <= KEPT_S}


def _angle_deg(first: Vector, second: Vector) -> float:
    cosine = sum(a * b for a, b in zip(first, second))
    return math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))

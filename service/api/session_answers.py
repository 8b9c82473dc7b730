"""Answers about streams: one, those of a process, those of all replicas."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from neuralmusic.protocol.methods import Method
from service.api.state import ServiceState
from service.recordings.answers import Answer
from service.streaming.registry import SessionEntry


class SessionAnswer(Answer):
    """One stream."""

    id: str
    client: str | None
    """Name that the client gave itself"""
    array: str | None
    """Name of the array; null until `start` was received"""
    model: str | None
    method: Method | None
    started_at: str
    """Time at which the stream began: ISO 8601, UTC"""
    audio_s: float
    """Seconds of audio received"""
    results: int
    lag_ms: float
    """Milliseconds from audio to result, of the last result"""
    dropped_s: float
    """Seconds of audio dropped so that results describe the present"""
    num_sources: int
    """Number of sources in the last result"""
    state: Literal["running", "ended"]
    replica: str
    """Process that serves the stream"""

    @classmethod
    def of(cls, entry: SessionEntry, replica: str) -> SessionAnswer:
        ready, account = entry.ready, entry.reporter.account
        last = account.history.last
        return cls(
            id=entry.id,
            client=entry.client,
            array=ready.array.name if ready else None,
            model=ready.model.name if ready and ready.model else None,
            method=ready.method if ready else None,
            started_at=entry.started_at.isoformat(timespec="milliseconds"),
            audio_s=round(account.audio_s, 3),
            results=account.results,
            lag_ms=account.lag_ms,
            dropped_s=round(account.dropped_s, 3),
            num_sources=len(last.points) if last else 0,
            state="running" if entry.running else "ended",
            replica=replica,
        )


class SessionsAnswer(Answer):
    """The streams of one process, or of all replicas (`NEURALMUSIC_PEERS`)."""

    sessions: list[SessionAnswer]
    """Running streams first, then the last that ended"""
    max_sessions: int
    """Most streams that may run at the same time, on all `replicas` together"""
    replica: str
    """Process that answers"""
    replicas: list[str]
    """Processes whose streams these are"""
    unanswered: int
    """Number of addresses whose replica did not answer in time: its streams are missing"""

    @classmethod
    def of(cls, state: ServiceState) -> SessionsAnswer:
        """The streams of this process."""
        name, streams = state.replicas.name, state.streams
        return cls(
            sessions=[SessionAnswer.of(entry, name) for entry in streams],
            max_sessions=streams.max_sessions,
            replica=name,
            replicas=[name],
            unanswered=0,
        )

    def with_others(self, others: Sequence[SessionsAnswer | None]) -> SessionsAnswer:
        """These streams and those of the other replicas; None is one that did not answer."""
        known = {other.replica: other for other in others if other} | {self.replica: self}
        sessions = [session for each in known.values() for session in each.sessions]
        sessions.sort(key=lambda session: session.started_at, reverse=True)
        sessions.sort(key=lambda session: session.state, reverse=True)  # running before ended
        return SessionsAnswer(
            sessions=sessions,
            max_sessions=sum(each.max_sessions for each in known.values()),
            replica=self.replica,
            replicas=sorted(known),
            unanswered=sum(other is None for other in others),
        )

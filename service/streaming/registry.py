"""The running sessions of a process and the last that ended, for watchers and exports."""

from __future__ import annotations

import asyncio
import secrets
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime

from neuralmusic.errors import Overloaded
from neuralmusic.protocol.server_messages import Ready, ServerMessage, StreamWarning
from service.streaming.reporter import Reporter
from service.streaming.session import Session

MAX_WATCHERS = 128
"""Most watchers of all streams: each of them gets every message of its stream"""
KEPT = 16
"""Most ended sessions whose results can still be exported"""

Watcher = Callable[[ServerMessage], None]
Act = Callable[[Callable[[], None]], None]


@dataclass(slots=True, eq=False)
class SessionEntry:
    """One session as watchers see it."""

    id: str
    started_at: datetime
    session: Session
    reporter: Reporter
    act: Act
    """Has the session take a step; what that raises is the end of this session alone"""
    ready: Ready | None = None
    warnings: dict[str, StreamWarning] = field(default_factory=dict)
    """The last warning of each code"""
    watchers: list[Watcher] = field(default_factory=list)

    @property
    def client(self) -> str | None:
        """Name that the client gave itself."""
        start = self.session.start
        return start.client if start else None

    @property
    def running(self) -> bool:
        """False once the session has ended."""
        return self.session.state != "closed"

    def watch(self, watcher: Watcher) -> None:
        """Give every further message to ``watcher``; results then have their spectrum."""
        self.watchers.append(watcher)
        self.reporter.watched = True

    def unwatch(self, watcher: Watcher) -> None:
        """Stop giving messages to ``watcher``."""
        self.watchers.remove(watcher)
        self.reporter.watched = bool(self.watchers)

    def observe(self, message: ServerMessage) -> None:
        """Keep a message of the session and pass it to the watchers."""
        if isinstance(message, Ready):
            self.ready = message
        elif isinstance(message, StreamWarning):
            self.warnings[message.code] = message
        for watcher in tuple(self.watchers):
            watcher(message)


class SessionRegistry:
    """The sessions of a process, of which at most ``max_sessions`` run at a time."""

    def __init__(self, max_sessions: int) -> None:
        self.max_sessions = max_sessions
        self._running: dict[str, SessionEntry] = {}
        self._ended: deque[SessionEntry] = deque(maxlen=KEPT)
        self._watchers = 0
        self.empty = asyncio.Event()
        """Set while no session runs"""
        self.empty.set()

    def __iter__(self) -> Iterator[SessionEntry]:
        """Iterate over running sessions, then ended ones, newest first."""
        yield from self._running.values()
        yield from reversed(self._ended)

    @property
    def running(self) -> int:
        """Number of running sessions."""
        return len(self._running)

    def drain(self) -> None:
        """End all sessions gracefully."""
        for entry in self.running_entries():
            entry.act(entry.session.drain)

    def check(self) -> None:
        """Raise Overloaded where one more session would be refused."""
        if len(self._running) >= self.max_sessions:
            most = self.max_sessions
            raise Overloaded(f"the service has reached its limit of {most} streams: try later")

    @contextmanager
    def watcher(self) -> Iterator[None]:
        """Hold a place for a watcher of any session, or raise Overloaded."""
        if self._watchers >= MAX_WATCHERS:
            raise Overloaded(f"streams have {MAX_WATCHERS} watchers, the most: try again later")
        self._watchers += 1
        try:
            yield
        finally:
            self._watchers -= 1

    def new_id(self) -> str:
        """An id that cannot be guessed: whoever knows it can watch the session."""
        return secrets.token_urlsafe(9)

    def add(self, session: Session, reporter: Reporter, act: Act) -> SessionEntry:
        """Add a session."""
        entry = SessionEntry(session.id, datetime.now(UTC), session, reporter, act)
        self._running[session.id] = entry
        self.empty.clear()
        return entry

    def end(self, entry: SessionEntry) -> None:
        """Remove a session; its results, if any, stay for a while, its connection does not."""
        entry.act = entry.reporter.on_message = _to_nobody
        del self._running[entry.id]
        if not self._running:
            self.empty.set()
        if entry.reporter.account.results:
            self._ended.append(entry)

    def running_entries(self) -> tuple[SessionEntry, ...]:
        """The running sessions."""
        return tuple(self._running.values())

    def get(self, session_id: str) -> SessionEntry | None:
        """The session with this id, running or ended."""
        return next((entry for entry in self if entry.id == session_id), None)


def _to_nobody(_: object) -> None:
    """Take what has no connection to go to any more."""

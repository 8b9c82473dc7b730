"""What one API key uses: streams and uploads now, seconds of audio over the last hour."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

from neuralmusic.errors import (
    AudioQuota,
    AudioTooLong,
    DoaError,
    TooManySessions,
    TooManyUploads,
    TooManyWatchers,
)

HOUR_S = 3600.0


class Usage:
    """The counts of one key; safe to use from several threads. None means no limit.

    Audio is a leaky bucket: what was used drains at the limit's own pace. A stream in real time
    runs for ever with a limit of 3600 s an hour, and a client that spent everything at once may
    continue a little later, not an hour later. In any one hour at most twice the limit passes: a
    recording's audio is reserved before any of it is localized, and what was not is given back.

    Parameters
    ----------
    clock : callable
        Seconds of a monotonic clock.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._held: Counter[str] = Counter()
        self._audio_s = 0.0
        """Seconds of audio that had not drained at ``_since``"""
        self._since = clock()

    @property
    def idle(self) -> bool:
        """True while the key has no stream and no upload."""
        return not any(self._held.values())

    def session(self, most: int | None) -> AbstractContextManager[None]:
        """Hold a place for a stream, or raise TooManySessions."""
        refusal = TooManySessions(f"this key has reached its limit of {most} streams: close one")
        return self._place("sessions", most, refusal)

    def upload(self, most: int | None) -> AbstractContextManager[None]:
        """Hold a place for an upload, or raise TooManyUploads."""
        refusal = TooManyUploads(f"this key has reached its limit of {most} uploads: wait for one")
        return self._place("uploads", most, refusal)

    def watcher(self, most: int) -> AbstractContextManager[None]:
        """Hold a place for somebody who watches a stream, or raise TooManyWatchers."""
        refusal = TooManyWatchers(
            f"{most} watchers are the most with one key, or without keys: close one"
        )
        return self._place("watchers", most, refusal)

    @contextmanager
    def _place(self, kind: str, most: int | None, refusal: DoaError) -> Iterator[None]:
        with self._lock:
            if most is not None and self._held[kind] >= most:
                raise refusal
            self._held[kind] += 1
        try:
            yield
        finally:
            with self._lock:
                self._held[kind] -= 1

    def charge(self, seconds: float, per_hour: float | None) -> None:
        """Count seconds of audio; where they exceed the limit, what follows is refused."""
        with self._lock:
            self._drain(per_hour)
            self._audio_s += seconds

    def reserve(self, seconds: float, per_hour: float | None) -> None:
        """Count seconds of audio to come, or raise AudioQuota where they exceed the limit.

        More than the limit can ever allow raises AudioTooLong: waiting would not help.
        A negative number gives back what was reserved and not used.
        """
        with self._lock:
            self._drain(per_hour)
            beyond = 0.0 if per_hour is None else self._audio_s + seconds - per_hour
            if seconds <= 0 or beyond <= 0:
                self._audio_s = max(0.0, self._audio_s + seconds)
                return
        assert per_hour is not None
        if seconds > per_hour:
            raise AudioTooLong(  # no wait would help, so no Retry-After
                f"the recording's {seconds:.0f} s are more than the {per_hour:g} s of audio an "
                "hour of this key: split it"
            )
        raise _used_up(beyond, per_hour)

    def check_audio(self, per_hour: float | None) -> None:
        """Raise AudioQuota where the limit is used up."""
        if per_hour is None:
            return
        with self._lock:
            self._drain(per_hour)
            beyond = self._audio_s - per_hour
        if beyond >= 0:
            raise _used_up(beyond, per_hour)

    def _drain(self, per_hour: float | None) -> None:
        now = self._clock()
        elapsed, self._since = now - self._since, now
        drained = elapsed * per_hour / HOUR_S if per_hour is not None else self._audio_s
        self._audio_s = max(0.0, self._audio_s - drained)


def _used_up(beyond: float, per_hour: float) -> AudioQuota:
    """The refusal of audio that would be ``beyond`` seconds above the limit."""
    wait = max(1.0, beyond * HOUR_S / per_hour)
    return AudioQuota(
        f"this key has used its {per_hour:g} s of audio an hour: continue in {wait:.0f} s", wait
    )

"""A session's kept results: the same as were given, bounded, and small."""

from __future__ import annotations

import tracemalloc

from hypothesis import given
from hypothesis import strategies as st

from service.streaming.history import HISTORY, LAST_TIME, History, HistoryEntry, Point

POINTS = st.builds(
    Point,
    st.integers(0, 2**32 - 1),
    st.floats(0, 360, exclude_max=True),
    st.floats(0, 1),
    st.booleans(),
)
ENTRIES = st.builds(
    HistoryEntry,
    st.floats(0, 1e6),
    st.none() | st.integers(-LAST_TIME, LAST_TIME),
    st.lists(POINTS, max_size=8).map(tuple),
)


@given(st.lists(ENTRIES, max_size=20))
def test_what_was_kept_comes_back(entries: list[HistoryEntry]) -> None:
    history = History()
    for entry in entries:
        history.append(entry)
    assert list(history) == entries
    assert len(history) == len(entries)
    assert history.last == (entries[-1] if entries else None)


def test_a_clock_beyond_all_times_is_kept_as_the_last_one() -> None:
    history = History()
    history.append(HistoryEntry(1.0, 2**70, ()))
    assert list(history) == [HistoryEntry(1.0, LAST_TIME, ())]


def test_ten_minutes_of_two_talkers_take_less_than_a_megabyte() -> None:
    points = (Point(1, 45.0, 0.9, True), Point(2, 200.0, 0.8, True))
    history = History()
    tracemalloc.start()
    try:
        for index in range(HISTORY + 500):
            history.append(HistoryEntry(index / 10, 10**18 + index, points))
        taken, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(history) == HISTORY
    assert taken < 1_000_000

"""Windows cut from blocks, whatever the blocks' sizes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.inference.windows import stretches, windows

RATE = 1000


@given(
    total=st.integers(1, 5000),
    window=st.sampled_from([0.2, 0.5, 1.024]),
    hop=st.sampled_from([0.05, 0.3, 0.512, 2.0]),
    cuts=st.lists(st.integers(0, 5000), max_size=8),
)
def test_any_split_gives_the_same_windows(
    total: int, window: float, hop: float, cuts: list[int]
) -> None:
    audio = np.arange(1, total + 1, dtype=np.float32)[None]
    blocks = np.split(audio, sorted(c for c in cuts if c < total), axis=1)
    found = list(windows(blocks, RATE, window, hop, tail=16))
    length = round(window * RATE)
    for index, piece in enumerate(found):
        start = round(index * hop * RATE)
        assert piece.start == pytest.approx(index * hop)
        assert piece.audio.shape == (1, length + 16)
        expected = audio[0, start : start + length + 16]
        np.testing.assert_array_equal(piece.audio[0, : expected.size], expected)
        assert (piece.audio[0, expected.size :] == 0).all()
        assert piece.heard == min(length, total - start)
    # The last window, and no earlier one, reaches the end; none begins behind it.
    starts = [round(index * hop * RATE) for index in range(len(found))]
    assert starts[-1] < total
    assert starts[-1] + length >= total or round(len(found) * hop * RATE) >= total
    assert all(start + length < total for start in starts[:-1])


@given(
    total=st.integers(1, 5000),
    window=st.sampled_from([0.2, 0.5, 1.024]),
    hop=st.sampled_from([0.05, 0.3, 0.3333, 0.512, 2.0]),
    most=st.integers(1, 9),
)
def test_stretches_hold_the_same_windows(total: int, window: float, hop: float, most: int) -> None:
    audio = np.arange(1, 2 * total + 1, dtype=np.float32).reshape(2, total)
    alone = list(windows([audio], RATE, window, hop, tail=16))
    joined = list(stretches(iter(alone), most))
    assert [start for each in joined for start in each.starts] == [each.start for each in alone]
    assert [heard for each in joined for heard in each.heard] == [each.heard for each in alone]
    assert all(len(each.windows) == len(each.starts) <= most for each in joined)
    together = np.concatenate([each.windows for each in joined])
    np.testing.assert_array_equal(together, np.stack([each.audio for each in alone]))
    for each in joined:
        assert each.audio.shape[1] == each.length + (len(each.starts) - 1) * each.hop
        assert len(each.starts) == 1 or each.hop < each.length  # no gap is held


def test_windows_at_one_distance_fill_their_stretches() -> None:
    audio = np.zeros((1, 10_000), np.float32)
    joined = list(stretches(windows([audio], RATE, 1.0, 0.5, tail=16), 8))
    assert [len(each.starts) for each in joined] == [8, 8, 3]


def test_a_short_recording_is_one_padded_window() -> None:
    (only,) = windows([np.ones((4, 300), np.float32)], RATE, 1.0, 0.5, tail=16)
    assert only.heard == 300
    assert only.audio.shape == (4, 1016)


def test_nothing_gives_nothing() -> None:
    assert list(windows([], RATE, 1.0, 0.5, tail=16)) == []

"""The buffer and the queue to a client: nothing lost, nothing twice, bounded."""

from __future__ import annotations

import asyncio

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from service.api.outbox import MAX_DROPPABLE, Outbox
from service.streaming.buffer import AudioBuffer, Piece

FRAME = 8
RATE = 16000


@given(
    sizes=st.lists(st.integers(0, 50), max_size=20), takes=st.lists(st.integers(0, 70), max_size=20)
)
def test_what_goes_in_comes_out_once_and_in_order(sizes: list[int], takes: list[int]) -> None:
    buffer = AudioBuffer(FRAME, RATE)
    whole = np.arange(sum(sizes) * FRAME, dtype=np.uint32).astype(np.uint8).tobytes()
    position = 0
    for size in sizes:
        data = whole[position * FRAME : (position + size) * FRAME]
        buffer.append(Piece(position, data, arrived=0.0, capture_time_ns=position * 62_500))
        position += size
    taken = b""
    for count in [*takes, position]:
        before = buffer.frames
        pieces = buffer.take(count)
        assert before - buffer.frames == min(count, before)
        for piece in pieces:
            assert piece.position == len(taken) // FRAME
            assert piece.capture_time_ns == piece.position * 62_500
            taken += piece.data
    assert taken == whole
    assert buffer.frames == 0


@given(sizes=st.lists(st.integers(1, 50), max_size=20), kept=st.integers(0, 200))
def test_dropping_keeps_the_newest(sizes: list[int], kept: int) -> None:
    buffer = AudioBuffer(FRAME, RATE)
    position = 0
    for size in sizes:
        buffer.append(Piece(position, bytes(size * FRAME), arrived=0.0))
        position += size
    assert buffer.keep(kept) == max(0, position - kept)
    rest = buffer.take(position)
    assert sum(len(piece.data) for piece in rest) == min(kept, position) * FRAME
    if rest:
        assert rest[0].position == max(0, position - kept)


def test_a_slow_reader_loses_old_results_and_no_warning() -> None:
    async def run() -> list[str]:
        outbox = Outbox()
        outbox.put("ready", droppable=False)
        dropped = sum(outbox.put(f"result {n}", droppable=True) for n in range(100))
        outbox.put("warning", droppable=False)
        outbox.close()
        assert dropped == 100 - MAX_DROPPABLE
        read = []
        while (message := await outbox.get()) is not None:
            read.append(message.text)
        return read

    read = asyncio.run(run())
    assert read[0] == "ready"
    assert read[1:-1] == [f"result {n}" for n in range(100 - MAX_DROPPABLE, 100)]
    assert read[-1] == "warning"

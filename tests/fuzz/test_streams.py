"""Thousands of damaged streams against the running service."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable
from pathlib import Path

import pytest

from .conversations import Conversation, conversation
from .judgement import PROMPT_S, Tally
from .listening import Said, complaint, converse
from .rest import leftovers, returned, settled
from .served import PATIENCE_S, Served
from .sizes import FIRST, STREAMS

pytestmark = pytest.mark.fuzz

CLIENTS = 10
WARM_UP = 1000
"""Streams before memory is measured, other than those of the test"""
LISTEN_S = 0.3
"""Seconds for which a client stays whose last bytes leave the server waiting"""


def test_an_index_is_always_the_same_stream() -> None:
    first, again = ([conversation(index) for index in range(50)] for _ in range(2))
    assert first == again
    assert len({each.content for each in first}) > 40


def test_damaged_streams_are_answered_and_leave_nothing_behind(
    served: Served, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tally, began = Tally(), time.monotonic()
    hold_all(served, range(-WARM_UP, 0), tally, tmp_path)
    before = settled(served)
    hold_all(served, range(FIRST, FIRST + STREAMS), tally, tmp_path)
    after = returned(served, before)
    with capsys.disabled():
        print(f"\nstreams in {time.monotonic() - began:.0f} s, {tally}")
        print(f"before: {before}\nafter: {after}")
    tally.check()
    assert leftovers(after, before) == []


def hold_all(served: Served, indices: Iterable[int], tally: Tally, folder: Path) -> None:
    """Several clients at once; slow streams are held again, alone, before they count."""
    remaining = iter(indices)
    slow: list[Conversation] = []

    async def client() -> None:
        for index in remaining:
            each = conversation(index)
            if await judge(served, each, tally, folder) > PROMPT_S:
                slow.append(each)

    async def run() -> None:
        await asyncio.gather(*(client() for _ in range(CLIENTS)))
        for each in slow:
            tally.repeated += 1
            seconds = await judge(served, each, tally, folder)
            if seconds > PROMPT_S:
                keep(each, f"took {seconds:.1f} s alone", tally, folder)

    asyncio.run(run())


async def judge(served: Served, each: Conversation, tally: Tally, folder: Path) -> float:
    """Hold one stream and judge it; the seconds that it took."""
    said, wrong = Said(), None
    began = time.monotonic()
    try:
        async with asyncio.timeout(LISTEN_S if each.patient else PATIENCE_S):
            await converse(served.address, each, said)
    except TimeoutError:
        wrong = None if each.patient else "no end"
    except (OSError, ValueError, LookupError) as error:
        wrong = repr(error)
    seconds = time.monotonic() - began
    wrong = wrong or complaint(said, each)
    tally.count(said.outcome, seconds, f"#{each.index} {each.what}")
    if wrong is not None:
        keep(each, wrong, tally, folder)
    return seconds


def keep(each: Conversation, wrong: str, tally: Tally, folder: Path) -> None:
    repeat = f"FUZZ_FIRST={each.index} FUZZ_STREAMS=1"
    path = folder / f"stream-{each.index}.bytes"
    evidence = each.handshake + each.content
    tally.fail(f"{each.what}: {wrong}; again with {repeat}", evidence, path)

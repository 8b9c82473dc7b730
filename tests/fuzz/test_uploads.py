"""Thousands of damaged recordings, forms and options against the running service."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Iterable
from pathlib import Path

import pytest

from .http import Answer, Connection, post
from .judgement import PROMPT_S, Tally, complaint
from .rest import leftovers, returned, settled
from .served import PATIENCE_S, Served
from .sizes import FIRST, UPLOADS
from .uploads import Upload, upload

pytestmark = pytest.mark.fuzz

CLIENTS = 6
WARM_UP = 1000
"""Uploads before memory is measured, other than those of the test"""


def test_an_index_is_always_the_same_upload() -> None:
    first, again = ([upload(index) for index in range(50)] for _ in range(2))
    assert first == again
    assert len({each.content for each in first}) > 45


def test_damaged_uploads_are_answered_and_leave_nothing_behind(
    served: Served, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tally, began = Tally(), time.monotonic()
    send_all(served, range(-WARM_UP, 0), tally, tmp_path)
    before = settled(served)
    send_all(served, range(FIRST, FIRST + UPLOADS), tally, tmp_path)
    after = returned(served, before)
    with capsys.disabled():
        print(f"\nuploads in {time.monotonic() - began:.0f} s, {tally}")
        print(f"before: {before}\nafter: {after}")
    tally.check()
    assert leftovers(after, before) == []


def send_all(served: Served, indices: Iterable[int], tally: Tally, folder: Path) -> None:
    """Several clients at once; slow answers are asked for again, alone, before they count."""
    remaining = iter(indices)
    slow: list[Upload] = []

    async def client() -> None:
        connection = Connection(served.address)
        for index in remaining:
            each = upload(index)
            if await judge(connection, each, tally, folder) > PROMPT_S:
                slow.append(each)
        await connection.close()

    async def run() -> None:
        await asyncio.gather(*(client() for _ in range(CLIENTS)))
        for each in slow:
            connection = Connection(served.address)
            seconds = await judge(connection, each, tally, folder)
            await connection.close()
            tally.repeated += 1
            if seconds > PROMPT_S:
                keep(each, f"took {seconds:.1f} s alone", tally, folder)

    asyncio.run(run())


async def judge(connection: Connection, each: Upload, tally: Tally, folder: Path) -> float:
    """Send one and judge its answer; the seconds that it took."""
    began = time.monotonic()
    try:
        async with asyncio.timeout(PATIENCE_S):
            answer = await connection.ask(request(each))
        outcome, wrong = outcome_of(answer), complaint(answer)
    except (OSError, EOFError, ValueError) as error:  # TimeoutError is an OSError
        outcome, wrong = "no answer", repr(error)
        await connection.close()
    seconds = time.monotonic() - began
    tally.count(outcome, seconds, f"#{each.index} {each.what}")
    if wrong is not None:
        keep(each, wrong, tally, folder)
    return seconds


def keep(each: Upload, wrong: str, tally: Tally, folder: Path) -> None:
    repeat = f"FUZZ_FIRST={each.index} FUZZ_UPLOADS=1"
    path = folder / f"upload-{each.index}.http"
    tally.fail(f"{each.what}: {wrong}; again with {repeat}", request(each), path)


def request(each: Upload) -> bytes:
    return post(f"/localize?{each.query}", each.content_type, each.content)


def outcome_of(answer: Answer) -> str:
    if answer.status == 200:
        return "200"
    try:
        return f"{answer.status} {json.loads(answer.content)['code']}"
    except (ValueError, LookupError):
        return str(answer.status)

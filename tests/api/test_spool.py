"""The temporary folder's room: an upload that drips gives way to one that needs its room."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from neuralmusic.errors import RequestTimeout
from service.api.spool import AVERAGED_S, LEAST_BYTES_PER_S, MARGIN_BYTES, Spool

MEGABYTE = 2**20


class Scene:
    """A folder of some size, uploads in it, and a clock."""

    def __init__(self, size: int) -> None:
        self.size, self.held = size, 0
        self.spool = Spool(lambda: self.size - self.held + MARGIN_BYTES)
        self.now = 0.0
        self.ended: list[str] = []

    async def upload(self, name: str, size: int) -> None:
        """Send bytes at once, then nothing."""
        try:
            async with self.spool.arriving() as arrival:
                self.held += size
                arrival.received(size)
                try:
                    await asyncio.Event().wait()
                finally:
                    self.held -= size
        except RequestTimeout:
            self.ended.append(name)


def played(size: int, play: Callable[[Scene], Any]) -> Scene:
    """The scene after ``play``."""

    async def run() -> Scene:
        scene = Scene(size)
        asyncio.get_running_loop().time = lambda: scene.now  # type: ignore[method-assign]
        for task in await play(scene):
            task.cancel()
        return scene

    return asyncio.run(run())


async def begun(scene: Scene, **sizes: int) -> list[asyncio.Task[None]]:
    """Uploads of these sizes that have sent their bytes."""
    started = [asyncio.create_task(scene.upload(*each)) for each in sizes.items()]
    await asyncio.sleep(0)
    return started


def test_the_largest_of_the_slow_uploads_gives_way() -> None:
    async def play(scene: Scene) -> Any:
        running = await begun(scene, small=MEGABYTE, large=8 * MEGABYTE)
        scene.now += 2 * AVERAGED_S
        running += await begun(scene, fast=3 * MEGABYTE)
        async with scene.spool.arriving() as asking:
            await asking.make_room(4 * MEGABYTE)
        return running

    assert played(12 * MEGABYTE, play).ended == ["large"]


def test_uploads_are_ended_until_there_is_room_and_no_further() -> None:
    async def play(scene: Scene) -> Any:
        running = await begun(scene, a=MEGABYTE, b=2 * MEGABYTE, c=3 * MEGABYTE)
        scene.now += 2 * AVERAGED_S
        async with scene.spool.arriving() as asking:
            await asking.make_room(4 * MEGABYTE)
        return running

    assert played(6 * MEGABYTE, play).ended == ["c", "b"]


def test_no_upload_that_is_fast_enough_gives_way() -> None:
    async def play(scene: Scene) -> Any:
        async with scene.spool.arriving() as steady:
            for _ in range(100):
                scene.now += AVERAGED_S / 2
                steady.received(round(LEAST_BYTES_PER_S * AVERAGED_S / 2))
            async with scene.spool.arriving() as asking:
                await asking.make_room(8 * MEGABYTE)  # returns: the write fails, this one does not
        return []

    assert played(4 * MEGABYTE, play).ended == []

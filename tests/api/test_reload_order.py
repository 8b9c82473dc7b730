"""Reloads that are asked for while one runs, that hang and that fail; no process is started."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path

import pytest
from key_file import KeyFile

from neuralmusic.errors import BundleCorrupt, KeyUnknown, ReloadRefused
from service.api import state as state_module
from service.api.reloads import Reloads, within
from service.api.state import ServiceState
from service.inference.registry import BundleRegistry
from service.settings import Settings


def test_two_hundred_that_are_asked_for_meanwhile_are_one_more() -> None:
    began: list[str] = []
    on_disk = "old"

    async def scenario() -> list[str]:
        nonlocal on_disk
        running, go_on = asyncio.Event(), asyncio.Event()

        async def reload() -> str:
            began.append(on_disk)
            running.set()
            await go_on.wait()
            return began[-1]

        reloads = Reloads(reload)
        first = asyncio.create_task(reloads.ask())
        await running.wait()
        on_disk = "new"
        others = [asyncio.create_task(reloads.ask()) for _ in range(200)]
        await asyncio.sleep(0)
        others[0].cancel()  # its client is gone
        go_on.set()
        return [await first, *await asyncio.gather(*others[1:])]

    answers = asyncio.run(scenario())
    assert answers == ["old", *199 * ["new"]]
    assert began == ["old", "new"]


def test_what_hangs_is_left_behind() -> None:
    never, others = threading.Event(), set(threading.enumerate())

    async def scenario() -> int:
        with pytest.raises(TimeoutError):
            await within(0.01, never.wait)
        return await within(10.0, len, "next")

    assert asyncio.run(scenario()) == 4
    assert all(each.daemon for each in set(threading.enumerate()) - others)
    never.set()


@pytest.fixture
def keys(tmp_path: Path) -> KeyFile:
    return KeyFile(tmp_path / "keys.jsonl")


@pytest.mark.parametrize("models", ["hang", "corrupt"])
def test_a_key_is_taken_away_whatever_becomes_of_the_models(
    keys: KeyFile, models: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    token = keys.add("robot", "stream")
    keys.add("other", "stream")
    state = ServiceState.of(Settings(keys=keys.path))
    assert state.keys.authenticate(token).name == "robot"
    never = threading.Event()

    def load(_: Settings) -> BundleRegistry:
        if models == "hang":
            never.wait()
        raise BundleCorrupt("covariance.onnx is damaged")

    monkeypatch.setattr(state_module, "load_registry", load)
    monkeypatch.setattr(state_module, "LOAD_S", 0.05)
    keys.remove("robot")

    async def scenario() -> None:
        for _ in range(2):  # the first holds no lock against the next
            with pytest.raises(ReloadRefused, match=r"longer than|is damaged"):
                await state.reload()
        with pytest.raises(KeyUnknown):
            state.keys.authenticate(token)

    asyncio.run(scenario())
    never.set()


def test_wrong_keys_are_refused_and_change_nothing(keys: KeyFile) -> None:
    token = keys.add("robot", "stream")
    state = ServiceState.of(Settings(keys=keys.path))
    keys.path.write_text("{")
    with pytest.raises(ReloadRefused, match=r"line 1.*the keys that were loaded go on"):
        asyncio.run(state.reload())
    assert state.keys.authenticate(token).name == "robot"

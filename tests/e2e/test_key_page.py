"""The page on a service with keys: it asks for one, and then everything works as without."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from running_service import serving

from service.access.key_file import Key, new_token, token_sha256

expect = pytest.importorskip("playwright.sync_api", reason="needs playwright").expect
pytestmark = pytest.mark.page

Visits = Callable[..., Any]
SAMPLE = Path(__file__).parents[2] / "examples" / "two-talkers.flac"
WHOLE, WATCH = new_token(), new_token()


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A service with keys instead of the open one."""
    file = tmp_path_factory.mktemp("keys") / "keys.jsonl"
    keys = [
        Key(name="whole", sha256=token_sha256(WHOLE), roles=("localize", "stream", "watch")),
        Key(name="watcher", sha256=token_sha256(WATCH), roles=("watch",)),
    ]
    file.write_text("\n".join(key.line for key in keys))
    file.chmod(0o600)
    with serving(NEURALMUSIC_KEYS=str(file)) as address:
        yield address


def give(here: Any, token: str) -> None:
    here.page.fill("#key", token)
    here.page.click("#key-form button")


@pytest.fixture
def wav(tmp_path: Path) -> Path:
    """A second, so that its replay is short."""
    path = tmp_path / "short.wav"
    samples = np.random.default_rng(0).normal(0, 0.05, (16_000, 4))
    soundfile.write(path, samples, 16_000, subtype="PCM_16")
    return path


def test_the_page_asks_for_a_key_and_then_works(visit: Visits, wav: Path) -> None:
    here = visit(health="key needed")
    page = here.page
    here.refusals = 2  # models and arrays
    expect(page.locator("#key-form")).to_be_visible()
    expect(page.locator("#key")).to_be_focused()
    expect(page.locator("#key-why")).to_contain_text("Ask whoever runs it for one")
    give(here, WHOLE)
    page.locator("#health", has_text="ready").wait_for()
    expect(page.locator("#key-form")).to_be_hidden()

    here.localize(SAMPLE)
    assert len(here.azimuths()) >= 1

    page.set_input_files("#file", wav)
    page.click("#replay")
    expect(page.locator("#live-state")).to_contain_text("ended", timeout=30_000)
    with page.expect_download() as caught:
        page.click("#live-exports a")
    assert caught.value.suggested_filename.endswith(".csv")
    assert Path(caught.value.path()).read_text().startswith("t_end")

    expect(page.locator("#sessions button")).to_have_count(1)
    # The list is asked for now and then: until it says so, the session that is shown runs. Its last
    # minute comes by events, which an EventSource could not read with a key.
    page.click("#sessions button.ended")
    expect(page.locator("#live-state")).to_contain_text("its last minute is shown")


def test_the_key_lasts_as_long_as_the_tab_and_is_in_no_address(visit: Visits) -> None:
    here = visit(health="key needed")
    here.refusals = 2
    asked: list[str] = []
    here.page.on("request", lambda request: asked.append(request.url))
    give(here, WHOLE)
    here.page.locator("#health", has_text="ready").wait_for()
    here.page.reload()
    here.page.locator("#health", has_text="ready").wait_for()
    assert asked
    assert not any(WHOLE in address for address in asked)
    kept = here.page.evaluate("JSON.stringify(localStorage) + document.cookie")
    assert WHOLE not in kept
    other = here.page.context.new_page()
    other.goto(here.url)
    other.locator("#health", has_text="key needed").wait_for()
    other.close()


def test_a_wrong_key_says_so_and_one_without_the_role_may_be_changed(visit: Visits) -> None:
    here = visit(health="key needed")
    page = here.page
    give(here, new_token())
    expect(page.locator("#key-why")).to_contain_text("It does not know this key")
    give(here, WATCH)
    page.locator("#health", has_text="ready").wait_for()
    page.set_input_files("#file", SAMPLE)
    page.click("#localize")
    expect(page.locator("#problem .detail")).to_contain_text("the key watcher has watch")
    expect(page.locator("#key-why")).to_contain_text("This key is not for that")
    give(here, WHOLE)
    here.localize(SAMPLE)
    here.refusals = 5

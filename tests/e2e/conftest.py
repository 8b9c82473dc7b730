"""A service of its own process, and a browser that looks at it and hides nothing."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from running_service import serving

ROOT = Path(__file__).parents[2]
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = (
    "no-sandbox",
    "disable-gpu",
    "disable-quic",
    "no-first-run",
    "disable-background-networking",
    "disable-component-update",
    "disable-sync",
    "disable-audio-output",
)
DESKTOP = {"width": 1200, "height": 940}
SCREENSHOTS = os.environ.get("SCREENSHOTS")
MAX_PICTURE_BYTES = 200_000
PATIENCE = 30_000  # milliseconds until a hanging test fails


@pytest.fixture(scope="session")
def url() -> Iterator[str]:
    with serving() as address:
        yield address


@pytest.fixture(scope="module")  # its event loop must be gone when other tests run theirs
def chromium() -> Iterator[Any]:
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        pytest.skip(f"needs one of {', '.join(BROWSERS)}")
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=program, args=[f"--{argument}" for argument in ARGUMENTS]
        )
        yield browser
        browser.close()


@dataclass
class Visit:
    """A page, and what happened in it unseen."""

    page: Any
    url: str
    complaints: list[str] = field(default_factory=list)
    """Console messages of level warning and error, uncaught exceptions"""
    elsewhere: list[str] = field(default_factory=list)
    """Requests to anything but the service"""
    refusals: int = 0
    """Number of failed requests that the test provokes; the browser itself reports each"""

    def on_console(self, message: Any) -> None:
        if message.type in ("warning", "error"):
            self.complaints.append(message.text)

    def on_request(self, request: Any) -> None:
        if not request.url.startswith((self.url, "blob:" + self.url)):
            self.elsewhere.append(request.url)

    def localize(self, path: Path | dict[str, Any]) -> None:
        """Choose a file, press the button, wait for the answer."""
        self.page.set_input_files("#file", path)
        self.page.click("#localize")
        self.page.locator("#setup-status", has_text="Found").wait_for()

    def azimuths(self, places: str = "#summary .azimuth") -> list[float]:
        return [float(text.rstrip("°")) for text in self.page.locator(places).all_inner_texts()]

    def overflow(self) -> float:
        """Pixels by which the page is wider than the screen."""
        return float(self.page.evaluate("document.documentElement.scrollWidth - window.innerWidth"))


def keep_picture(here: Visit, name: str) -> None:
    """Write a picture for the documentation, where it was asked for."""
    if SCREENSHOTS:
        path = ROOT / SCREENSHOTS / f"{name}.png"
        here.page.screenshot(path=path, animations="disabled")
        assert path.stat().st_size < MAX_PICTURE_BYTES


@pytest.fixture
def visit(chromium: Any, url: str) -> Iterator[Callable[..., Visit]]:
    """Opens the page; at the end there must be no complaint and no request to another host."""
    opened: list[Visit] = []

    def open_page(
        viewport: dict[str, int] = DESKTOP, view: str = "", health: str = "ready", **how: Any
    ) -> Visit:
        page = chromium.new_context(viewport=viewport, **how).new_page()
        page.set_default_timeout(PATIENCE)
        here = Visit(page, url)
        opened.append(here)
        page.on("console", here.on_console)
        page.on("pageerror", lambda error: here.complaints.append(str(error)))
        page.on("request", here.on_request)
        page.goto(f"{url}/{view}")
        page.locator("#health", has_text=health).wait_for()
        return here

    yield open_page
    for here in opened:
        here.page.context.close()
        refused = [text for text in here.complaints if "Failed to load resource" in text]
        assert len(refused) == here.refusals
        assert [text for text in here.complaints if text not in refused] == []
        assert here.elsewhere == []

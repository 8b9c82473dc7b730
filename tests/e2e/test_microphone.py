"""A browser's own microphone: two channels that the browser takes from a file, as a stream."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

from service.doa.array import MicrophoneArray

from .conftest import ARGUMENTS, BROWSERS

api = pytest.importorskip("playwright.sync_api", reason="needs playwright")
pytestmark = pytest.mark.page

Visits = Callable[..., Any]
AZIMUTH_DEG = 50.0
SPACING_M = 0.12


@pytest.fixture(scope="module")
def heard(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file that the browser takes for its microphone."""
    return tmp_path_factory.mktemp("microphone") / "heard.wav"


@pytest.fixture(scope="module")
def chromium(heard: Path) -> Iterator[Any]:
    """A browser with that microphone, which asks nobody for leave."""
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        pytest.skip(f"needs one of {', '.join(BROWSERS)}")
    fake = [
        "use-fake-ui-for-media-stream",
        "use-fake-device-for-media-stream",
        f"use-file-for-fake-audio-capture={heard}",
    ]
    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=program, args=[f"--{argument}" for argument in (*ARGUMENTS, *fake)]
        )
        yield browser
        browser.close()


def test_the_direction_of_a_sound_before_the_microphone_is_told(
    visit: Visits, plane_waves: Any, heard: Path
) -> None:
    positions = np.array([[0, SPACING_M / 2, 0], [0, -SPACING_M / 2, 0]])
    array = MicrophoneArray("two", positions)
    soundfile.write(heard, plane_waves(array, [AZIMUTH_DEG], seconds=6.0).T, 16000)
    here = visit(view="#live")
    page = here.page
    page.click("text=Try this device")
    page.fill("#spacing", "5")
    page.click("#listen-here")
    api.expect(page.locator("#spacing")).to_be_focused()
    page.fill("#spacing", str(1000 * SPACING_M))
    page.click("#listen-here")
    api.expect(page.locator("#live-state")).to_have_text("Hearing this device's microphone.")
    page.wait_for_function(
        "azimuth => [...document.querySelectorAll('#live-sources li')]"
        ".some(entry => Math.abs(entry.dataset.azimuth - azimuth) <= 6)",
        arg=AZIMUTH_DEG,
    )
    api.expect(page.locator("#live-serious strong")).to_have_text("Front and back look alike")
    api.expect(page.locator("#sessions [aria-pressed=true] strong")).to_have_text(
        "browser-microphone"
    )
    page.click("#live-stop")
    api.expect(page.locator("#live-state")).to_contain_text("The session has ended after")
    api.expect(page.locator("#live-stop")).to_be_hidden()

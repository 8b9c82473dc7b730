"""The sky view, the side of all sources, and the array from its side, in a browser."""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import soundfile

from service.doa.array import MicrophoneArray
from service.doa.presets import preset

from .conftest import DESKTOP, keep_picture

expect = pytest.importorskip("playwright.sync_api", reason="needs playwright").expect
pytestmark = pytest.mark.page

Visits = Callable[..., Any]
TETRAHEDRON = MicrophoneArray(
    "tetrahedron", 0.018 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
)
PHONE = {"width": 390, "height": 844}


def recording(plane_waves: Any, array: MicrophoneArray, *places: tuple[float, float]) -> Any:
    """Talkers at azimuths and elevations in degrees, one after the other for two seconds each."""
    parts = [
        plane_waves(array, [azimuth], elevation_deg=elevation, seconds=2.0, seed=seed)
        for seed, (azimuth, elevation) in enumerate(places)
    ]
    file = io.BytesIO()
    soundfile.write(file, np.concatenate(parts, axis=1).T, 16000, format="WAV", subtype="PCM_16")
    return {"name": "elevated.wav", "mimeType": "audio/wav", "buffer": file.getvalue()}


def choose(here: Any, array: MicrophoneArray) -> None:
    here.page.click("#edit-array")
    here.page.click("#editor summary")
    here.page.fill("#json", json.dumps(array.positions.tolist()))


def place(here: Any, sky: str) -> tuple[float, float, float]:
    """Where the only mark of a sky is: right and down of the middle, and the horizon's radius."""
    circle = here.page.locator(f"{sky} .marks g circle")
    expect(circle).to_have_count(1)
    rim = here.page.locator(f"{sky} .rim").get_attribute("r")
    return float(circle.get_attribute("cx")), float(circle.get_attribute("cy")), float(rim)


@pytest.mark.parametrize(
    ("viewport", "scheme"), [(DESKTOP, "light"), (PHONE, "light"), (PHONE, "dark")]
)
def test_a_talker_above_is_seen_in_the_sky(
    visit: Visits, plane_waves: Any, viewport: Any, scheme: str
) -> None:
    here = visit(viewport, color_scheme=scheme)
    expect(here.page.locator("#sky")).to_be_hidden()
    choose(here, TETRAHEDRON)
    here.localize(recording(plane_waves, TETRAHEDRON, (90, 45)))
    expect(here.page.locator("#sky")).to_be_visible()
    # 45 degrees to the left is half way from the middle to the horizon, and left.
    right, down, rim = place(here, "#sky")
    assert (right, down) == pytest.approx((-rim / 2, 0), abs=0.05 * rim)
    picture = here.page.locator("#sky svg")
    expect(picture).to_have_attribute("aria-label", re.compile("left, 4[4-6]° up"))
    expect(here.page.locator("#sky .marks g")).to_have_class("above")
    assert here.page.locator("#sky .trail circle").count() > 2
    assert here.overflow() <= 0
    here.page.locator(".instrument >> nth=0").scroll_into_view_if_needed()
    keep_picture(here, f"page-sky-{viewport['width']}-{scheme}")


def test_a_talker_below_is_hollow_and_an_array_without_height_has_no_sky(
    visit: Visits, plane_waves: Any
) -> None:
    here = visit()
    square = preset("respeaker-usb-4mic-v2")
    below = recording(plane_waves, square, (0, -30))
    here.localize(below)
    expect(here.page.locator("#sky")).to_be_hidden()
    here.page.click("#setup details summary >> text=More options")
    here.page.select_option("#hemisphere", "lower")
    here.page.click("#localize")
    expect(here.page.locator("#sky")).to_be_visible()
    expect(here.page.locator("#sky .marks g")).to_have_class("below")
    right, down, rim = place(here, "#sky")
    assert math.hypot(right, down) == pytest.approx(rim * 60 / 90, abs=0.08 * rim)
    assert down < 0  # ahead is up
    here.page.select_option("#hemisphere", "")
    here.page.click("#localize")
    expect(here.page.locator("#sky")).to_be_hidden()


def test_a_stream_has_a_sky_too_and_its_trail_is_kept_for_who_comes_late(
    visit: Visits, plane_waves: Any
) -> None:
    here = visit()
    choose(here, TETRAHEDRON)
    here.page.set_input_files("#file", recording(plane_waves, TETRAHEDRON, (270, 60), (270, 60)))
    here.page.click("#replay")
    mark = here.page.locator("#live-sky .marks g.above")
    expect(mark).to_have_count(1)
    assert float(mark.get_attribute("data-elevation")) == pytest.approx(60, abs=12)
    expect(here.page.locator("#live-state")).to_contain_text("The session has ended after")
    late = visit(view="#live")
    late.page.click("#sessions button.ended >> nth=0")
    expect(late.page.locator("#live-sky")).to_be_visible()
    expect(late.page.locator("#live-sky .trail circle.above >> nth=4")).to_be_attached()


def test_an_array_with_height_is_drawn_from_its_side_as_it_is_edited(visit: Visits) -> None:
    here = visit()
    plots = here.page.locator("#array-plot svg")
    expect(plots).to_have_count(1)
    here.page.click("#edit-array")
    here.page.fill("[aria-label='Microphone 2, z in millimetres']", "60")
    expect(plots).to_have_count(2)
    side = here.page.locator("#array-plot svg[aria-label*='from its right side'] circle")
    expect(side).to_have_count(3)  # 0 and 3 are behind each other
    names = here.page.locator(
        "#array-plot svg[aria-label*='from its right side'] .microphones text"
    )
    assert names.all_text_contents() == ["0 3", "1", "2"]
    heights = [float(each.get_attribute("cy")) for each in side.all()]
    assert heights.index(min(heights)) == 2  # up is up
    assert [float(each.get_attribute("cx")) > 0 for each in side.all()] == [True, False, False]
    assert here.overflow() <= 0
    keep_picture(here, "page-array-side")

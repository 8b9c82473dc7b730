"""A newcomer in a browser; the test sees all that the page reports and requests.

``SCREENSHOTS=docs`` in the environment writes the pictures of the page into that folder.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

from service.doa.array import MicrophoneArray
from service.doa.scoring import circular_error

from .conftest import keep_picture

expect = pytest.importorskip("playwright.sync_api", reason="needs playwright").expect
pytestmark = pytest.mark.page

Visits = Callable[..., Any]
"""Function that opens the page, as the fixture ``visit`` does"""

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "examples" / "two-talkers.flac"
TALKERS_DEG = (45.0, 200.0)
PHONE = {"width": 390, "height": 844}


def assert_azimuths(found: list[float], expected: tuple[float, ...], within: float = 5.0) -> None:
    """Every expected direction is found, and no other."""
    errors = np.rad2deg(circular_error(np.deg2rad(found)[:, None], np.deg2rad(expected)))
    assert len(found) == len(expected), found
    assert errors.min(axis=0).max() <= within, found


def settle(here: Any) -> None:
    """Wait until the dial's spectrum has come to rest."""
    here.page.wait_for_function(
        "() => { const now = document.querySelector('#dial .spectrum').getAttribute('d');"
        " const same = now && now === window.before; window.before = now; return same; }"
    )


def test_the_sample_s_directions_are_read_off_the_page(visit: Visits) -> None:
    here = visit()
    here.localize(SAMPLE)
    assert_azimuths(here.azimuths(), TALKERS_DEG)
    assert_azimuths(here.azimuths("#window-sources .azimuth"), TALKERS_DEG, within=8)
    for sure in here.page.locator("#window-sources .sure").all_inner_texts():
        assert 50 <= int(sure.removesuffix(" % sure")) <= 99
    expect(here.page.locator("#file-facts")).to_contain_text("FLAC · 4 channels · 16 kHz")
    expect(here.page.locator("#warnings-section")).to_be_hidden()
    settle(here)
    keep_picture(here, "page-recording")


def test_the_needles_point_to_where_the_sound_is(visit: Visits) -> None:
    here = visit()
    here.localize(SAMPLE)
    face = here.page.locator("#dial .face").bounding_box()
    middle = (face["x"] + face["width"] / 2, face["y"] + face["height"] / 2)
    drawn = []
    for chip in here.page.locator("#dial .chip").all():
        box = chip.bounding_box()
        right = box["x"] + box["width"] / 2 - middle[0]
        down = box["y"] + box["height"] / 2 - middle[1]
        drawn.append(math.degrees(math.atan2(-right, -down)))  # ahead is up, left is left
    assert_azimuths(drawn, TALKERS_DEG, within=8)


def test_the_scene_made_in_the_browser_is_localized(visit: Visits) -> None:
    here = visit()
    here.page.select_option("#array", "minidsp-uma8")
    here.page.click("#sample")
    expect(here.page.locator("#setup-status")).to_contain_text("Found")
    assert_azimuths(here.azimuths(), TALKERS_DEG)


def test_an_array_that_is_described_as_turned_turns_the_directions(
    visit: Visits, square: MicrophoneArray
) -> None:
    here = visit()
    here.page.click("#edit-array")
    here.page.click("text=As JSON")
    turned = square.rotated(np.deg2rad(90)).positions.tolist()
    here.page.fill("#json", json.dumps({"positions_m": turned}))
    expect(here.page.locator("#array-facts")).to_contain_text("64.6 mm")
    here.localize(SAMPLE)
    assert_azimuths(here.azimuths(), (135.0, 290.0))


def test_positions_are_edited_in_millimetres(visit: Visits) -> None:
    here = visit()
    page = here.page
    page.click("#edit-array")
    page.fill("#ring-count", "3")
    page.fill("#ring-radius", "50")
    page.click("text=Make a ring")
    # The side of an equilateral triangle is its circumradius times the square root of 3.
    expect(page.locator("#array-facts")).to_contain_text("86.6 mm")
    page.fill("[aria-label='Microphone 0, x in millimetres']", "-25")
    expect(page.locator("#array-hints")).to_contain_text("one line")
    page.fill("[aria-label='Microphone 0, x in millimetres']", "")
    expect(page.locator("#array-hints")).to_contain_text("three numbers")
    page.set_input_files("#file", SAMPLE)
    page.click("#localize")
    expect(page.locator("#setup-status")).to_have_text("Microphone 0 needs a number for x.")
    wrong = page.locator("#setup [aria-invalid=true]")
    expect(wrong).to_be_focused()
    expect(wrong).to_have_attribute("aria-label", "Microphone 0, x in millimetres")
    page.click("[aria-label='Remove microphone 0']")
    assert json.loads(page.input_value("#json")) == [
        [-0.025, pytest.approx(0.0433013), 0],
        [-0.025, pytest.approx(-0.0433013), 0],
    ]
    here.page.reload()  # and it is remembered
    expect(page.locator("#array")).to_have_value("custom")
    expect(page.locator("#array-facts")).to_contain_text("86.6 mm")


def test_the_channels_of_a_known_device_are_proposed(
    visit: Visits, square: MicrophoneArray, plane_waves: Any, tmp_path: Path
) -> None:
    path = tmp_path / "device.wav"
    microphones = plane_waves(square, [77.0], seconds=3.0)
    other = np.zeros_like(microphones[:1])
    recording = np.concatenate([other, microphones, other])  # processed, raw 1 to 4, playback
    soundfile.write(path, recording.T, 16000, subtype="PCM_24")
    here = visit()
    here.page.set_input_files("#file", path)
    expect(here.page.locator("#file-facts")).to_contain_text("WAV · 6 channels · 16 kHz · 3.0 s")
    expect(here.page.locator("#channel-map")).to_have_value("1,2,3,4")
    here.localize(path)
    assert_azimuths(here.azimuths(), (77.0,))


def test_what_the_service_refuses_is_said_in_its_own_words(visit: Visits, tmp_path: Path) -> None:
    path = tmp_path / "stereo.wav"
    soundfile.write(path, np.full((16000, 2), 0.1), 16000)
    here = visit()
    here.refusals = 1
    here.page.set_input_files("#file", path)
    expect(here.page.locator("#channel-note")).to_contain_text("is it another array?")
    with here.page.expect_response("**/localize") as answered:
        here.page.click("#localize")
    problem = answered.value.json()
    assert problem["code"] == "channel_mismatch"
    expect(here.page.locator("#problem .detail")).to_have_text(problem["detail"])


def test_what_is_shown_belongs_to_what_is_chosen(visit: Visits) -> None:
    here = visit()
    page = here.page
    here.localize(SAMPLE)
    page.select_option("#method", "method:srp_phat")
    expect(page.locator("#stale")).to_be_visible()
    page.select_option("#method", "")
    expect(page.locator("#stale")).to_be_hidden()
    here.refusals = 1
    page.select_option("#array", "minidsp-uma8")
    page.click("#localize")
    expect(page.locator("#problem code")).to_have_text("channel_mismatch")
    for gone in ("#dial", "#answer", "#stale"):
        expect(page.locator(gone)).to_be_hidden()
    page.select_option("#array", "respeaker-usb-4mic-v2")
    expect(page.locator("#problem")).to_be_hidden()
    expect(page.locator("#dial")).to_be_visible()
    here.localize(SAMPLE)
    page.set_input_files("#file", {"name": "other.wav", "mimeType": "", "buffer": b"RIFF"})
    expect(page.locator("#answer")).to_be_hidden()
    expect(page.locator("#dial .chip")).to_have_count(0)
    expect(page.locator("#window-sources li")).to_have_count(0)


def test_no_confidence_is_shown_as_certain(visit: Visits) -> None:
    words = (
        "import('./static/words.js').then(({ percent }) => [0.05, 0.946, 0.999, 1].map(percent))"
    )
    assert visit().page.evaluate(words) == ["5 %", "95 %", "99 %", "99 %"]


def test_fields_with_numbers_that_cannot_be_are_marked(visit: Visits) -> None:
    page = visit().page
    page.set_input_files("#file", SAMPLE)
    page.fill("#channel-map", "0,1,2,9")
    page.click("#localize")
    expect(page.locator("#setup-status")).to_have_text(
        "There is no channel 9: the recording has 0 to 3."
    )
    page.fill("#channel-map", "0,1,2,3")
    page.click("text=More options")
    page.fill("#window-s", "50")
    page.click("#localize")
    expect(page.locator("#setup-status")).to_have_text("This takes 0.128 to 10 seconds.")
    expect(page.locator("#window-s")).to_be_focused()


def test_models_are_offered_by_what_they_are_for(visit: Visits) -> None:
    method = visit().page.locator("#method")
    use = method.locator("> option").all_inner_texts()
    compare = method.locator("optgroup").get_attribute("label")
    assert [text.split()[0] for text in use] == ["Automatic:", "any-array"]
    assert compare == "To compare with"
    assert method.locator("optgroup option").last.inner_text().startswith("paper ")


def test_what_is_wrong_with_a_recording_is_said(
    visit: Visits, square: MicrophoneArray, plane_waves: Any, tmp_path: Path
) -> None:
    path = tmp_path / "dead.wav"
    recording = plane_waves(square, [77.0], seconds=2.0)
    recording[2] = 0.0
    soundfile.write(path, recording.T, 16000)
    here = visit()
    here.localize(path)
    beside = here.page.locator(".readout #window-warnings")
    expect(beside.locator("strong")).to_have_text("A microphone is silent")
    expect(beside.locator("span")).to_contain_text("2")
    expect(here.page.locator("#warnings-section")).to_be_hidden()


def test_a_dropped_file_is_taken_and_its_name_is_no_markup(visit: Visits) -> None:
    here = visit()
    name = "<img src=x onerror=alert(1)>.wav"
    transfer = here.page.evaluate_handle(
        "name => { const t = new DataTransfer();"
        " t.items.add(new File(['RIFF'], name)); return t; }",
        name,
    )
    here.page.dispatch_event("#content", "drop", {"dataTransfer": transfer})
    expect(here.page.locator("#file-name")).to_have_text(name)
    here.refusals = 1
    here.page.click("#localize")
    expect(here.page.locator("#problem")).to_contain_text("not_audio")


def test_the_dial_follows_what_is_heard(visit: Visits) -> None:
    here = visit()
    here.localize(SAMPLE)
    here.page.focus("#timeline")
    here.page.keyboard.press("Home")
    here.page.click("#listen")
    expect(here.page.locator("#listen")).to_have_text("Pause")
    expect(here.page.locator("#timeline")).to_have_attribute("aria-valuenow", "2")
    here.page.click("#listen")
    expect(here.page.locator("#listen")).to_have_text("Listen")


def test_the_answer_can_be_downloaded(visit: Visits, tmp_path: Path) -> None:
    here = visit()
    with here.page.expect_response("**/localize") as answered:
        here.localize(SAMPLE)
    saved = {}
    for kind in ("json", "csv"):
        with here.page.expect_download() as download:
            here.page.click(f"#download-{kind}")
        assert download.value.suggested_filename == f"two-talkers.directions.{kind}"
        saved[kind] = tmp_path / kind
        download.value.save_as(saved[kind])
    answer = answered.value.json()
    assert json.loads(saved["json"].read_text()) == answer
    with saved["csv"].open(newline="") as file:
        rows = [
            (float(row["t_start"]), float(row["azimuth_deg"]), float(row["confidence"]))
            for row in csv.DictReader(file)
        ]
    assert rows == [
        (window["t_start"], source["azimuth_deg"], source["confidence"])
        for window in answer["windows"]
        for source in window["sources"]
    ]


def test_the_keyboard_is_enough(visit: Visits) -> None:
    here = visit()
    page = here.page
    for _ in range(30):  # from the top of the page to the scene's button
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.id") == "sample":
            break
    page.keyboard.press("Enter")
    expect(page.locator("#setup-status")).to_contain_text("Found")
    for _ in range(40):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.id") == "timeline":
            break
    page.keyboard.press("Home")
    expect(page.locator("#window-title")).to_contain_text("0.00 to")
    slider = page.locator("#timeline")
    expect(slider).to_have_attribute("aria-valuenow", "0")
    page.keyboard.press("ArrowRight")
    expect(slider).to_have_attribute("aria-valuenow", "1")
    page.keyboard.press("End")
    expect(slider).to_have_attribute("aria-valuenow", slider.get_attribute("aria-valuemax"))
    page.focus("#tab-recording")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#tab-live")).to_be_focused()
    expect(page.locator("#live")).to_be_visible()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_shows_everything_without_scrolling_sideways(visit: Visits, scheme: str) -> None:
    here = visit(PHONE, color_scheme=scheme, has_touch=True)
    here.localize(SAMPLE)
    assert_azimuths(here.azimuths(), TALKERS_DEG)
    assert here.overflow() <= 0
    here.page.click("#edit-array")
    assert here.overflow() <= 0
    assert contrast(here) >= 4.5
    if scheme == "dark":
        here.page.locator("#dial").evaluate("dial => dial.scrollIntoView()")
        settle(here)
        keep_picture(here, "page-phone-dark")


def contrast(here: Any) -> float:
    """Least contrast (WCAG 2) of the text colours on the paper."""
    names = ["paper", "ink", "quiet", "accent", "alarm", *(f"source-{n}" for n in range(6))]
    colours = here.page.evaluate(
        "names => names.map(name => "
        "getComputedStyle(document.documentElement).getPropertyValue('--' + name).trim())",
        names,
    )

    def luminance(colour: str) -> float:
        value = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)]) / 255
        linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    paper, *others = map(luminance, colours)
    return min((max(paper, x) + 0.05) / (min(paper, x) + 0.05) for x in others)


def source_near(here: Any, azimuth: float) -> str:
    """The id of the live source at an azimuth, as soon as the page shows one."""
    found = here.page.wait_for_function(
        "azimuth => [...document.querySelectorAll('#live-sources li')]"
        ".find(entry => Math.abs(entry.dataset.azimuth - azimuth) <= 5)?.dataset.id",
        arg=azimuth,
    )
    return str(found.json_value())


def test_a_recording_is_replayed_as_a_stream_that_others_watch(
    visit: Visits, tmp_path: Path
) -> None:
    path = tmp_path / "two-talkers.wav"
    soundfile.write(path, *soundfile.read(SAMPLE))
    here, watcher = visit(), visit(view="#live")
    here.page.set_input_files("#file", path)
    here.page.click("#replay")
    expect(here.page.locator("#live-state")).to_have_text("Replaying two-talkers.wav.")
    first = source_near(here, TALKERS_DEG[0])

    watcher.page.click("#sessions button.running")
    assert source_near(watcher, TALKERS_DEG[0]) == first
    second = source_near(here, TALKERS_DEG[1])
    assert source_near(watcher, TALKERS_DEG[1]) == second
    assert first != second
    for page in (here.page, watcher.page):
        expect(page.locator("#live-facts")).to_contain_text("any-array")
    both_talk = "() => document.querySelector('#live-title').textContent >= 'Now, 7'"
    here.page.wait_for_function(both_talk)
    keep_picture(here, "page-live")

    over = "The session has ended after 8."
    expect(here.page.locator("#live-state")).to_contain_text(over, timeout=20_000)
    expect(watcher.page.locator("#live-state")).to_contain_text(over)
    with watcher.page.expect_download() as download:
        watcher.page.click("#live-exports a >> nth=0")
    rows = list(csv.DictReader(download.value.path().read_text().splitlines()))
    assert {first, second} <= {row["id"] for row in rows}


def test_a_stream_is_stopped_and_what_was_heard_stays(visit: Visits) -> None:
    here = visit()
    here.page.click("#sample")
    expect(here.page.locator("#setup-status")).to_contain_text("Found")
    here.page.click("#replay")
    source_near(here, TALKERS_DEG[0])
    here.page.click("#live-stop")
    expect(here.page.locator("#live-state")).to_contain_text("The session has ended after")
    expect(here.page.locator("#live-stop")).to_be_hidden()
    here.page.click("#sessions button.ended >> nth=0")
    expect(here.page.locator("#live-state")).to_have_text(
        "This session has ended; its last minute is shown."
    )

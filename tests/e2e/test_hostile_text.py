"""Text of others in the page is text, its policy runs no other script, and both hold behind TLS."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import soundfile
from running_service import serving
from tls_front import new_certificate, tls_before

from neuralmusic import StreamClient
from neuralmusic.protocol.server_messages import StreamError, StreamWarning
from service.doa.array import MicrophoneArray

from .test_live_page import SESSION, events, ready, result, script_sessions, source

expect = pytest.importorskip("playwright.sync_api", reason="needs playwright").expect
pytestmark = [
    pytest.mark.page,
    pytest.mark.skipif(not shutil.which("openssl"), reason="needs openssl for a certificate"),
]

Visits = Callable[..., Any]
SAMPLE = Path(__file__).parents[2] / "examples" / "two-talkers.flac"
MARKUP = """"'><img src=x onerror=window.ran=1><svg onload=window.ran=1>"""
"""An array's label has at most 64 characters"""
RAN = """() => [window.ran, document.querySelectorAll('img').length, document.scripts.length,
  [...document.querySelectorAll('*')].filter((e) => e.getAttributeNames().some(
    (name) => name.startsWith('on'))).length]"""
"""What markup would leave behind, were it read as markup"""
NOTHING = [None, 1, 1, 0]
"""The page itself has one picture, one script and no handler in its markup"""

TRY_SCRIPTS = """(markup) => new Promise((over) => {
  const blocked = [];
  setTimeout(over, 10000, blocked);  // what was not blocked is not told
  document.addEventListener("securitypolicyviolation", ({ blockedURI }) => {
    blocked.push(blockedURI);
    if (blocked.length === 4) over(blocked);
  });
  const append = (tag, fields) =>
    document.body.appendChild(Object.assign(document.createElement(tag), fields));
  document.body.insertAdjacentHTML("beforeend", markup);
  append("script", { textContent: "window.ran = 1" });
  append("script", { src: "https://127.0.0.1:9/other.js" });
  append("a", { href: "javascript:window.ran = 1" }).click();
})"""
"""Run scripts in every way; what the policy blocked"""


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return new_certificate(tmp_path_factory.mktemp("tls"))


@pytest.fixture(scope="module")
def url(certificate: Path) -> Iterator[str]:
    """A service behind TLS."""
    with serving() as address, tls_before(address, certificate) as https:
        yield https


def trusting(visit: Visits, **how: Any) -> Any:
    return visit(ignore_https_errors=True, **how)


def test_behind_tls_the_page_localizes_streams_and_watches(visit: Visits, tmp_path: Path) -> None:
    """Its origin is the https one, its WebSocket a secure one, and the policy allows both."""
    here = trusting(visit)
    here.localize(SAMPLE)
    assert len(here.azimuths()) == 2
    samples, rate = soundfile.read(SAMPLE, dtype="int16")
    soundfile.write(tmp_path / "short.wav", samples[:rate], rate)
    sockets: list[str] = []
    here.page.on("websocket", lambda socket: sockets.append(socket.url))
    here.page.set_input_files("#file", tmp_path / "short.wav")
    here.page.click("#replay")
    expect(here.page.locator("#live-state")).to_contain_text("ended")
    assert sockets == [here.url.replace("https://", "wss://") + "/stream"]
    here.page.click("#sessions button.ended >> nth=0")
    expect(here.page.locator("#live-state")).to_contain_text("its last minute is shown")


def test_the_policy_runs_no_script_but_the_page_s_own(visit: Visits) -> None:
    here = trusting(visit)
    kinds = here.page.evaluate(TRY_SCRIPTS, MARKUP)
    assert here.page.evaluate("window.ran") is None
    assert sorted(kinds) == ["https://127.0.0.1:9/other.js", "inline", "inline", "inline"]
    here.refusals = 1  # the picture
    here.complaints = [each for each in here.complaints if "Content Security Policy" not in each]
    here.elsewhere.clear()  # it was not sent


def test_labels_of_running_streams_and_names_of_files_are_text(
    visit: Visits, square: MicrophoneArray, monkeypatch: pytest.MonkeyPatch, certificate: Path
) -> None:
    """Without the policy, which would hide that text was read as markup."""
    here = trusting(visit, bypass_csp=True)
    page, positions = here.page, square.positions.tolist()
    script = json.dumps({"name": MARKUP, "positions_m": positions})
    page.click("#edit-array")
    page.click("text=As JSON")
    page.fill("#json", script)
    page.set_input_files(
        "#file", {"name": f"{MARKUP}.flac", "mimeType": "audio/flac", "buffer": SAMPLE.read_bytes()}
    )
    expect(page.locator("body")).to_contain_text(f"{MARKUP}.flac")
    page.click("#localize")
    page.locator("#setup-status", has_text="Found").wait_for()
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    audio = {"encoding": "pcm_s16le", "sample_rate": 16_000, "channels": 4}
    with StreamClient(here.url, array={"name": MARKUP, "positions_m": positions}, audio=audio):
        page.click("#tab-live")
        expect(page.locator("#sessions")).to_contain_text(MARKUP)
        page.click("#sessions button.running")
        expect(page.locator("#live-facts")).to_contain_text(MARKUP)
        assert page.evaluate(RAN) == NOTHING


def test_whatever_a_service_says_is_text(visit: Visits, square: MicrophoneArray) -> None:
    """Also what only a service that lies could say."""
    said = {"client": MARKUP, "array": MARKUP, "model": MARKUP, "id": MARKUP}
    stream = events(
        ready(replace(square, name=MARKUP)),
        result(1, source(7, 45.0)),
        StreamWarning.model_construct(seq=2, code=MARKUP, detail=MARKUP, channels=(1,)),
        StreamError.model_construct(seq=3, code=MARKUP, title=MARKUP, detail=MARKUP),
    )
    here = trusting(visit, bypass_csp=True)
    page = here.page
    script_sessions(page, [{**SESSION, **said}], stream)
    page.click("#tab-live")
    expect(page.locator("#sessions strong")).to_have_text(MARKUP)
    page.click("#sessions button")
    expect(page.locator("#live-serious span")).to_have_text(MARKUP)
    expect(page.locator("#live-problem .detail")).to_have_text(MARKUP)
    problem = {"title": MARKUP, "detail": MARKUP, "code": MARKUP}
    page.route("**/localize", lambda route: route.fulfill(status=422, json=problem))
    page.click("#tab-recording")
    page.set_input_files("#file", SAMPLE)
    page.click("#localize")
    expect(page.locator("#problem .detail")).to_have_text(MARKUP)
    here.refusals = 1
    assert page.evaluate(RAN) == NOTHING

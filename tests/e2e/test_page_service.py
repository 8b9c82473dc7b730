"""The page while its service starts, goes and comes back."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

expect = pytest.importorskip("playwright.sync_api", reason="needs playwright").expect
pytestmark = pytest.mark.page

Visits = Callable[..., Any]
"""Function that opens the page, as the fixture ``visit`` does"""

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "examples" / "two-talkers.flac"


def test_the_header_tells_when_the_service_is_gone_and_when_it_is_back(visit: Visits) -> None:
    here = visit()
    page, health = here.page, here.page.locator("#health")
    page.clock.install()
    page.reload()
    expect(health).to_contain_text("ready ·")
    page.fill("#channel-map", "3,2,1,0")
    here.refusals = 2
    page.route("**/readyz", lambda route: route.fulfill(status=503, json={}), times=1)
    page.clock.fast_forward(6000)
    expect(health).to_have_text("not ready")
    page.clock.fast_forward(3000)
    expect(health).to_contain_text("ready ·")
    page.route("**/localize", lambda route: route.abort(), times=1)
    page.set_input_files("#file", SAMPLE)
    page.click("#localize")
    expect(health).to_have_text("no answer")
    page.clock.fast_forward(3000)
    expect(health).to_contain_text("ready ·")


def test_the_api_s_page_asks_no_other_host(visit: Visits) -> None:
    page = visit().page
    page.click("footer a >> text=API")
    expect(page.locator("#operations-localization-localize")).to_be_visible()


def test_a_page_that_is_opened_too_early_waits_for_the_service(visit: Visits) -> None:
    here = visit()
    here.refusals = 1
    problem = {"title": "Not ready", "detail": "the models are being loaded", "code": "not_ready"}
    here.page.route("**/models", lambda route: route.fulfill(status=503, json=problem), times=1)
    here.page.reload()
    expect(here.page.locator("#problem .detail")).to_have_text(problem["detail"])
    expect(here.page.locator("#health")).to_contain_text("ready ·")
    expect(here.page.locator("#problem")).to_be_hidden()

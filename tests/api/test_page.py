"""The web page: who gets it, how it is served, and that its files hang together."""

from __future__ import annotations

import re
import zipfile
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, get_args

import pytest
from fastapi.testclient import TestClient

from neuralmusic.protocol.server_messages import WarningCode
from service.api.page import asks_for_page
from service.doa.diagnostics.finding import FindingCode

ROOT = Path(__file__).parents[2]
STATIC = ROOT / "service" / "static"
FILES = sorted(path.name for path in STATIC.iterdir())
BROWSER = "text/html,application/xhtml+xml,application/xml;q=0.9,image/avif,image/webp,*/*;q=0.8"


@pytest.mark.parametrize(
    ("accept", "page"),
    [
        (BROWSER, True),
        ("text/html", True),
        ("TEXT/HTML; charset=utf-8", True),
        ("application/json;q=0.5, text/html;q=0.9", True),
        ("*/*", False),
        ("", False),
        ("application/json", False),
        ("application/json, text/html;q=0.9", False),
        ("text/html;q=0", False),
        ("text/html;q=nonsense", False),
        ("image/png, */*", False),
    ],
)
def test_who_is_asking_for_the_page(accept: str, page: bool) -> None:
    assert asks_for_page(accept) is page


def test_a_browser_gets_the_page_and_a_program_the_signpost(client: TestClient) -> None:
    page = client.get("/", headers={"Accept": BROWSER})
    assert page.headers["content-type"] == "text/html; charset=utf-8"
    assert page.text.startswith("<!doctype html>")
    signpost = client.get("/", headers={"Accept": "*/*"})
    assert signpost.headers["content-type"] == "application/json"
    assert signpost.json()["links"]["localize"] == "/localize"
    # A cache between them must not give one what the other got.
    assert page.headers["vary"] == signpost.headers["vary"] == "Accept"


@pytest.mark.parametrize("path", ["/", *(f"/static/{name}" for name in FILES)])
def test_every_file_is_served_safely(client: TestClient, path: str) -> None:
    headers = client.get(path, headers={"Accept": BROWSER}).headers
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["cache-control"] == "no-cache"
    policy = dict(
        directive.strip().split(" ", 1)
        for directive in headers["content-security-policy"].split(";")
    )
    assert policy["default-src"] == "'self'"
    assert policy["connect-src"] == "'self' ws: wss:"
    assert "unsafe" not in headers["content-security-policy"]


def test_the_api_s_page_is_whole_without_the_internet(client: TestClient) -> None:
    answer = client.get("/docs", headers={"Accept": BROWSER})
    policy = answer.headers["content-security-policy"]
    assert "default-src 'self'" in policy
    assert "unsafe" not in policy
    parser = Page()
    parser.feed(answer.text)
    assert parser.blocked == []
    assert {"static/swagger-ui.css", "static/swagger-ui-bundle.js"} <= set(parser.references)
    for reference in parser.references:
        assert client.get(f"/{reference}").status_code == 200, reference


def test_the_types_are_those_that_browsers_run(client: TestClient) -> None:
    types = {
        "main.js": "text/javascript; charset=utf-8",
        "style.css": "text/css; charset=utf-8",
        "icon.svg": "image/svg+xml",
        "index.html": "text/html; charset=utf-8",
    }
    for name, media_type in types.items():
        assert client.get(f"/static/{name}").headers["content-type"] == media_type
    assert {Path(name).suffix for name in FILES} == {Path(name).suffix for name in types}


@pytest.mark.parametrize("path", ["/", "/static/main.js"])
def test_a_copy_that_is_current_is_not_sent_again(client: TestClient, path: str) -> None:
    first = client.get(path, headers={"Accept": BROWSER})
    known = {"Accept": BROWSER, "If-None-Match": f'"other", W/{first.headers["etag"]}'}
    again = client.get(path, headers=known)
    assert (again.status_code, again.content) == (304, b"")
    assert again.headers["etag"] == first.headers["etag"]
    assert "content-security-policy" in again.headers
    stale = client.get(path, headers={"Accept": BROWSER, "If-None-Match": '"other"'})
    assert (stale.status_code, stale.content) == (200, first.content)


def test_files_have_tags_of_their_own(client: TestClient) -> None:
    tags = {client.get(f"/static/{name}").headers["etag"] for name in FILES}
    assert len(tags) == len(FILES)


@pytest.mark.parametrize("path", ["/", "/static/style.css"])
@pytest.mark.parametrize("accept", [BROWSER, "*/*"])
def test_head_tells_what_get_would(client: TestClient, path: str, accept: str) -> None:
    headers = {"Accept": accept, "X-Request-ID": "the-same"}
    got, head = client.get(path, headers=headers), client.head(path, headers=headers)
    assert head.status_code == 200
    assert head.content == b""
    assert head.headers == got.headers


@pytest.mark.parametrize(
    "path",
    [
        "/static/",
        "/static/nothing.js",
        "/static/../app.py",
        "/static/%2e%2e/app.py",
        "/static/..%2fapp.py",
        "/static/%2e%2e%2fsettings.py",
        "/static//etc/passwd",
        "/static/..%5capp.py",
        "/static/main.js%00.css",
    ],
)
def test_nothing_but_the_page_s_files_is_there(client: TestClient, path: str) -> None:
    response = client.get(path, headers={"Accept": BROWSER})
    assert response.status_code == 404
    assert response.headers["content-type"] == "application/problem+json"
    assert response.json()["code"] == "not_found"


def test_another_method_is_refused(client: TestClient) -> None:
    response = client.post("/static/main.js")
    assert response.status_code == 405
    assert response.json()["code"] == "method_not_allowed"


class Page(HTMLParser):
    """What a page refers to, and what its policy would block."""

    def __init__(self) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.references: list[str] = []
        self.targets: list[str] = []
        self.blocked: list[str] = []
        self._in_script = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.ids += [given["id"]] if "id" in given else []
        self.references += [given[name] for name in ("src", "href") if name in given]
        for name in ("for", "aria-controls", "aria-labelledby", "aria-describedby"):
            self.targets += given.get(name, "").split()
        inline = tag == "style" or (tag == "script" and "src" not in given)
        handlers = [name for name in given if name.startswith("on") or name == "style"]
        self.blocked += handlers + ([tag] if inline else [])


def test_every_warning_has_words_on_the_page() -> None:
    words = (STATIC / "words.js").read_text()
    for code in {*get_args(WarningCode), *get_args(FindingCode)}:
        assert re.search(rf"^  {code}: \"", words, re.MULTILINE), code


@pytest.fixture(scope="module")
def page() -> Page:
    parser = Page()
    parser.feed((STATIC / "index.html").read_text())
    return parser


def test_the_policy_blocks_nothing_of_the_page(page: Page) -> None:
    assert page.blocked == []
    assert not any("//" in reference for reference in page.references)


def test_what_the_page_refers_to_is_there(client: TestClient, page: Page) -> None:
    assert len(set(page.ids)) == len(page.ids)
    assert set(page.targets) <= set(page.ids)
    for reference in page.references:
        if reference.startswith("#"):
            assert reference[1:] in page.ids
        else:
            assert client.get(f"/{reference.removeprefix('./')}").status_code == 200, reference


def test_modules_name_files_and_elements_that_exist(page: Page) -> None:
    made_by_modules = set()
    for module in STATIC.glob("*.js"):
        source = module.read_text()
        for imported in re.findall(r'from "([^"]+)"', source):
            assert imported.startswith("./"), f"{module.name} imports {imported}"
            assert (STATIC / imported).exists(), f"{module.name} imports {imported}"
        made_by_modules |= set(re.findall(r'\bid: "([^"]+)"', source))
    for module in STATIC.glob("*.js"):
        for name in re.findall(r'byId\("([^"]+)"\)', module.read_text()):
            assert name in {*page.ids, *made_by_modules}, f"{module.name} looks for #{name}"


@pytest.mark.parametrize("name", FILES)
def test_no_file_reads_text_as_markup_or_leaves_the_service(name: str) -> None:
    source = (STATIC / name).read_text()
    for word in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval("):
        assert word not in source
    elsewhere = set(re.findall(r"(?:https?:)?//[\w.-]+\.\w+", source))
    assert elsewhere <= {"http://www.w3.org"}  # the name space of SVG, never fetched


def test_the_wheel_carries_every_file(tmp_path: Path) -> None:
    builder: Any = pytest.importorskip("hatchling.builders.wheel").WheelBuilder(str(ROOT))
    (wheel,) = builder.build(directory=str(tmp_path), versions=["standard"])
    with zipfile.ZipFile(wheel) as archive:
        carried = {Path(name).name for name in archive.namelist() if "service/static/" in name}
    assert carried == set(FILES)

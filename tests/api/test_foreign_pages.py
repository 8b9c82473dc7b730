"""Pages of others, in the browser of somebody who can reach the service: what they may not do.

The requests are those that browsers send of themselves: ``Origin`` on everything that is no plain
GET, and ``Host`` as the address has it, whatever that name resolves to.
"""

from __future__ import annotations

import asyncio
import io
from collections.abc import Iterator
from contextlib import suppress
from ipaddress import ip_address

import httpx2
import pytest
from fastapi.testclient import TestClient
from hypothesis import given
from hypothesis import strategies as st
from running_service import RunningService
from starlette.datastructures import Headers

from neuralmusic.errors import HostRefused, OriginRefused
from service.access.key_file import new_token, token_sha256
from service.api.middleware.hosts import check_host, host_name
from service.api.middleware.origins import check_origin
from service.app import create_app
from service.inference.registry import BundleRegistry
from service.settings import Settings

EVIL = "http://evil.example"
LOCAL = {"server": ("127.0.0.1", 8000)}
REMOTE = {"server": ("192.168.1.5", 8000)}


@pytest.fixture(scope="module")
def client() -> TestClient:
    settings = Settings(origins=("https://dash.example", "https://slash.example/"))
    return TestClient(create_app(settings, BundleRegistry(())))


@pytest.fixture(scope="module")
def service() -> Iterator[RunningService]:
    running = RunningService()
    yield running
    running.stop()


UNSAFE = [
    ("POST", "/localize"),
    ("PUT", "/noise/x"),
    ("DELETE", "/noise/x"),
    ("POST", "/admin/reload"),
    ("POST", "/nothing"),
    ("PATCH", "/models"),
]


@pytest.mark.parametrize(("method", "path"), UNSAFE)
@pytest.mark.parametrize("origin", [EVIL, "null", "http://testserver.evil.example", "http://["])
def test_a_foreign_page_changes_nothing(
    method: str, path: str, origin: str, client: TestClient
) -> None:
    """A form of multipart/form-data or text/plain needs no preflight, so browsers send it."""
    answer = client.request(method, path, headers={"Origin": origin}, content=b"x")
    assert (answer.status_code, answer.json()["code"]) == (403, "origin_refused")


@pytest.mark.parametrize(
    "origin", ["http://testserver", "https://dash.example", "https://slash.example", None]
)
def test_the_own_page_listed_ones_and_programs_may(origin: str | None, client: TestClient) -> None:
    headers = {"Origin": origin} if origin else {}
    answer = client.delete("/noise/none", headers=headers)
    assert answer.json()["code"] == "not_found"


def test_reading_is_left_to_the_browser_which_shows_foreign_pages_nothing(
    client: TestClient,
) -> None:
    answer = client.get("/sessions", headers={"Origin": EVIL})
    assert answer.status_code == 200
    assert "access-control-allow-origin" not in answer.headers
    preflight = client.options(
        "/noise/x", headers={"Origin": EVIL, "Access-Control-Request-Method": "PUT"}
    )
    assert preflight.status_code == 405
    assert "access-control-allow-origin" not in preflight.headers


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8000", "127.0.0.1.nip.io", "a.b."])
def test_a_name_bound_anew_to_loopback_gets_nothing(host: str, service: RunningService) -> None:
    """DNS rebinding: the page's origin is the service's own, only the host tells."""
    headers = {"Host": host, "Origin": f"http://{host}"}
    for method, path in [("GET", "/sessions"), ("POST", "/localize"), ("GET", "/livez")]:
        answer = httpx2.request(method, f"{service.url}{path}", headers=headers)
        assert (answer.status_code, answer.json()["code"]) == (421, "host_refused")


def test_a_stream_of_a_name_bound_anew_is_refused(service: RunningService) -> None:
    lines = [
        "GET /stream HTTP/1.1",
        "Host: evil.example",
        "Origin: http://evil.example",
        "Upgrade: websocket",
        "Connection: Upgrade",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Protocol: doa.v1",
    ]

    async def ask() -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", service.port)
        async with asyncio.timeout(20):
            writer.write(("\r\n".join(lines) + "\r\n\r\n").encode())
            line = await reader.readline()
        writer.close()
        return line

    assert asyncio.run(ask()).startswith(b"HTTP/1.1 421")


@pytest.mark.parametrize(
    "host", ["localhost", "LOCALHOST:8000", "doa.localhost", "127.0.0.1:1", "[::1]:8000", "robot"]
)
def test_this_machines_own_names_and_addresses_are_good(host: str, service: RunningService) -> None:
    assert httpx2.get(f"{service.url}/livez", headers={"Host": host}).status_code == 200


def test_names_of_the_settings_are_the_only_ones() -> None:
    for scope in (LOCAL, REMOTE):
        check_host(scope, "doa.example:443", ("doa.example",))
        with pytest.raises(HostRefused):
            check_host(scope, "evil.example", ("doa.example",))
        check_host(scope, "evil.example", ("*",))


def test_from_the_network_any_name_is_good_unless_names_are_given() -> None:
    check_host(REMOTE, "robot.lan", ())
    check_host({}, "robot.lan", ())
    check_host({"server": ("/run/doa.sock", None)}, "robot.lan", ())


def test_a_service_with_keys_behind_a_proxy_of_its_machine_takes_the_proxys_name(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """A page of another name has no key, so nothing is gained by refusing it."""
    path = tmp_path_factory.mktemp("keys") / "keys"
    token = new_token()
    path.write_text(f'{{"name": "a", "sha256": "{token_sha256(token)}", "roles": ["watch"]}}')
    path.chmod(0o600)
    app = create_app(Settings(keys=path), BundleRegistry(()))
    client = TestClient(app, base_url="http://127.0.0.1:8000")
    headers = {"Host": "doa.example", "Authorization": f"Bearer {token}"}
    assert client.get("/sessions", headers=headers).status_code == 200
    for host, status in (("127.0.0.1", 421), ("localhost", 421), ("0.0.0.0", 200)):
        bare = create_app(Settings(host=host), BundleRegistry(()))
        asked = TestClient(bare, base_url="http://127.0.0.1:8000").get("/sessions", headers=headers)
        assert asked.status_code == status


@given(st.text(st.characters(max_codepoint=255)))
def test_no_host_or_origin_raises_anything_but_a_refusal(text: str) -> None:
    with suppress(HostRefused):
        check_host(LOCAL, text, ())
        host = host_name(text)
        assert "." not in host or host.endswith(".localhost") or ip_address(host)
    with suppress(OriginRefused):
        check_origin(Headers({"origin": text, "host": "robot"}), ())
        # Only the robot's own origin passes, whatever scheme it has.
        assert text.rpartition("//")[2].startswith("robot")


def test_no_path_of_a_request_begins_a_line_of_the_log(
    service: RunningService, written_log: io.StringIO
) -> None:
    with httpx2.Client(base_url=service.url) as http:
        for path in ("/x%0d%0aFORGED%20line", "/x%1b%5b31mFORGED", "/x%e2%80%a8FORGED"):
            assert http.get(path).status_code == 404
        http.get("/livez")  # a line is written before the next request of its connection is read
    lines = [line for line in written_log.getvalue().split("\n") if "FORGED" in line]
    assert len(lines) == 6  # as text and as JSON
    assert all(line.isprintable() and "/x" in line for line in lines)


@pytest.mark.parametrize("name", ["a%22b", "a%0d%0aX-Forged:1", "a%3Bb", "a%2F..%2Fb", "%C3%A4"])
def test_no_name_ends_up_in_a_header_but_plain_ones(name: str, client: TestClient) -> None:
    for method in ("PUT", "GET"):
        answer = client.request(method, f"/noise/{name}", content=b"x")
        assert answer.status_code in (404, 422)
        assert "x-forged" not in answer.headers
        assert "content-disposition" not in answer.headers

"""Who a client is: what the proxies of the settings say, and nobody else; quoted in logs."""

from __future__ import annotations

import io
import logging

import httpx2
import pytest
from running_service import RunningService

from neuralmusic.errors import ConfigError
from service.observability.logs import TextFormatter
from service.settings import Settings, load_settings


def logged_client(written: io.StringIO, settings: Settings, forwarded: str) -> str:
    """The field ``client`` of a request's line in the log."""
    service = RunningService(settings=settings)
    try:
        httpx2.get(f"{service.url}/models", headers={"X-Forwarded-For": forwarded}, trust_env=False)
    finally:
        service.stop()
    (line,) = [each for each in written.getvalue().splitlines() if " client=" in each]
    return line.partition(" client=")[2]


@pytest.mark.parametrize(
    ("proxies", "client"),
    [("", "127.0.0.1"), ("192.0.2.0/24", "127.0.0.1"), ("127.0.0.1", "198.51.100.7"), ("*", "x")],
)
def test_a_forwarded_address_is_believed_of_configured_proxies(
    written_log: io.StringIO, proxies: str, client: str
) -> None:
    settings = load_settings(workers=1, proxies=proxies)
    forwarded = "x, 198.51.100.7"
    assert logged_client(written_log, settings, forwarded).split()[0] == client


def test_a_proxy_is_an_address() -> None:
    with pytest.raises(ConfigError, match=r"proxies .*balancer"):
        load_settings(proxies="balancer.example")


def test_a_value_in_the_log_cannot_be_taken_for_another_field() -> None:
    record = logging.makeLogRecord({"msg": "GET / 200", "client": '1.2.3.4" status=200 level=x'})
    assert r'client="1.2.3.4\" status=200 level=x"' in TextFormatter().format(record)

"""The address that the service listens on."""

from __future__ import annotations

import socket

import pytest

from neuralmusic.errors import ConfigError
from service.connections.address import check_address


def test_a_taken_port_is_known_before_anything_is_loaded() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match=f"port {port} of 127.0.0.1 .*--port"):
            check_address("127.0.0.1", port)
    check_address("127.0.0.1", port)
    check_address("localhost", 0)
    with pytest.raises(ConfigError, match=r"host nowhere\.invalid"):
        check_address("nowhere.invalid", port)

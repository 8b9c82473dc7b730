"""``HOST:PORT`` in flags."""

from __future__ import annotations

from dataclasses import dataclass

from neuralmusic.errors import InvalidOption


@dataclass(frozen=True)
class Address:
    """An address on which another program listens."""

    host: str
    port: int

    @property
    def text(self) -> str:
        """``HOST:PORT`` as the user gave it."""
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


def read_address(option: str, text: str) -> Address:
    """An address from ``127.0.0.1:9000`` or ``[::1]:9000``, or InvalidOption."""
    host, colon, port = text.strip().rpartition(":")
    bare = host.removeprefix("[").removesuffix("]")
    valid = colon and bare and port.isascii() and port.isdigit() and 0 < int(port) <= 65_535
    if not valid or (":" in bare) != (host != bare):
        raise InvalidOption(f"{option} must be HOST:PORT, but is {text!r}")
    return Address(bare, int(port))

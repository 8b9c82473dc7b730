"""A network namespace at the end of a cable that can be cut: packets vanish, nobody is told."""

from __future__ import annotations

import os
import shutil
import subprocess
from typing import Self

NEAR, FAR = "10.213.77.1", "10.213.77.2"
"""Addresses of this side and of the namespace"""


def usable() -> bool:
    """Whether this process can make namespaces: as root, with ip and iptables."""
    return os.geteuid() == 0 and all(map(shutil.which, ("ip", "iptables")))


def ip(*words: str) -> None:
    """``ip`` with these words."""
    subprocess.run(["ip", *words], check=True, capture_output=True)


class Namespace:
    """A namespace with one cable to this one."""

    def __init__(self) -> None:
        self.name = f"nm{os.getpid()}"
        self._near, self._far = f"nmn{os.getpid()}", f"nmf{os.getpid()}"

    @property
    def within(self) -> tuple[str, ...]:
        """Prefix of a command that runs in the namespace."""
        return ("ip", "netns", "exec", self.name)

    def cut(self) -> None:
        """Let every packet of the cable vanish."""
        self._filter("-A")

    def mend(self) -> None:
        """Let packets pass again."""
        self._filter("-D")

    def _filter(self, action: str) -> None:
        for chain, direction in (("INPUT", "-i"), ("OUTPUT", "-o")):
            rule = ("iptables", "-w", action, chain, direction, self._far, "-j", "DROP")
            subprocess.run([*self.within, *rule], check=True, capture_output=True)

    def __enter__(self) -> Self:
        ip("netns", "add", self.name)
        try:
            ip("link", "add", self._near, "type", "veth", "peer", "name", self._far)
            ip("link", "set", self._far, "netns", self.name)
            ip("address", "add", f"{NEAR}/30", "dev", self._near)
            ip("link", "set", self._near, "up")
            for words in (
                ("address", "add", f"{FAR}/30", "dev", self._far),
                ("link", "set", self._far, "up"),
                ("link", "set", "lo", "up"),
            ):
                ip("-n", self.name, *words)
        except BaseException:
            self._remove()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._remove()

    def _remove(self) -> None:
        """The cable goes with the namespace."""
        ip("netns", "delete", self.name)

"""``neuralmusic stream`` as the tests call it."""

from __future__ import annotations

import command_line
import pytest

ARRAY = "respeaker-usb-4mic-v2"
RATE = 16_000


def run(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, str, str]:
    return command_line.run(capsys, "stream", *argv)


def refusal(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    """The one line on standard error of a command that fails."""
    return command_line.refusal(capsys, "stream", *argv)

"""The command line ``neuralmusic``: one module per command.

A command module has ``NAME``, ``SUMMARY``, ``configure(parser)`` and ``run(args) -> int``. It
imports what it needs inside of functions, so that ``--help`` is quick and ``check`` runs without
onnxruntime; only the chosen command is configured. To add one, append its module to ``COMMANDS``.

Exit codes: 0 done, 1 ``check`` found something or ``batch`` met recordings that cannot be used,
2 wrong usage or unusable input, 130 interrupted.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from typing import Protocol

from service import __version__
from service.cli import arrays, batch, bench, bundle, check, key, localize, noise, serve, stream
from service.errors import DoaError


class Command(Protocol):
    """What ``main`` needs of a command's module."""

    NAME: str
    SUMMARY: str

    @property
    def configure(self) -> Callable[[argparse.ArgumentParser], None]: ...

    @property
    def run(self) -> Callable[[argparse.Namespace], int]: ...


COMMANDS: tuple[Command, ...] = (
    serve, localize, batch, check, noise, bundle, arrays, bench, stream, key,
)  # fmt: skip

FAILED = 2
INTERRUPTED = 130  # 128 + SIGINT, as shells have it
READER_GONE = 141  # 128 + SIGPIPE


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and give its exit code; no error of the user's ends in a traceback."""
    words = sys.argv[1:] if argv is None else list(argv)
    for printed in (sys.stdout, sys.stderr):
        if hasattr(printed, "reconfigure"):
            printed.reconfigure(errors="replace")  # a terminal without a degree sign prints "?"
    args = _parser(words).parse_args(words)
    try:
        code: int = args.run(args)
        sys.stdout.flush()
    except DoaError as error:
        return _fail(error.detail)
    except BrokenPipeError:
        # What is left in the buffer would raise again when the interpreter flushes it at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return READER_GONE
    except OSError as error:
        return _fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except KeyboardInterrupt:
        return INTERRUPTED
    return code


def _fail(sentence: str) -> int:
    print(f"error: {sentence}", file=sys.stderr)
    return FAILED


def _parser(words: Sequence[str]) -> argparse.ArgumentParser:
    """The parser with the options of the one command that ``words`` name."""
    parser = argparse.ArgumentParser(
        prog="neuralmusic",
        description="Sound source localization: from microphone array audio to directions.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"neuralmusic {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    chosen = next((word for word in words if not word.startswith("-")), None)
    for command in COMMANDS:
        added = commands.add_parser(
            command.NAME, help=command.SUMMARY, description=command.SUMMARY, allow_abbrev=False
        )
        added.set_defaults(run=command.run)
        if chosen == command.NAME:
            command.configure(added)
    return parser

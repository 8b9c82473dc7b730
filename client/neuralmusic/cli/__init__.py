"""The command line ``neuralmusic``: one module per command.

A command module has ``NAME``, ``SUMMARY``, ``configure(parser)`` and ``run(args) -> int``. It
imports its needs inside functions, so that ``--help`` is quick and ``check`` runs without
onnxruntime; only the chosen command is configured. ``stream`` and ``arrays`` are this package's
own; further ones are entry points of the group ``neuralmusic.commands``.

Exit codes: 0 done, 1 ``check`` found something or ``batch`` met recordings that cannot be used,
2 wrong usage or unusable input, 130 interrupted.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from neuralmusic import __version__
from neuralmusic.cli.commands import INSTALLING, installed_commands, missing_commands
from neuralmusic.errors import DoaError

FAILED = 2
INTERRUPTED = 130  # 128 + SIGINT, as shells have it
READER_GONE = 141  # 128 + SIGPIPE


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code; a user's error never ends in a traceback."""
    words = sys.argv[1:] if argv is None else list(argv)
    for printed in (sys.stdout, sys.stderr):
        if hasattr(printed, "reconfigure"):
            printed.reconfigure(errors="replace")  # a terminal without a degree sign prints "?"
    chosen = next((word for word in words if not word.startswith("-")), None)
    missing = missing_commands()
    if chosen in missing:
        return _fail(
            f"neuralmusic {chosen} comes with the package neuralmusic-service, which is not "
            f"installed: {INSTALLING}"
        )
    args = _parser(chosen, missing).parse_args(words)
    try:
        code: int = args.run(args)
        sys.stdout.flush()
    except DoaError as error:
        return _fail(error.detail)
    except BrokenPipeError:
        # The rest of the buffer would raise again when the interpreter flushes it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return READER_GONE
    except OSError as error:
        return _fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    return code


def _fail(sentence: str) -> int:
    print(f"error: {sentence}", file=sys.stderr)
    return FAILED


def _parser(chosen: str | None, missing: Sequence[str]) -> argparse.ArgumentParser:
    """The parser with the options of the chosen command alone."""
    parser = argparse.ArgumentParser(
        prog="neuralmusic",
        description="Sound source localization: from microphone array audio to directions.",
        epilog=f"The package neuralmusic-service adds {', '.join(missing)}." if missing else None,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"neuralmusic {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    for name, command in installed_commands().items():
        added = commands.add_parser(
            name, help=command.SUMMARY, description=command.SUMMARY, allow_abbrev=False
        )
        added.set_defaults(run=command.run)
        if chosen == name:
            command.configure(added)
    return parser

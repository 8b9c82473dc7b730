"""``neuralmusic key``: make API keys, and show those of a file."""

from __future__ import annotations

import argparse
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from neuralmusic.cli.terminal import line, output, table
from neuralmusic.errors import InvalidOption

if TYPE_CHECKING:
    from service.access.key_file import Key

NAME = "key"
SUMMARY = "make and list the API keys of a service"

PRIVATE = 0o600


def configure(parser: argparse.ArgumentParser) -> None:
    commands = parser.add_subparsers(metavar="ACTION", required=True, dest="action")
    _configure_new(
        commands.add_parser(
            "new",
            help="make a key",
            description="Make a key. The token is printed once; the file holds only its hash.",
            allow_abbrev=False,
        )
    )
    shown = commands.add_parser(
        "list",
        help="check a file of keys and list them",
        description="Check a file of keys and list them; it holds no tokens.",
        allow_abbrev=False,
    )
    shown.add_argument("file", type=Path, metavar="FILE", help="the file of NEURALMUSIC_KEYS")


def _configure_new(parser: argparse.ArgumentParser) -> None:
    from service.access.key_file import ROLES

    add = parser.add_argument
    add("name", metavar="NAME", help="name of the key's owner, for logs")
    add("--roles", required=True, metavar="ROLE,...", help=f"one or more of {', '.join(ROLES)}")
    add("--file", type=Path, metavar="FILE", help="add the line to this file, which may be new")
    add("--max-sessions", type=int, metavar="N", help="most streams at the same time")
    add("--max-uploads", type=int, metavar="N", help="most uploads at the same time")
    add("--audio-seconds-per-hour", type=float, metavar="S", help="recordings and streams together")
    add(
        "--origins",
        metavar="URL,...",
        help="web pages that may use the key, such as https://dash.example",
    )
    add("--expires", metavar="DATE", help="such as 2030-01-31: refused from its first second, UTC")


def run(args: argparse.Namespace) -> int:
    return _new(args) if args.action == "new" else _list(args.file)


def _new(args: argparse.Namespace) -> int:
    from service.access.key_file import new_token, read_keys

    token = new_token()
    key = _key(args, token)
    if args.file is None:
        print(f"token: {token}")
        print(f"line:  {key.line}")
        return 0
    if args.file.exists() and args.file.stat().st_size:
        if key.name in {known.name for known in read_keys(args.file, empty=True)}:
            raise InvalidOption(f"{args.file} has a key {key.name}: choose another name")
        key_line = ("" if args.file.read_text().endswith("\n") else "\n") + key.line
    else:
        key_line = key.line
    descriptor = os.open(args.file, os.O_WRONLY | os.O_APPEND | os.O_CREAT, PRIVATE)
    with open(descriptor, "w", encoding="utf-8") as file:
        file.write(f"{key_line}\n")
    print(f"token: {token}")
    print(
        f"It is not shown again. {args.file} holds its hash; a running service reads it on SIGHUP."
    )
    return 0


def _key(args: argparse.Namespace, token: str) -> Key:
    from pydantic import ValidationError

    from service.access.key_file import Key, token_sha256

    try:
        return Key.model_validate(
            {
                "name": args.name,
                "sha256": token_sha256(token),
                "roles": _parts(args.roles),
                "max_sessions": args.max_sessions,
                "max_uploads": args.max_uploads,
                "audio_seconds_per_hour": args.audio_seconds_per_hour,
                "origins": _parts(args.origins or ""),
                "expires": _midnight(args.expires) if args.expires else None,
            }
        )
    except ValidationError as error:
        first = error.errors()[0]
        place = str(first["loc"][0])
        raise InvalidOption(f"{place}: {first['msg']}, but it is {first['input']!r}") from None


def _parts(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _midnight(text: str) -> datetime:
    try:
        date = datetime.fromisoformat(text)
    except ValueError:
        raise InvalidOption(
            f"--expires must be a date such as 2030-01-31, but is {text!r}"
        ) from None
    return date if date.tzinfo else date.replace(tzinfo=UTC)


def _expiry(expires: datetime) -> str:
    passed = " (expired)" if expires <= datetime.now(UTC) else ""
    return f"{expires.astimezone(UTC):%Y-%m-%d %H:%M} UTC{passed}"


def _list(path: Path) -> int:
    from service.access.key_file import read_keys

    console = output()
    drawn = table(console, "name", "roles", "sessions", "uploads", "audio s/h", "expires", "hash")
    for key in read_keys(path):
        limits = (key.max_sessions, key.max_uploads, key.audio_seconds_per_hour)
        drawn.add_row(
            key.name,
            ", ".join(key.roles),
            *("" if limit is None else f"{limit:g}" for limit in limits),
            _expiry(key.expires) if key.expires else "",
            key.sha256[:8],
        )
    console.print(drawn)
    line(console, f"{path} is in order")
    return 0

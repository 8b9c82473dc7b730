"""``neuralmusic bundle show``: a model bundle's manifest and the state of its files."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuralmusic.cli.terminal import line, output, table
from neuralmusic.errors import UnknownModel
from service.machine.environment import prepare_process

if TYPE_CHECKING:
    from rich.console import Console

    from service.inference.manifest import Manifest

NAME = "bundle"
SUMMARY = "show model bundles"


def configure(parser: argparse.ArgumentParser) -> None:
    commands = parser.add_subparsers(metavar="ACTION", required=True)
    show = commands.add_parser(
        "show",
        help="list the bundles, or show one",
        description="List the bundles that the service loads, best first, or show one of them.",
        allow_abbrev=False,
    )
    show.add_argument("bundle", nargs="?", metavar="NAME|FOLDER", help="the bundle to show")
    show.add_argument("--json", action="store_true", help="print the manifests as JSON")


def run(args: argparse.Namespace) -> int:
    prepare_process()
    from service.inference.bundle import read_manifest

    folders = _folders() if args.bundle is None else [_find(args.bundle)]
    read = [(folder, *read_manifest(folder)) for folder in folders]
    if args.json:
        documents = [{**m.model_dump(mode="json"), "sha256": digest} for _, m, digest in read]
        print(json.dumps(documents if args.bundle is None else documents[0], indent=2))
        return 0
    console = output()
    if args.bundle is None:
        _print_all(console, [manifest for _, manifest, _ in read])
        return 0
    return _print_one(console, *read[0])


def _folders() -> list[Path]:
    """The bundles that the service would load, in its order."""
    from service.inference.registry import ordered_folders
    from service.settings import load_settings

    return ordered_folders(load_settings().models)


def _find(argument: str) -> Path:
    """The argument as a folder, or the folder of the bundle with this name."""
    if Path(argument).is_dir():
        return Path(argument)
    from service.inference.bundle import read_manifest

    names = []
    for folder in _folders():
        names.append(read_manifest(folder)[0].name)
        if names[-1] == argument:
            return folder
    raise UnknownModel(
        f"{argument} is neither a folder nor one of the bundles {', '.join(names) or '(none)'}"
    )


def _array(manifest: Manifest) -> str:
    return "any" if manifest.array == "any" else manifest.array.name


def _print_all(console: Console, manifests: list[Manifest]) -> None:
    if not manifests:
        line(console, "there are no bundles")
        return
    drawn = table(console, "name", "version", "for", "array", "description")
    for manifest in manifests:
        drawn.add_row(
            manifest.name,
            manifest.version,
            manifest.purpose,
            _array(manifest),
            manifest.description,
        )
    console.print(drawn)


def _print_one(console: Console, folder: Path, manifest: Manifest, digest: str) -> int:
    line(console, f"{manifest.name} {manifest.version}", "bold")
    line(console, manifest.description)
    drawn = table(console, "", "")
    drawn.show_header = False
    stft = manifest.stft
    drawn.add_row("for", manifest.purpose)
    drawn.add_row("variant", manifest.variant)
    drawn.add_row("array", _array(manifest))
    drawn.add_row("audio", f"{stft.sample_rate} Hz, STFT {stft.n_fft}/{stft.hop}")
    drawn.add_row("sources", f"counts up to {manifest.max_sources}")
    drawn.add_row("folder", str(folder))
    drawn.add_row("sha256", digest)
    console.print(drawn)
    _print_scores(console, manifest.scores)
    _print_section(console, "training", manifest.training)
    _print_section(console, "parity", manifest.parity)
    line(console, "licences", "bold")
    for licence in manifest.licences:
        line(console, f"  {licence}")
    _print_card(console, folder)
    return _print_files(console, folder, manifest)


def _print_scores(console: Console, scores: Mapping[str, Any]) -> None:
    """Print a row per cell of the evaluation, a column per score, then all other scores."""
    cells: Mapping[str, Mapping[str, float]] = scores.get("cells", {})
    _print_section(console, "scores", {k: v for k, v in scores.items() if k != "cells"})
    columns = list(dict.fromkeys(name for cell in cells.values() for name in cell))
    drawn = table(console, "cell", *columns, right=tuple(columns))
    for name, cell in cells.items():
        drawn.add_row(name, *(f"{cell[c]:.3g}" if c in cell else "" for c in columns))
    if cells:
        console.print(drawn)


def _print_card(console: Console, folder: Path) -> None:
    from service.inference.bundle import CARD

    card = folder / CARD
    if card.is_file():
        line(console, "card", "bold")
        line(console, card.read_text(encoding="utf-8", errors="replace").strip())


def _print_section(console: Console, title: str, section: Mapping[str, Any]) -> None:
    line(console, title, "bold")
    drawn = table(console, "", "")
    drawn.show_header = False
    for path, value in _leaves(section):
        drawn.add_row(f"  {path}", f"{value:.4g}" if isinstance(value, float) else str(value))
    console.print(drawn)


def _leaves(section: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted paths and values of a nested mapping."""
    for name, value in section.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _print_files(console: Console, folder: Path, manifest: Manifest) -> int:
    """Print sizes, and whether each file matches its hash in the manifest."""
    from service.inference.bundle import file_sha256

    line(console, "files", "bold")
    whole = True
    for name, expected in manifest.files.items():
        path = folder / name
        state = "missing"
        if path.is_file():
            same = file_sha256(path) == expected
            state = f"{path.stat().st_size / 1024:.0f} KiB, " + ("whole" if same else "CHANGED")
        whole = whole and state.endswith("whole")
        line(console, f"  {name}: {state}", None if state.endswith("whole") else "red")
    return 0 if whole else 1

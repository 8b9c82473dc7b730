"""``export``: turn a run into a bundle that the service loads."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from model_export.cli.speech import add_corpora, add_rooms, licences, noises, sources


def add(commands: Any) -> None:
    """Add the command."""
    export = commands.add_parser("export", help="train the source count and write a bundle")
    export.add_argument(
        "--run", type=Path, required=True, help="folder of the trained run, or of a bundle"
    )
    export.add_argument("--out", type=Path, required=True, help="folder of the bundle")
    export.add_argument("--name", help="the bundle's name (default: the configuration's)")
    export.add_argument("--version", default="0.1.0", help="the bundle's version (default 0.1.0)")
    export.add_argument(
        "--counting-scenes", type=int, default=16000, help="scenes for the source count"
    )
    export.add_argument(
        "--source-count", type=Path, metavar="BUNDLE", help="reuse this bundle's source count"
    )
    export.add_argument(
        "--known",
        type=Path,
        nargs="+",
        default=(),
        metavar="RUN",
        help="runs for one number of talkers each (paper-1 ...), used where the number is known, "
        "or a bundle that has such networks, for the numbers that no run has",
    )
    add_rooms(export, use=", where the source count is trained")
    add_corpora(export, required=True)
    export.set_defaults(run_command=_export)


def _export(arguments: argparse.Namespace) -> None:
    from model_export.export.run import export_run

    corpora = licences(arguments)
    manifest = export_run(
        arguments.run,
        arguments.out,
        name=arguments.name,
        version=arguments.version,
        rooms=arguments.rooms,
        speech=sources(arguments, "train"),
        validation_speech=sources(arguments, "development"),
        counting_scenes=arguments.counting_scenes,
        source_count=arguments.source_count,
        known=arguments.known,
        noises=noises(arguments),
        data=list(corpora),
        licences=[f"{corpus}: {licence}" for corpus, licence in corpora.items()],
    )
    print(json.dumps({"training": manifest.training, "parity": manifest.parity}, indent=2))

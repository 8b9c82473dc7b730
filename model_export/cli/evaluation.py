"""``evaluate``: the scores of bundles and classical methods."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from model_export.cli.speech import add_speech_commands, words

if TYPE_CHECKING:
    from model_export.evaluation.results import Results
    from model_export.evaluation.workers import Workers


def add(commands: Any) -> None:
    """Add the command."""
    evaluate = commands.add_parser("evaluate", help="score bundles and classical methods")
    evaluate.add_argument("--bundle", type=Path, nargs="*", default=[], help="bundle folders")
    add_speech_commands(evaluate)
    evaluate.add_argument("--scenes", type=int, default=500, help="scenes a cell (default 500)")
    evaluate.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    evaluate.add_argument(
        "--cells", metavar="PATTERN", help="only print cells like 'M=2*', '60 s*', 'reliability'"
    )
    add_split(evaluate)
    evaluate.add_argument(
        "--steady",
        type=Path,
        nargs="*",
        default=[],
        metavar="FILE",
        help="further noises, steady recordings",
    )
    evaluate.add_argument("--out", type=Path, help="folder of the tables (default: only print)")
    evaluate.add_argument(
        "--write-scores", action="store_true", help="put the scores into the bundles' manifests"
    )
    evaluate.add_argument("--figures", type=int, metavar="N", help="draw figures, N scenes a point")
    evaluate.add_argument("--readme", type=Path, help="README whose results table to renew")
    evaluate.set_defaults(run_command=_evaluate)


def add_split(parser: argparse.ArgumentParser) -> None:
    """Add the flag that chooses the speakers."""
    parser.add_argument(
        "--split",
        choices=("heldout", "development"),
        default="heldout",
        help="speakers (default heldout)",
    )


def _evaluate(arguments: argparse.Namespace) -> None:
    from model_export.evaluation.evaluate import SEEDS, evaluate
    from model_export.evaluation.methods import Methods
    from model_export.evaluation.workers import Inputs, Workers

    _check_writing(arguments)
    speech = words(arguments.speech_commands, arguments.split)
    inputs = Inputs(Methods(arguments.bundle), speech, SEEDS[arguments.split])
    with Workers.start(inputs, arguments.workers) as workers:
        results = evaluate(
            workers, arguments.scenes, pattern=arguments.cells or "*", recordings=arguments.steady
        )
        results.split = arguments.split
        print(results.tables())
        if arguments.out:
            _write_results(arguments, workers, results)


def _check_writing(arguments: argparse.Namespace) -> None:
    """Refuse to write anything but a whole run on the held-out speakers."""
    partial = arguments.cells is not None or arguments.split != "heldout"
    if partial and (arguments.out or arguments.write_scores):
        raise ValueError(
            "--cells and --split development only print: remove --out and --write-scores"
        )
    if not arguments.out and (arguments.write_scores or arguments.figures or arguments.readme):
        raise ValueError(
            "--write-scores, --figures and --readme need --out, the folder of results.json"
        )


def _write_results(arguments: argparse.Namespace, workers: Workers, results: Results) -> None:
    from model_export.evaluation.figures import draw
    from model_export.evaluation.results import update_readme
    from model_export.export.bundle import update_scores
    from service.inference.bundle import read_manifest

    results.write(arguments.out)
    if arguments.figures:
        draw(arguments.out, workers, arguments.figures, results)
    if arguments.readme:
        update_readme(arguments.readme, results)
    if arguments.write_scores:
        for folder in arguments.bundle:
            update_scores(folder, results.bundle_scores(read_manifest(folder)[0].name))

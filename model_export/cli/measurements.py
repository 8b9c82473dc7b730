"""Further measurements: ``ego-noise``, ``mistakes``, ``tracking``, ``array-sweep`` and others."""

from __future__ import annotations

import argparse
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from model_export.cli.evaluation import add_split
from model_export.cli.speech import add_librispeech, add_speech_commands, utterances, words


def add(commands: Any) -> None:
    """Add the commands."""
    ego = commands.add_parser("ego-noise", help="gain of a noise profile: docs/ego-noise.md")
    add_speech_commands(ego)
    ego.add_argument("--scenes", type=int, default=60, help="talkers (default 60)")
    ego.add_argument("--snr-db", type=float, default=0.0, help="talker over the noise")
    ego.add_argument("--alone", type=float, default=60.0, help="seconds of the noise alone")
    ego.add_argument("--seed", type=int, default=7)
    _add_page(ego, "docs/ego-noise.md", _ego_noise)

    mistakes = commands.add_parser("mistakes", help="mistakes that are named: docs/diagnostics.md")
    add_librispeech(mistakes)
    mistakes.add_argument("--recordings", type=Path, help="correct real recordings of the array")
    mistakes.add_argument(
        "--seconds", type=float, nargs="+", default=[10.0, 30.0], help="lengths (default 10 30)"
    )
    mistakes.add_argument("--seed", type=int, default=3)
    _add_page(mistakes, "docs/diagnostics.md", _mistakes)

    tracking = commands.add_parser("tracking", help="score the tracker: docs/tracking.md")
    add_librispeech(tracking)
    tracking.add_argument(
        "--recordings", type=Path, help="real recordings of the array, with labels.json"
    )
    add_split(tracking)
    _add_page(tracking, "docs/tracking.md", _tracking)

    spatial = commands.add_parser(
        "spatial", help="score talkers above and below arrays with height: docs/results.md"
    )
    spatial.add_argument("--bundle", type=Path, nargs="*", default=[], help="bundle folders")
    add_speech_commands(spatial)
    spatial.add_argument("--scenes", type=int, default=200, help="scenes a cell (default 200)")
    spatial.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    spatial.add_argument("--cells", metavar="PATTERN", default="*", help="only cells like 'cube*'")
    add_split(spatial)
    spatial.add_argument("--out", type=Path, help="page whose section to renew (default: print)")
    spatial.set_defaults(run_command=_spatial)

    confidence = commands.add_parser(
        "classical-confidence", help="fit and print the confidences of classical peaks"
    )
    add_speech_commands(confidence)
    confidence.add_argument("--windows", type=int, default=1800, help="windows (default 1800)")
    confidence.add_argument("--seed", type=int, default=11)
    confidence.set_defaults(run_command=_classical_confidence)

    arrays = commands.add_parser(
        "array-sweep", help="one talker before arrays of 2 to 64 microphones: print who is found"
    )
    add_speech_commands(arrays)
    arrays.add_argument("--seed", type=int, default=23)
    arrays.set_defaults(run_command=_array_sweep)


def _add_page(parser: argparse.ArgumentParser, page: str, run: Any) -> None:
    parser.add_argument("--out", type=Path, default=Path(page), help=f"page (default {page})")
    parser.set_defaults(run_command=run)


def _ego_noise(arguments: argparse.Namespace) -> None:
    from model_export.datasets.speech import speech_commands
    from model_export.evaluation.ego_noise import Measurement, document

    measurement = Measurement(arguments.scenes, arguments.snr_db, arguments.alone, arguments.seed)
    clips = speech_commands(arguments.speech_commands, "heldout")
    arguments.out.write_text(document(clips, measurement))


def _mistakes(arguments: argparse.Namespace) -> None:
    from model_export.evaluation.mistakes import document

    speech = utterances(arguments.librispeech, "heldout")
    page = document(speech, arguments.seconds, arguments.seed, arguments.recordings)
    arguments.out.write_text(page)


def _tracking(arguments: argparse.Namespace) -> None:
    from model_export.evaluation.tracking.evaluate import evaluate

    speech = utterances(arguments.librispeech, arguments.split)
    arguments.out.write_text(evaluate(speech, arguments.split, arguments.recordings))


def _spatial(arguments: argparse.Namespace) -> None:
    from model_export.evaluation.evaluate import SEEDS
    from model_export.evaluation.methods import Methods
    from model_export.evaluation.sections import renew
    from model_export.evaluation.spatial import SECTION, document, measure_spatial, spatial_cells
    from model_export.evaluation.workers import Inputs, Workers

    cells = [cell for cell in spatial_cells() if fnmatchcase(cell.name, arguments.cells)]
    if not cells:
        names = ", ".join(cell.name for cell in spatial_cells())
        raise ValueError(f"no cell matches {arguments.cells!r}; the cells are {names}")
    if arguments.out and (arguments.cells != "*" or arguments.split != "heldout"):
        raise ValueError("--cells and --split development only print: remove --out")
    speech = words(arguments.speech_commands, arguments.split)
    inputs = Inputs(Methods(arguments.bundle), speech, SEEDS[arguments.split])
    with Workers.start(inputs, arguments.workers) as workers:
        tables = measure_spatial(workers, arguments.scenes, cells)
    text = document(tables, arguments.scenes, arguments.split)
    if arguments.out:
        renew(arguments.out, SECTION, text)
    else:
        print(text)


def _classical_confidence(arguments: argparse.Namespace) -> None:
    from model_export.evaluation.classical_confidence import fitted_curves

    speech = words(arguments.speech_commands, "development")
    print("\n".join(fitted_curves(speech, arguments.windows, arguments.seed)))


def _array_sweep(arguments: argparse.Namespace) -> None:
    from rich.progress import track

    from model_export.evaluation.array_sweep import cases, sweep, table
    from service.inference.registry import BundleRegistry

    speech, swept = words(arguments.speech_commands, "heldout"), list(cases())
    bundle = BundleRegistry.load().get("any-array")
    outcomes = sweep(swept, speech, bundle, arguments.seed)
    print(table(list(track(outcomes, description="sweeping arrays", total=len(swept)))))

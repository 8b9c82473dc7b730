"""``python -m model_export methods|experiments|recordings``."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from model_export.cli.device import add_device, device
from model_export.cli.speech import add_speech_commands
from model_export.evaluation.sections import renew
from model_export.experiments.outcome import Outcome
from model_export.experiments.report import FOLDER, SECTION, keep, section
from model_export.experiments.scale import SCALES

if TYPE_CHECKING:
    from model_export.experiments.study import Study

RECORDINGS = ("av163", "av163-both", "sloclas", "afpild", "locata")


@dataclass(frozen=True, slots=True)
class Experiment:
    """One table or figure of the paper."""

    name: str
    title: str
    run: Callable[[Any, Path], Any]
    """Function of a study and the folder for figures that returns an outcome"""


def experiments() -> dict[str, Experiment]:
    """All experiments by name, in the document's order."""
    from model_export.experiments import curves, self_supervision, spectra, tables

    found = (
        Experiment("main", "Main table", lambda study, _: tables.main_table(study)),
        Experiment("ablation", "Ablation", lambda study, _: tables.ablation(study)),
        Experiment("share", "Share of the training data", curves.training_share),
        Experiment("snr", "Noise", curves.snr),
        Experiment("transfer", "Other rooms and arrays", lambda study, _: tables.transfer(study)),
        Experiment("sparse", "Sparse directions", lambda study, _: tables.sparse_angles(study)),
        Experiment("sscl", "Self-supervised learning: loss", self_supervision.sscl_loss),
        Experiment(
            "reconstructions",
            "Self-supervised learning: reconstructions",
            self_supervision.reconstructions,
        ),
        Experiment("latent", "Latent covariance features", self_supervision.latent_features),
        Experiment("spectra", "Spectra side by side", spectra.spectra),
        Experiment("line", "Microphones on a line", lambda study, _: tables.line(study)),
    )
    return {experiment.name: experiment for experiment in found}


NAMES = (
    "main", "ablation", "share", "snr", "transfer", "sparse", "sscl", "reconstructions", "latent",
    "spectra", "line",
)  # fmt: skip


def add(commands: Any) -> None:
    """Add ``methods``, ``experiments`` and ``recordings`` to the subparsers of the command line."""
    listing = commands.add_parser("methods", help="list every method of the paper's comparison")
    listing.add_argument("--json", action="store_true", help="as a JSON array of objects")
    listing.set_defaults(run_command=_methods)

    run = commands.add_parser("experiments", help="reproduce the paper's tables and figures")
    run.add_argument(
        "names",
        nargs="+",
        choices=(*NAMES, "all"),
        metavar="NAME",
        help=f"{', '.join(NAMES)} or all",
    )
    add_speech_commands(run)
    _add_where(run)
    run.set_defaults(run_command=_run)

    real = commands.add_parser("recordings", help="the paper's comparison on a downloaded data set")
    real.add_argument("dataset", choices=RECORDINGS, metavar="DATASET", help=", ".join(RECORDINGS))
    real.add_argument("folder", type=Path, help="folder that it unpacked to (docs/datasets.md)")
    _add_where(real)
    real.set_defaults(run_command=_recordings, speech_commands=Path())


def _add_where(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--scale", choices=sorted(SCALES), default="small", help="size (default small)"
    )
    parser.add_argument(
        "--runs",
        type=Path,
        default=Path("runs/experiments"),
        help="folder of scenes, trainings and scores; existing ones are reused",
    )
    parser.add_argument("--out", type=Path, help="docs folder to renew (default: only print)")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument(
        "--methods", nargs="+", default=[], metavar="METHOD", help="only print these rows"
    )
    add_device(parser)


def _methods(arguments: argparse.Namespace) -> None:
    from model_export.baselines.catalogue import described

    found = described()
    if arguments.json:
        print(json.dumps(found, indent=2))
        return
    for method in found:
        size = f"{method['parameters']:,} parameters" if method["parameters"] else "no parameters"
        print(f"{method['name']:15}{method['kind']:11}{size:24}{method['source']}")


def _run(arguments: argparse.Namespace) -> None:
    study = _study(arguments)
    figures = (arguments.out or study.folder) / FOLDER
    known = experiments()
    for name in list(NAMES) if "all" in arguments.names else arguments.names:
        command = f"experiments {name} --speech-commands SPEECH_COMMANDS"
        _tell(arguments, study, name, known[name].title, command, known[name].run(study, figures))


def _recordings(arguments: argparse.Namespace) -> None:
    from model_export.experiments.on_recordings import TASKS, recordings

    study = _study(arguments)
    outcome = recordings(study, arguments.dataset, arguments.folder)
    title = f"Recordings: {TASKS[arguments.dataset].title}"
    command = f"recordings {arguments.dataset} DIR"
    _tell(arguments, study, arguments.dataset, title, command, outcome)


def _study(arguments: argparse.Namespace) -> Study:
    from model_export.baselines.catalogue import cards
    from model_export.baselines.shipped import SHIPPED
    from model_export.experiments.study import Study

    if arguments.methods and arguments.out:
        raise ValueError("--methods only prints: remove --out")
    known = [*cards(), *SHIPPED]
    for name in arguments.methods:
        if name not in known:
            raise ValueError(f"no method is named {name!r}; the methods are {', '.join(known)}")
    return Study(
        arguments.runs / arguments.scale,
        arguments.scale,
        arguments.speech_commands,
        arguments.workers,
        device(arguments),
        tuple(arguments.methods),
    )


def _tell(
    arguments: argparse.Namespace,
    study: Study,
    name: str,
    title: str,
    command: str,
    outcome: Outcome,
) -> None:
    """Print an outcome, and renew the documents if ``--out`` names their folder."""
    print(f"\n### {title}\n\n{outcome.markdown()}\n")
    if arguments.out:
        whole = f"python -m model_export {command} --scale {arguments.scale} --out docs"
        keep(arguments.out, name, title, whole, arguments.scale, outcome)
        order = [*NAMES, *RECORDINGS]
        renew(
            arguments.out / "results.md",
            SECTION,
            section(arguments.out, order, asdict(study.scale)),
        )

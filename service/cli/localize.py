"""``neuralmusic localize``: directions of a recording, in this process."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from service.cli.inputs import add_array, add_recording, array_text, open_recording

if TYPE_CHECKING:
    from collections.abc import Callable

    from service.api.options import LocalizeRequest
    from service.inference.results import LocalizeOptions, RecordingResult

NAME = "localize"
SUMMARY = "localize the sources in a recording"

LONG_S = 20.0  # shorter recordings are done before a progress bar can be read


def configure(parser: argparse.ArgumentParser) -> None:
    from service.inference.results import METHODS

    add_recording(parser)
    add_array(parser)
    parser.add_argument("--method", choices=METHODS, help="neural where a model fits the array")
    parser.add_argument("--model", metavar="NAME", help="the model bundle")
    parser.add_argument(
        "--models", metavar="FOLDER", help="folders of further bundles, separated as in PATH"
    )
    parser.add_argument("--num-sources", metavar="M", help="the known number of sources")
    parser.add_argument("--max-sources", metavar="M", help="most sources, where it is estimated")
    parser.add_argument("--window", dest="window_s", metavar="SECONDS", help="audio per result")
    parser.add_argument("--hop", dest="hop_s", metavar="SECONDS", help="time between results")
    parser.add_argument(
        "--yaw", dest="yaw_deg", metavar="DEGREES", help="how far the array is turned on the robot"
    )
    parser.add_argument(
        "--exclude",
        dest="exclude_deg",
        metavar="FROM:TO,...",
        help="sectors in degrees in which nothing is reported",
    )
    parser.add_argument(
        "--noise",
        type=Path,
        metavar="NPZ",
        help="a profile of the robot's own noise (neuralmusic noise), which is taken away",
    )
    parser.add_argument("--plot", type=Path, metavar="PNG", help="write a picture")
    parser.add_argument("--json", action="store_true", help="print the HTTP interface's answer")
    parser.add_argument(
        "--spectrum", action="store_true", help="with --json: every window's spectrum, too"
    )


def run(args: argparse.Namespace) -> int:
    asked = _request(args)
    if args.plot:
        from service.plot import check_drawable

        check_drawable(args.plot)  # before the work, not after it
    options = asked.options
    if args.noise:
        from service.inference.noise_profile import load_noise

        options = replace(options, noise=load_noise(args.noise))
    result = _localize(args, options)
    if args.plot:
        from service.plot import save_figure

        save_figure(result, args.plot)
    if args.json:
        from service.api.schemas import LocalizationAnswer

        print(LocalizationAnswer.of(result, spectrum=asked.spectrum).to_json().decode())
    else:
        from service.cli.directions import print_result

        print_result(result)
    return 0


def _request(args: argparse.Namespace) -> LocalizeRequest:
    """The options, read and checked as those of a request."""
    from service.api.options import read_options

    pairs = [("array", array_text(args.array)), ("spectrum", str(args.spectrum))]
    numbers = ("num_sources", "max_sources", "window_s", "hop_s", "yaw_deg", "exclude_deg")
    names = ("channel_map", "method", "model", *numbers)
    given = [(name, getattr(args, name)) for name in names]
    return read_options([*pairs, *((name, text) for name, text in given if text is not None)])


def _localize(args: argparse.Namespace, options: LocalizeOptions) -> RecordingResult:
    from service.inference.recording import localize_recording
    from service.settings import load_settings
    from service.startup import load_registry

    settings = load_settings(models=args.models)
    with open_recording(args.file) as recording:
        registry = load_registry(settings)
        with _progress(recording.duration) as progress:
            return localize_recording(recording, options, registry, progress)


@contextmanager
def _progress(duration: float) -> Iterator[Callable[[float], None] | None]:
    """A bar on a terminal's standard error while a long recording is worked on."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    if duration < LONG_S or not console.is_terminal:
        yield None
        return
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task("localizing", total=1.0)
        yield lambda share: bar.update(task, completed=share)

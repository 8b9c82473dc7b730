"""``neuralmusic localize``: directions of a recording, in this process."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from neuralmusic.cli.flags import add_array
from service.cli.inputs import add_recording, open_recording
from service.cli.options import add_options, read_request
from service.machine.environment import prepare_process

if TYPE_CHECKING:
    from collections.abc import Callable

    from service.recordings.results import LocalizeOptions, RecordingResult

NAME = "localize"
SUMMARY = "localize the sources in a recording"

LONG_S = 20.0  # shorter recordings are done before anybody reads a progress bar


def configure(parser: argparse.ArgumentParser) -> None:
    add_recording(parser)
    add_array(parser)
    add_options(parser)
    parser.add_argument("--plot", type=Path, metavar="PNG", help="write a picture")
    parser.add_argument("--json", action="store_true", help="print the HTTP interface's answer")
    parser.add_argument(
        "--spectrum", action="store_true", help="with --json: every window's spectrum, too"
    )
    parser.add_argument(
        "--sphere",
        action="store_true",
        help="with --json: every window's spectrum on the sphere, where the array tells elevations",
    )


def run(args: argparse.Namespace) -> int:
    prepare_process()
    asked = read_request(args, spectrum="sphere" if args.sphere else str(args.spectrum))
    if args.plot:
        from service.cli.plot import check_drawable

        check_drawable(args.plot)  # before the work, not after it
    options = asked.options
    result = _localize(args, replace(options, spectrum=options.spectrum or bool(args.plot)))
    if args.plot:
        from service.cli.plot import save_figure

        save_figure(result, args.plot)
    if args.json:
        from service.recordings.answer_json import localization_json

        shown = _without_spectra(result) if args.plot and not options.spectrum else result
        print(localization_json(shown).decode())
    else:
        from service.cli.directions import print_result

        print_result(result)
    return 0


def _without_spectra(result: RecordingResult) -> RecordingResult:
    """The result without the spectra that only the picture needed."""
    from service.recordings.packed_windows import PackedWindows

    windows = PackedWindows(spectrum=False, sphere=True)
    for window in result.windows:
        windows.append(window)
    return replace(result, windows=windows)


def _localize(args: argparse.Namespace, options: LocalizeOptions) -> RecordingResult:
    from service.machine.memory import keep_freed_memory
    from service.recordings.localize import localize_recording
    from service.settings import load_settings
    from service.startup import load_registry

    settings = load_settings(models=args.models)
    keep_freed_memory()
    with open_recording(args.file) as recording:
        registry = load_registry(settings)
        with _progress(recording.duration) as progress:
            return localize_recording(
                recording, options, registry, progress, processes=settings.processes
            )


@contextmanager
def _progress(duration: float) -> Iterator[Callable[[float], None] | None]:
    """A bar on a terminal's standard error while a long recording is localized."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    if duration < LONG_S or not console.is_terminal:
        yield None
        return
    with Progress(console=console, transient=True) as bar:
        task = bar.add_task("localizing", total=1.0)
        yield lambda share: bar.update(task, completed=share)

"""``neuralmusic serve``: the HTTP service, a flag for every setting."""

from __future__ import annotations

import argparse

from service.machine.environment import prepare_process

NAME = "serve"
SUMMARY = "run the HTTP service"
VALUE: dict[object, str] = {int: "N", float: "SECONDS"}
"""Placeholder of a flag's value by the type of its setting"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add a flag for every setting, with the setting's docstring as its help."""
    from service.settings import RENAMED, Settings, flag, variable

    for name, field in Settings.model_fields.items():
        default = None if field.default_factory else field.default
        default = f"{default:g}" if isinstance(default, float) else default
        shown = f" (default: {default})" if default not in (None, ()) else ""
        parser.add_argument(
            flag(name),
            metavar=VALUE.get(field.annotation, name.rpartition("_")[2].upper()),
            help=f"{field.description}{shown}; {variable(name)}".replace("%", "%%"),
        )
    for name in RENAMED:
        parser.add_argument(flag(name), help=argparse.SUPPRESS)


def run(args: argparse.Namespace) -> int:
    """Serve until interrupted."""
    prepare_process()
    from neuralmusic import __version__
    from service.server import serve
    from service.settings import RENAMED, Settings, load_settings

    # Values stay text: the settings check them like those of the environment.
    names = (*Settings.model_fields, *RENAMED)
    settings = load_settings(**{name: getattr(args, name) for name in names})
    serve(settings, lambda url: print(f"neuralmusic {__version__} serves on {url}", flush=True))
    return 0

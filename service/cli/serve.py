"""``neuralmusic serve``: the HTTP service, a flag for every setting."""

from __future__ import annotations

import argparse

NAME = "serve"
SUMMARY = "run the HTTP service"


def configure(parser: argparse.ArgumentParser) -> None:
    """Flags from the settings' fields; their texts are the fields' docstrings."""
    from service.settings import Settings, variable

    for name, field in Settings.model_fields.items():
        described = (field.description or "").rstrip(".")
        default = field.default if field.default_factory is None else None
        shown = f" (default: {default})" if default not in (None, ()) else ""
        parser.add_argument(
            f"--{name.replace('_', '-')}",
            dest=name,
            metavar=name.rpartition("_")[2].upper(),
            help=f"{described}{shown}; {variable(name)}".replace("%", "%%"),
        )


def run(args: argparse.Namespace) -> int:
    """Serve until interrupted."""
    from service import __version__
    from service.server import serve
    from service.settings import Settings, load_settings

    # Values stay text: the settings check them as they check the environment.
    settings = load_settings(**{name: getattr(args, name) for name in Settings.model_fields})
    serve(settings, lambda url: print(f"neuralmusic {__version__} serves on {url}", flush=True))
    return 0

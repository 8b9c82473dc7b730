"""The command line, ``python -m model_export COMMAND``: one module per command or family.

Each module's ``add`` declares its commands; what a command needs is imported when it runs, so that
``--help`` is quick.
"""

from __future__ import annotations

from typing import Any

from model_export.cli import (
    datasets,
    evaluation,
    experiments,
    export,
    finetuning,
    measurements,
    simulation,
    training,
)


def add_commands(commands: Any) -> None:
    """Add every command to the subparsers, in the order of their use."""
    for module in (simulation, training, export, evaluation, measurements, finetuning):
        module.add(commands)
    experiments.add(commands)
    datasets.add(commands)

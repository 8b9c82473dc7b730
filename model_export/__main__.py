"""Command line of the training side: ``python -m model_export COMMAND``."""

from __future__ import annotations

import argparse
import sys

from neuralmusic.errors import DoaError
from service.machine.environment import prepare_process
from service.machine.memory import keep_all_memory


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    prepare_process()
    from model_export import cli  # with numpy, which reads what was set

    parser = argparse.ArgumentParser(prog="python -m model_export", description=__doc__)
    parser.add_argument("--threads", type=int, default=1, help="torch threads (default 1)")
    cli.add_commands(parser.add_subparsers(required=True, metavar="COMMAND"))
    arguments = parser.parse_args(argv)
    import torch  # importing it takes seconds, and --help does not need it

    torch.set_num_threads(arguments.threads)
    try:
        return arguments.run_command(arguments) or 0
    except (FileNotFoundError, ValueError, DoaError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    keep_all_memory()
    sys.exit(main())

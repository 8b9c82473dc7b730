"""The flag of the device that networks are trained on."""

from __future__ import annotations

import argparse


def add_device(parser: argparse.ArgumentParser) -> None:
    """Add ``--device``."""
    parser.add_argument("--device", help="cpu or cuda (default: cuda if available)")


def device(arguments: argparse.Namespace) -> str:
    """The device that was asked for; by default cuda if available."""
    import torch

    return arguments.device or ("cuda" if torch.cuda.is_available() else "cpu")

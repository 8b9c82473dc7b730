"""``rooms``, ``singles``, ``simulate``, ``sample``: what to train with, and what to look at."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from model_export.cli.speech import add_speech_commands, words
from service.doa.presets import PRESETS


def add(commands: Any) -> None:
    """Add the four commands."""
    rooms = commands.add_parser("rooms", help="simulate the room bank that training draws from")
    rooms.add_argument("--out", type=Path, required=True, help="folder of the chunks")
    rooms.add_argument("--chunks", type=int, default=160, help="chunks of 32 rooms")
    rooms.add_argument("--workers", type=int, default=1, help="processes")
    rooms.set_defaults(run_command=_rooms)

    singles = commands.add_parser(
        "singles", help="simulate the bank of single talkers that the paper's network learns from"
    )
    singles.add_argument("--out", type=Path, required=True, help="folder of the chunks")
    singles.add_argument("--chunks", type=int, default=36, help="chunks of 1,000 talkers")
    singles.add_argument("--array", choices=sorted(PRESETS), default="respeaker-usb-4mic-v2")
    singles.add_argument("--seed", type=int, default=0)
    add_speech_commands(singles)
    singles.set_defaults(run_command=_singles)

    simulate = commands.add_parser("simulate", help="write simulated scenes with their metadata")
    simulate.add_argument("--out", type=Path, required=True, help="folder of the scenes")
    simulate.add_argument("--count", type=int, default=10)
    simulate.add_argument("--sources", type=int, choices=range(1, 5), default=1)
    simulate.add_argument("--array", choices=sorted(PRESETS), default="respeaker-usb-4mic-v2")
    simulate.add_argument("--snr-db", type=float, default=30.0)
    simulate.add_argument(
        "--order", type=int, choices=range(11), default=4, help="image order of the paper's room"
    )
    simulate.add_argument("--seed", type=int, default=0)
    add_speech_commands(simulate, required=False, use=" (default: synthetic voices)")
    simulate.set_defaults(run_command=_simulate)

    sample = commands.add_parser("sample", help="write the sample recording of the README")
    sample.add_argument("--out", type=Path, required=True)
    sample.set_defaults(run_command=_sample)


def _rooms(arguments: argparse.Namespace) -> None:
    from model_export.simulation.rooms import write_room_bank

    write_room_bank(arguments.out, arguments.chunks, workers=arguments.workers)


def _singles(arguments: argparse.Namespace) -> None:
    from model_export.simulation.singles import write_singles

    speech = words(arguments.speech_commands, "train")
    write_singles(arguments.out, arguments.array, speech, arguments.chunks, arguments.seed)


def _simulate(arguments: argparse.Namespace) -> None:
    import numpy as np

    from model_export.simulation.protocol import SceneProtocol, write_scenes
    from model_export.simulation.synthesis import synthetic_voice

    if arguments.speech_commands:
        speech = words(arguments.speech_commands, "heldout")
    else:
        rng = np.random.default_rng(arguments.seed)
        speech = [synthetic_voice(rng, 1.0) for _ in range(20)]
    protocol = SceneProtocol(
        num_sources=arguments.sources,
        array=arguments.array,
        orders=(arguments.order, arguments.order),
        snr_db=arguments.snr_db,
    )
    write_scenes(arguments.out, protocol, speech, arguments.count, arguments.seed)


def _sample(arguments: argparse.Namespace) -> None:
    from model_export.simulation.sample import write_sample

    write_sample(arguments.out)

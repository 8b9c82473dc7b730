"""``train``: one stage of a network's training."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from model_export.cli.device import add_device, device
from model_export.cli.speech import add_corpora, add_rooms, noises, sources
from model_export.training.config import CONFIGS, TrainingConfig, smoke
from service.doa.presets import preset

if TYPE_CHECKING:
    from model_export.training.scene_stream import RoomSource, SceneSource


def add(commands: Any) -> None:
    """Add the command."""
    train = commands.add_parser("train", help="train a network, or continue its run")
    train.add_argument("--config", choices=sorted(CONFIGS), default="any-array")
    train.add_argument("--run", type=Path, required=True, help="folder of the run")
    train.add_argument("--init", type=Path, help="run to start from, where the config wants one")
    add_device(train)
    train.add_argument("--workers", type=int, default=1, help="processes that simulate scenes")
    train.add_argument("--smoke", action="store_true", help="a few steps only, to try it out")
    train.add_argument(
        "--recordings", type=Path, help="unlabelled recordings instead of simulated scenes (sscl)"
    )
    add_rooms(train, use=", where the config draws arrays")
    add_corpora(train, required=False)
    train.set_defaults(run_command=_train)


def _train(arguments: argparse.Namespace) -> None:
    from model_export.training.train import train

    config = CONFIGS[arguments.config]
    scenes = _recorded if arguments.recordings else _simulated
    train(
        smoke(config) if arguments.smoke else config,
        arguments.run,
        *scenes(arguments, config),
        init=arguments.init,
        workers=arguments.workers,
        device=device(arguments),
    )


def _simulated(
    arguments: argparse.Namespace, config: TrainingConfig
) -> tuple[SceneSource, SceneSource]:
    """Scenes to train on and scenes to validate with, of other rooms and speakers."""
    from model_export.simulation.array_rooms import ArrayRooms
    from model_export.simulation.room_bank import RoomBank
    from model_export.training.scene_stream import SimulatedScenes

    if arguments.speech_commands is None:
        raise ValueError("simulated scenes need speech: name its folder with --speech-commands")
    rooms: list[RoomSource]
    if config.array is not None:
        rooms = [ArrayRooms(preset(config.array))] * 2
    elif arguments.rooms is not None:
        rooms = [RoomBank(arguments.rooms), RoomBank(arguments.rooms, validation=True)]
    else:
        raise ValueError(f"{config.name} draws from a room bank: name its folder with --rooms")
    return (
        SimulatedScenes(rooms[0], sources(arguments, "train"), noises(arguments)),
        SimulatedScenes(rooms[1], sources(arguments, "development"), noises(arguments)),
    )


def _recorded(
    arguments: argparse.Namespace, config: TrainingConfig
) -> tuple[SceneSource, SceneSource]:
    """The same two of unlabelled recordings."""
    from model_export.training.recorded_scenes import RecordedScenes

    if config.variant != "sscl" or config.array is None:
        raise ValueError(
            f"{config.name} learns from directions, which recordings do not tell: use --recordings "
            "with a self-supervised configuration, such as paper-sscl"
        )
    return RecordedScenes.split(arguments.recordings, preset(config.array))

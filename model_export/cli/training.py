"""``train``: one stage of a network's training."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from model_export.cli.device import add_device, device
from model_export.cli.speech import add_corpora, add_rooms, noises, sources, words
from model_export.training.config import CONFIGS, TrainingConfig, smoke
from service.doa.presets import preset

if TYPE_CHECKING:
    from model_export.training.scene_stream import SceneSource

OVERRIDES = ("steps", "batch_size", "final_batch_size", "learning_rate", "seed")
"""Fields of a configuration that have a flag of their own"""


def add(commands: Any) -> None:
    """Add the command."""
    train = commands.add_parser("train", help="train a network, or continue its run")
    train.add_argument("--config", choices=sorted(CONFIGS), default="any-array")
    train.add_argument("--run", type=Path, required=True, help="folder of the run")
    train.add_argument(
        "--init",
        type=Path,
        metavar="RUN",
        help="run or bundle to start from: the one that the config names, or one to train further",
    )
    train.add_argument(
        "--scratch", action="store_true", help="start from no run, where the config wants one"
    )
    for name, kind in (("steps", int), ("batch-size", int), ("learning-rate", float)):
        train.add_argument(f"--{name}", type=kind, help="overrides the configuration's")
    train.add_argument("--final-batch-size", type=int, help="scenes per step in the last tenth")
    train.add_argument("--seed", type=int, help="overrides the configuration's")
    train.add_argument(
        "--mean-fusion",
        action="store_true",
        help="take the mean over bins instead of their attention, the ablation of FAF (regression)",
    )
    train.add_argument(
        "--noisy",
        type=float,
        metavar="SHARE",
        help="share of scenes at -10 to 30 dB (0.6 in the paper's code)",
    )
    add_device(train)
    train.add_argument(
        "--workers",
        type=int,
        default=1,
        help="processes that make scenes; 0 makes them in this one",
    )
    train.add_argument("--smoke", action="store_true", help="a few steps only, to try it out")
    train.add_argument(
        "--recordings", type=Path, help="unlabelled recordings instead of simulated scenes (sscl)"
    )
    add_rooms(train, use=", where the config draws arrays")
    train.add_argument(
        "--singles",
        type=Path,
        metavar="DIR",
        help="folder of single talkers, for a configuration that adds them up",
    )
    add_corpora(train, required=False)
    train.set_defaults(run_command=_train)


def _train(arguments: argparse.Namespace) -> None:
    from model_export.export.parameters import trained_task
    from model_export.training.train import train

    config = _configuration(arguments)
    init = trained_task(arguments.init, config.scenes.known_count) if arguments.init else None
    if init and init.task.config.variant == config.variant:
        config = replace(config, earlier_scenes=init.record["scenes"])
    if arguments.recordings:
        scenes = _recorded(arguments, config)
    elif arguments.speech_commands is None:
        raise ValueError("simulated scenes need speech: name its folder with --speech-commands")
    else:
        scenes = (_summed if config.singles else _simulated)(arguments, config)
    train(
        config,
        arguments.run,
        *scenes,
        init=init.task if init else None,
        workers=arguments.workers,
        device=device(arguments),
    )


def _configuration(arguments: argparse.Namespace) -> TrainingConfig:
    """The named configuration, with what the flags say otherwise."""
    config = CONFIGS[arguments.config]
    config = smoke(config) if arguments.smoke else config
    given = {name: getattr(arguments, name) for name in OVERRIDES}
    config = replace(config, **{name: value for name, value in given.items() if value is not None})
    if arguments.noisy is not None:
        config = replace(config, scenes=replace(config.scenes, noisy=arguments.noisy))
    if arguments.mean_fusion:
        config = replace(config, attention=False)
    return replace(config, starts_from=None) if arguments.scratch else config


def _summed(
    arguments: argparse.Namespace, config: TrainingConfig
) -> tuple[SceneSource, SceneSource]:
    """Scenes to train on and scenes to validate with, of other rooms and speakers."""
    from model_export.simulation.singles import SinglesBank
    from model_export.training.scene_stream import ProtocolScenes, SummedScenes

    assert config.array is not None
    if arguments.singles is None:
        raise ValueError(f"{config.name} adds single talkers: name their folder with --singles")
    return (
        SummedScenes(SinglesBank(arguments.singles, config.array)),
        ProtocolScenes(config.array, words(arguments.speech_commands, "development")),
    )


def _simulated(
    arguments: argparse.Namespace, config: TrainingConfig
) -> tuple[SceneSource, SceneSource]:
    """The same two in the rooms of a bank."""
    from model_export.simulation.room_bank import RoomBank
    from model_export.training.scene_stream import SimulatedScenes

    if arguments.rooms is None:
        raise ValueError(f"{config.name} draws from a room bank: name its folder with --rooms")
    bank, held = RoomBank(arguments.rooms), RoomBank(arguments.rooms, validation=True)
    return (
        SimulatedScenes(bank, sources(arguments, "train"), noises(arguments)),
        SimulatedScenes(held, sources(arguments, "development"), noises(arguments)),
    )


def _recorded(
    arguments: argparse.Namespace, config: TrainingConfig
) -> tuple[SceneSource, SceneSource]:
    """Unlabelled recordings to train on, and others to validate with."""
    from model_export.training.recorded_scenes import RecordedScenes

    if config.variant != "sscl" or config.array is None:
        raise ValueError(
            f"{config.name} learns from directions, but recordings have no labels: use "
            "--recordings with a self-supervised configuration, such as paper-sscl"
        )
    return RecordedScenes.split(arguments.recordings, preset(config.array))

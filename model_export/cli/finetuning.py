"""``finetune`` and ``own-room``: fit a bundle to one's own room, simulate such a room."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from model_export.cli.speech import add_rooms, add_speech_commands, words
from service.doa.presets import PRESETS, preset


def add(commands: Any) -> None:
    """Add both commands."""
    tune = commands.add_parser("finetune", help="fine-tune a bundle on labelled recordings")
    tune.add_argument("--bundle", type=Path, required=True, help="folder of the bundle")
    tune.add_argument("--recordings", type=Path, required=True, help="folder with labels.csv")
    tune.add_argument(
        "--array", required=True, metavar="NAME|JSON|@FILE", help="array of the recordings"
    )
    tune.add_argument(
        "--channel-map", metavar="0,1,...", help="recording channel of every microphone"
    )
    tune.add_argument("--test", type=Path, help="folder of further recordings, for scores only")
    tune.add_argument("--out", type=Path, required=True, help="folder of the new bundle")
    tune.add_argument("--name", help="the new bundle's name (default: OLD-finetuned)")
    tune.add_argument("--steps", type=int, default=100, help="optimizer steps (default 100)")
    tune.add_argument("--learning-rate", type=float, help="learning rate of the network")
    tune.add_argument(
        "--validation-share",
        type=float,
        default=0.2,
        help="share of directions that validate (default 0.2)",
    )
    tune.add_argument("--seed", type=int, default=1)
    tune.add_argument(
        "--force", action="store_true", help="write the bundle even if it is no better"
    )
    add_rooms(tune, use=", to mix simulated scenes in")
    add_speech_commands(tune, required=False, use=", for these scenes")
    tune.set_defaults(run_command=_finetune)

    own = commands.add_parser("own-room", help="simulate recordings to try fine-tuning on")
    own.add_argument("--out", type=Path, required=True, help="folder of recordings/ and test/")
    own.add_argument("--array", choices=sorted(PRESETS), default="respeaker-usb-4mic-v2")
    own.add_argument("--directions", type=int, default=36, help="directions (default 36)")
    own.add_argument("--seed", type=int, default=1)
    add_speech_commands(own)
    own.set_defaults(run_command=_own_room)


def _finetune(arguments: argparse.Namespace) -> None:
    from model_export.finetuning.finetune import FineTuning
    from model_export.finetuning.run import finetune_run
    from service.cli.inputs import read_array

    if (arguments.rooms is None) != (arguments.speech_commands is None):
        raise ValueError("simulated scenes need both --rooms and --speech-commands: add the other")
    finetune_run(
        arguments.bundle,
        arguments.recordings,
        read_array(arguments.array),
        arguments.out,
        FineTuning(
            steps=arguments.steps,
            learning_rate=arguments.learning_rate,
            validation_share=arguments.validation_share,
            seed=arguments.seed,
        ),
        name=arguments.name,
        channel_map=arguments.channel_map,
        rooms=arguments.rooms,
        speech=words(arguments.speech_commands, "train") if arguments.rooms else (),
        test=arguments.test,
        force=arguments.force,
    )


def _own_room(arguments: argparse.Namespace) -> None:
    from model_export.finetuning.own_room import write_own_room

    write_own_room(
        arguments.out,
        preset(arguments.array),
        words(arguments.speech_commands, "train"),
        words(arguments.speech_commands, "development"),
        directions=arguments.directions,
        seed=arguments.seed,
    )

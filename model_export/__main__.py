"""Command line of the training side: ``python -m model_export rooms|train|export|evaluate|...``."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from model_export.cli.datasets import add_datasets
from model_export.cli.experiments import add_commands
from model_export.datasets.noise import noise_recordings
from model_export.datasets.speech import Split, librispeech, load, speech_commands
from model_export.simulation.synthesis import sound_bursts
from model_export.training.config import CONFIGS, TrainingConfig, smoke
from model_export.training.scene_stream import SceneSource
from service.doa.presets import PRESETS, preset
from service.doa.types import FloatArray
from service.errors import DoaError

if TYPE_CHECKING:
    from model_export.evaluation.results import Results
    from model_export.evaluation.workers import Workers

LIBRISPEECH_REPEATS = 6
"""Utterances stand this often among the words, so that a tenth of the scenes is running speech"""
EVENT_REPEATS = 5
"""Barks and cries among the words: one source in twenty"""
BURSTS = 300
"""Synthetic sounds that are no speech: one source in sixteen"""


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit status."""
    arguments = _parser().parse_args(argv)
    torch.set_num_threads(arguments.threads)
    try:
        status = arguments.run_command(arguments)
    except (FileNotFoundError, ValueError, DoaError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return status or 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m model_export", description=__doc__)
    parser.add_argument("--threads", type=int, default=1, help="torch threads (default 1)")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    rooms = commands.add_parser("rooms", help="simulate the room bank that training draws from")
    rooms.add_argument("--out", type=Path, required=True, help="folder of the chunks")
    rooms.add_argument("--chunks", type=int, default=160, help="chunks of 32 rooms")
    rooms.add_argument("--workers", type=int, default=1, help="processes")
    rooms.set_defaults(run_command=_rooms)

    train = commands.add_parser("train", help="train a network, or continue its run")
    train.add_argument("--config", choices=sorted(CONFIGS), default="any-array")
    train.add_argument("--run", type=Path, required=True, help="folder of the run")
    train.add_argument("--init", type=Path, help="run to start from, where the config wants one")
    train.add_argument("--device", help="cpu or cuda (default: cuda where there is one)")
    train.add_argument("--workers", type=int, default=1, help="processes that simulate scenes")
    train.add_argument("--smoke", action="store_true", help="a few steps only, to try it out")
    train.add_argument("--rooms", type=Path, help="room bank, where the config draws arrays")
    train.add_argument(
        "--recordings", type=Path, help="unlabelled recordings instead of simulated scenes (sscl)"
    )
    _add_speech(train, required=False)
    train.set_defaults(run_command=_train)

    export = commands.add_parser("export", help="train the source count and write a bundle")
    export.add_argument("--run", type=Path, required=True, help="folder of the trained run")
    export.add_argument("--out", type=Path, required=True, help="folder of the bundle")
    export.add_argument("--name", help="the bundle's name (default: the configuration's)")
    export.add_argument("--version", default="0.1.0")
    export.add_argument("--counting-scenes", type=int, default=16000)
    export.add_argument(
        "--source-count", type=Path, metavar="BUNDLE", help="take this bundle's, train none"
    )
    export.add_argument("--rooms", type=Path, required=True, help="folder of the room bank")
    _add_speech(export, required=True)
    export.set_defaults(run_command=_export)

    evaluate = commands.add_parser("evaluate", help="score bundles and classical methods")
    evaluate.add_argument("--bundle", type=Path, nargs="*", default=[], help="bundle folders")
    evaluate.add_argument("--speech-commands", type=Path, required=True)
    evaluate.add_argument("--scenes", type=int, default=500, help="scenes a cell (default 500)")
    evaluate.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    evaluate.add_argument(
        "--cells", metavar="PATTERN", help="only cells like 'M=2*', '60 s*', 'reliability'; printed"
    )
    evaluate.add_argument(
        "--split", choices=("heldout", "development"), default="heldout", help="speakers"
    )
    evaluate.add_argument(
        "--noise", type=Path, nargs="*", default=[], help="steady recordings, as further noises"
    )
    evaluate.add_argument("--out", type=Path, help="folder of the tables (default: only print)")
    evaluate.add_argument(
        "--write-scores", action="store_true", help="put the scores into the bundles' manifests"
    )
    evaluate.add_argument("--figures", type=int, metavar="N", help="draw, with N scenes a point")
    evaluate.add_argument("--readme", type=Path, help="README whose results table to renew")
    evaluate.set_defaults(run_command=_evaluate)

    simulate = commands.add_parser("simulate", help="write simulated scenes with their metadata")
    simulate.add_argument("--out", type=Path, required=True)
    simulate.add_argument("--count", type=int, default=10)
    simulate.add_argument("--sources", type=int, choices=range(1, 5), default=1)
    simulate.add_argument("--array", choices=sorted(PRESETS), default="respeaker-usb-4mic-v2")
    simulate.add_argument("--snr-db", type=float, default=30.0)
    simulate.add_argument(
        "--order", type=int, choices=range(11), default=4, help="image order of the paper's room"
    )
    simulate.add_argument("--seed", type=int, default=0)
    simulate.add_argument("--speech-commands", type=Path, help="default: synthetic voices")
    simulate.set_defaults(run_command=_simulate)

    _add_finetune(commands)
    _add_own_room(commands)
    add_commands(commands)
    add_datasets(commands)

    sample = commands.add_parser("sample", help="write the sample recording of the README")
    sample.add_argument("--out", type=Path, required=True)
    sample.set_defaults(run_command=_sample)
    return parser


def _add_finetune(commands: Any) -> None:
    tune = commands.add_parser("finetune", help="fine-tune a bundle on labelled recordings")
    tune.add_argument("--bundle", type=Path, required=True, help="folder of the bundle")
    tune.add_argument("--recordings", type=Path, required=True, help="folder with labels.csv")
    tune.add_argument("--array", required=True, metavar="NAME|JSON|@FILE", help="their array")
    tune.add_argument("--channel-map", metavar="0,1,...", help="their channel of every microphone")
    tune.add_argument("--test", type=Path, help="folder of further recordings that only score")
    tune.add_argument("--out", type=Path, required=True, help="folder of the new bundle")
    tune.add_argument("--name", help="the new bundle's name (default: the old one's -finetuned)")
    tune.add_argument("--steps", type=int, default=100)
    tune.add_argument("--learning-rate", type=float, help="of the network")
    tune.add_argument("--validation-share", type=float, default=0.2, help="of the directions")
    tune.add_argument("--seed", type=int, default=1)
    tune.add_argument("--force", action="store_true", help="write a bundle that is no better, too")
    tune.add_argument("--rooms", type=Path, help="room bank, to mix simulated scenes in")
    tune.add_argument("--speech-commands", type=Path, help="corpus folder for these scenes")
    tune.set_defaults(run_command=_finetune, librispeech=None, noise=None)


def _add_own_room(commands: Any) -> None:
    own = commands.add_parser("own-room", help="simulate recordings to try fine-tuning on")
    own.add_argument("--out", type=Path, required=True, help="folder of recordings/ and test/")
    own.add_argument("--array", choices=sorted(PRESETS), default="respeaker-usb-4mic-v2")
    own.add_argument("--directions", type=int, default=36)
    own.add_argument("--seed", type=int, default=1)
    own.add_argument("--speech-commands", type=Path, required=True, help="corpus folder")
    own.set_defaults(run_command=_own_room, librispeech=None, noise=None)


def _add_speech(parser: argparse.ArgumentParser, *, required: bool) -> None:
    parser.add_argument("--speech-commands", type=Path, required=required, help="corpus folder")
    parser.add_argument("--librispeech", type=Path, help="folder of utterances, optional")
    parser.add_argument("--noise", type=Path, help="folder of noise recordings, optional")


def _speech(arguments: argparse.Namespace, split: Split) -> list[FloatArray]:
    audio = load(speech_commands(arguments.speech_commands, split))
    if arguments.librispeech and split == "train":
        audio += load(librispeech(arguments.librispeech, split)) * LIBRISPEECH_REPEATS
    if arguments.noise and split == "train":
        audio += noise_recordings(arguments.noise, "events") * EVENT_REPEATS
        rng = np.random.default_rng(0)
        audio += [sound_bursts(rng, 2.0) for _ in range(BURSTS)]
    return audio


def _noises(arguments: argparse.Namespace) -> list[FloatArray]:
    return noise_recordings(arguments.noise, "steady") if arguments.noise else []


def _rooms(arguments: argparse.Namespace) -> None:
    from model_export.simulation.rooms import write_room_bank

    write_room_bank(arguments.out, arguments.chunks, workers=arguments.workers)


def _train(arguments: argparse.Namespace) -> None:
    from model_export.training.train import train

    config = CONFIGS[arguments.config]
    sources = _recorded if arguments.recordings else _simulated
    train(
        smoke(config) if arguments.smoke else config,
        arguments.run,
        *sources(arguments, config),
        init=arguments.init,
        workers=arguments.workers,
        device=arguments.device or ("cuda" if torch.cuda.is_available() else "cpu"),
    )


def _simulated(
    arguments: argparse.Namespace, config: TrainingConfig
) -> tuple[SceneSource, SceneSource]:
    """Scenes to train on and scenes to validate with, of other rooms and speakers."""
    from model_export.simulation.array_rooms import ArrayRooms
    from model_export.simulation.room_bank import RoomBank
    from model_export.training.scene_stream import RoomSource, SimulatedScenes

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
        SimulatedScenes(rooms[0], _speech(arguments, "train"), _noises(arguments)),
        SimulatedScenes(rooms[1], _speech(arguments, "development"), _noises(arguments)),
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


def _export(arguments: argparse.Namespace) -> None:
    from model_export.export.run import export_run

    corpora = {"Google Speech Commands, training speakers": "CC BY 4.0"}
    if arguments.librispeech:
        corpora["LibriSpeech, training speakers"] = "CC BY 4.0"
    if arguments.noise:
        corpora["ESC-10 and the background noise of Speech Commands"] = "CC BY 3.0, CC BY 4.0"
    manifest = export_run(
        arguments.run,
        arguments.out,
        name=arguments.name,
        version=arguments.version,
        rooms=arguments.rooms,
        speech=_speech(arguments, "train"),
        validation_speech=_speech(arguments, "development"),
        counting_scenes=arguments.counting_scenes,
        source_count=arguments.source_count,
        noises=_noises(arguments),
        data=list(corpora),
        licences=[f"{corpus}: {licence}" for corpus, licence in corpora.items()],
    )
    print(json.dumps({"training": manifest.training, "parity": manifest.parity}, indent=2))


def _evaluate(arguments: argparse.Namespace) -> None:
    from model_export.evaluation.evaluate import SEEDS, evaluate
    from model_export.evaluation.methods import Methods
    from model_export.evaluation.workers import Inputs, Workers

    _check_writing(arguments)
    speech = load(speech_commands(arguments.speech_commands, arguments.split))
    inputs = Inputs(Methods(arguments.bundle), speech, SEEDS[arguments.split])
    with Workers(inputs, arguments.workers) as workers:
        results = evaluate(
            workers, arguments.scenes, pattern=arguments.cells or "*", recordings=arguments.noise
        )
        results.split = arguments.split
        print(results.tables())
        if arguments.out:
            _write_results(arguments, workers, results)


def _check_writing(arguments: argparse.Namespace) -> None:
    """Only a whole run on the held-out speakers becomes the documents' truth."""
    partial = arguments.cells is not None or arguments.split != "heldout"
    if partial and (arguments.out or arguments.write_scores):
        raise ValueError(
            "--cells and --split development only print: leave --out and --write-scores out"
        )
    if not arguments.out and (arguments.write_scores or arguments.figures or arguments.readme):
        raise ValueError("--write-scores, --figures and --readme need --out, where results.json is")


def _write_results(arguments: argparse.Namespace, workers: Workers, results: Results) -> None:
    from model_export.evaluation.figures import draw
    from model_export.evaluation.results import update_readme
    from model_export.export.bundle import update_scores
    from service.inference.bundle import read_manifest

    results.write(arguments.out)
    if arguments.figures:
        draw(arguments.out, workers, arguments.figures, results)
    if arguments.readme:
        update_readme(arguments.readme, results)
    if arguments.write_scores:
        for folder in arguments.bundle:
            update_scores(folder, results.bundle_scores(read_manifest(folder)[0].name))


def _simulate(arguments: argparse.Namespace) -> None:
    from model_export.simulation.protocol import SceneProtocol, write_scenes
    from model_export.simulation.synthesis import synthetic_voice

    if arguments.speech_commands:
        speech = load(speech_commands(arguments.speech_commands, "heldout"))
    else:
        rng = np.random.default_rng(arguments.seed)
        speech = [synthetic_voice(rng, 1.0) for _ in range(20)]
    protocol = SceneProtocol(
        num_sources=arguments.sources,
        array=preset(arguments.array).name,
        orders=(arguments.order, arguments.order),
        snr_db=arguments.snr_db,
    )
    write_scenes(arguments.out, protocol, speech, arguments.count, arguments.seed)


def _finetune(arguments: argparse.Namespace) -> None:
    from model_export.finetuning.finetune import FineTuning
    from model_export.finetuning.run import finetune_run
    from service.cli.inputs import read_array

    if (arguments.rooms is None) != (arguments.speech_commands is None):
        raise ValueError("simulated scenes take both --rooms and --speech-commands")
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
        speech=_speech(arguments, "train") if arguments.rooms else (),
        test=arguments.test,
        force=arguments.force,
    )


def _own_room(arguments: argparse.Namespace) -> None:
    from model_export.finetuning.own_room import write_own_room

    write_own_room(
        arguments.out,
        preset(arguments.array),
        _speech(arguments, "train"),
        _speech(arguments, "development"),
        directions=arguments.directions,
        seed=arguments.seed,
    )


def _sample(arguments: argparse.Namespace) -> None:
    from model_export.simulation.sample import write_sample

    write_sample(arguments.out)


if __name__ == "__main__":
    sys.exit(main())

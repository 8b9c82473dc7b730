"""The corpora: flags with the same names in every command, and functions that read them."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from model_export.datasets.speech import Split
    from service.doa.types import FloatArray

LIBRISPEECH_REPEATS = 6
"""Copies of each utterance among the words: a tenth of the scenes is running speech"""
EVENT_REPEATS = 5
"""Copies of each bark or cry among the words: one source in twenty"""
BURSTS = 300
"""Number of synthetic sounds that are no speech: one source in sixteen"""


def add_speech_commands(
    parser: argparse.ArgumentParser, *, required: bool = True, use: str = ""
) -> None:
    """Add the flag of Google Speech Commands; ``use`` adds its purpose to the help."""
    text = f"folder of Google Speech Commands{use}"
    parser.add_argument("--speech-commands", type=Path, required=required, metavar="DIR", help=text)


def add_librispeech(parser: argparse.ArgumentParser, *, required: bool = True) -> None:
    """Add the flag of LibriSpeech."""
    text = "folder of LibriSpeech utterances" + ("" if required else ", optional")
    parser.add_argument("--librispeech", type=Path, required=required, metavar="DIR", help=text)


def add_corpora(parser: argparse.ArgumentParser, *, required: bool) -> None:
    """Add the flags of all corpora that a training reads."""
    add_speech_commands(parser, required=required)
    add_librispeech(parser, required=False)
    parser.add_argument(
        "--noise", type=Path, metavar="DIR", help="folder of noise recordings, optional"
    )


def add_rooms(parser: argparse.ArgumentParser, *, required: bool = False, use: str = "") -> None:
    """Add the flag of the room bank; ``use`` adds its purpose to the help."""
    text = f"folder of the room bank{use}"
    parser.add_argument("--rooms", type=Path, required=required, metavar="DIR", help=text)


def words(folder: Path, split: Split) -> list[FloatArray]:
    """The words of one split of Speech Commands."""
    from model_export.datasets.speech import load, speech_commands

    return load(speech_commands(folder, split))


def utterances(folder: Path, split: Split) -> list[FloatArray]:
    """The utterances of one split of LibriSpeech.

    Raises
    ------
    FileNotFoundError
        If there are none.
    """
    from model_export.datasets.speech import librispeech, load

    speech = load(librispeech(folder, split))
    if not speech:
        raise FileNotFoundError(f"{folder} holds no {split} utterances")
    return speech


def sources(arguments: argparse.Namespace, split: Split) -> list[FloatArray]:
    """Sources of scenes: words and, for training, utterances, sound events and bursts."""
    import numpy as np

    from model_export.datasets.noise import noise_recordings
    from model_export.datasets.speech import librispeech, load
    from model_export.simulation.synthesis import sound_bursts

    audio = words(arguments.speech_commands, split)
    if arguments.librispeech and split == "train":
        audio += load(librispeech(arguments.librispeech, split)) * LIBRISPEECH_REPEATS
    if arguments.noise and split == "train":
        audio += noise_recordings(arguments.noise, "events") * EVENT_REPEATS
        rng = np.random.default_rng(0)
        audio += [sound_bursts(rng, 2.0) for _ in range(BURSTS)]
    return audio


def noises(arguments: argparse.Namespace) -> list[FloatArray]:
    """Steady recordings that are the noise of scenes."""
    from model_export.datasets.noise import noise_recordings

    return noise_recordings(arguments.noise, "steady") if arguments.noise else []


def licences(arguments: argparse.Namespace) -> dict[str, str]:
    """Licence by name of every corpus that a training was given."""
    found = {"Google Speech Commands, training speakers": "CC BY 4.0"}
    if arguments.librispeech:
        found["LibriSpeech, training speakers"] = "CC BY 4.0"
    if arguments.noise:
        found["ESC-10 and the background noise of Speech Commands"] = "CC BY 3.0, CC BY 4.0"
    return found

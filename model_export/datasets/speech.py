"""Dry speech for simulation: Google Speech Commands and LibriSpeech, split by speaker.

Speech Commands (arXiv 1804.03209, CC BY 4.0) unpacks to ``<word>/<speaker>_nohash_<k>.wav`` with
``validation_list.txt`` and ``testing_list.txt``; background noise is left out. LibriSpeech
utterances are ``<anything>_<speaker>.flac`` or ``<speaker>-<chapter>-<k>.flac``. FLAC copies in the
same layout are read as well.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import soundfile

from model_export import SAMPLE_RATE
from service.doa.types import FloatArray

Split = Literal["train", "development", "heldout"]
DEVELOPMENT_SHARE = 0.05
"""Share of the training speakers that is kept for choosing checkpoints and tuning"""


@dataclass(frozen=True, slots=True)
class Clip:
    """One recording of one speaker."""

    path: Path
    speaker: str


def speech_commands(folder: Path, split: Split) -> list[Clip]:
    """Clips of one split; no speaker is in two splits.

    ``heldout`` has the speakers of ``validation_list.txt`` and ``testing_list.txt``, only for
    scores. A hash of the name divides the others into ``development`` and ``train``.
    """
    listed = {
        Path(line).stem
        for name in ("validation_list.txt", "testing_list.txt")
        if (folder / name).exists()
        for line in (folder / name).read_text().split()
    }
    heldout = {stem.split("_nohash_")[0] for stem in listed}
    if not heldout:
        raise FileNotFoundError(
            f"{folder} holds neither validation_list.txt nor testing_list.txt: name the folder "
            "that Speech Commands unpacks to"
        )
    clips = []
    for path in sorted(folder.glob("*/*_nohash_*")):
        if path.suffix not in {".wav", ".flac"} or path.parent.name.startswith("_"):
            continue
        speaker = path.stem.split("_nohash_")[0]
        if _split_of(speaker, speaker in heldout) == split:
            clips.append(Clip(path, speaker))
    if not clips:
        raise FileNotFoundError(f"no {split} clips <word>/<speaker>_nohash_<k> below {folder}")
    return clips


def librispeech(folder: Path, split: Split) -> list[Clip]:
    """Utterances of one split; a tenth of the speakers is held out, chosen by a hash."""
    clips = []
    for path in sorted([*folder.rglob("*.flac"), *folder.rglob("*.wav")]):
        speaker = path.stem.split("-")[0].split("_")[-1]
        if _split_of(speaker, _share(speaker, "heldout") < 0.1) == split:
            clips.append(Clip(path, f"librispeech-{speaker}"))
    return clips


def load(clips: Sequence[Clip]) -> list[FloatArray]:
    """All clips in order, as float32 mono audio of unit peak; silent clips are left out."""
    audio = []
    for clip in clips:
        samples, rate = soundfile.read(clip.path, dtype="float32")
        if rate != SAMPLE_RATE or samples.ndim != 1:
            raise ValueError(f"{clip.path}: expected mono audio at {SAMPLE_RATE} Hz")
        peak = np.abs(samples).max(initial=0.0)
        if peak > 1e-3:
            audio.append(samples / peak)
    return audio


def _share(speaker: str, purpose: str) -> float:
    digest = hashlib.sha256(f"{purpose}:{speaker}".encode()).digest()
    return int.from_bytes(digest[:8], "big") / 2**64


def _split_of(speaker: str, heldout: bool) -> Split:
    if heldout:
        return "heldout"
    return "development" if _share(speaker, "development") < DEVELOPMENT_SHARE else "train"

"""Recorded noise and sound events: ESC-10 (CC BY 3.0) and long recordings of one's own.

ESC-10 clips are ``<Class>_<k>.flac`` or ``.wav``; every other file of the folder counts as steady
noise. Steady classes are heard as noise, from all around or as a machine in the room; events such
as barks are sources of their own, cut to where they sound.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import soundfile

from model_export import SAMPLE_RATE
from service.doa.types import FloatArray

EVENTS = ("Baby_cry", "Dog_bark", "Person_sneeze", "Rooster")
UNSTEADY = ("Clock_tick", "Fire_crackling", "Chainsaw", "doing_the_dishes")
"""Neither steady nor from one place for certain: left out"""
ACTIVE_FRAME = 800
ACTIVE_DB = 30.0
"""Frames that are quieter than this below the loudest are cut out of events"""


def noise_recordings(folder: Path, kind: Literal["steady", "events"]) -> list[FloatArray]:
    """All recordings of one kind below a folder, float32 mono of unit peak."""
    recordings = []
    for path in sorted([*folder.rglob("*.flac"), *folder.rglob("*.wav")]):
        event = path.stem.startswith(EVENTS)
        if path.stem.startswith(UNSTEADY) or event != (kind == "events"):
            continue
        audio, rate = soundfile.read(path, dtype="float32")
        if rate != SAMPLE_RATE or audio.ndim != 1:
            raise ValueError(f"{path}: expected mono audio at {SAMPLE_RATE} Hz")
        audio = active(audio) if event else audio
        peak = float(np.abs(audio).max(initial=0.0))
        if peak > 1e-3 and len(audio) >= ACTIVE_FRAME:
            recordings.append(audio / peak)
    if not recordings:
        raise FileNotFoundError(f"no recordings of {kind} below {folder}")
    return recordings


def active(audio: FloatArray) -> FloatArray:
    """The frames of (T,) audio that are not much quieter than the loudest."""
    frames = audio[: len(audio) // ACTIVE_FRAME * ACTIVE_FRAME].reshape(-1, ACTIVE_FRAME)
    power = np.square(frames).mean(axis=1)
    kept: FloatArray = frames[power > power.max(initial=0.0) * 10 ** (-ACTIVE_DB / 10)].ravel()
    return kept

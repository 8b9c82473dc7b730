"""Recorded noise and sound events: ESC-10 (CC BY 3.0) and one's own long recordings.

ESC-10 clips are ``<Class>_<k>.flac`` or ``.wav``; every other file of the folder counts as steady
noise. Steady classes become diffuse noise or a machine in the room; events such as barks become
sources, cut to their active frames.
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
"""Classes that are left out: neither steady nor certainly from one place"""
ACTIVE_FRAME = 800
ACTIVE_DB = 30.0
"""Frames of an event this far below its loudest one, or farther, are cut out"""


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
    """Audio (T,) without its frames that are ``ACTIVE_DB`` below the loudest one."""
    frames = audio[: len(audio) // ACTIVE_FRAME * ACTIVE_FRAME].reshape(-1, ACTIVE_FRAME)
    power = np.square(frames).mean(axis=1)
    kept: FloatArray = frames[power > power.max(initial=0.0) * 10 ** (-ACTIVE_DB / 10)].ravel()
    return kept

"""Held-out recordings: their choice, and the service's scores on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from rich.progress import track

from model_export.finetuning.labelled_recordings import LabelledRecording
from model_export.finetuning.labelled_scenes import LabelledScenes
from model_export.simulation.scene_config import SceneConfig
from model_export.simulation.scenes import Scene
from service.doa.array import MicrophoneArray
from service.doa.scoring import evaluate
from service.inference.bundle import Bundle
from service.inference.localizer import localizer_of
from service.recordings.results import DEFAULT_MAX_SOURCES

WINDOWS_PER_RECORDING = 6
ADDED_NOISE_DB = 0.0
"""Signal-to-noise ratio of the windows with added noise"""

AS_RECORDED = "as recorded"

Rows = Mapping[str, Sequence[Scene]]
"""Windows by the name of their row in the table"""
Scores = Mapping[str, Mapping[str, float]]
"""Scores by row: ``windows``, ``maae_deg`` and so on (``scoring.evaluate``) with the count known,
``count_accuracy`` with the count unknown"""


def hold_out(
    recordings: Sequence[LabelledRecording], share: float
) -> tuple[list[LabelledRecording], list[LabelledRecording]]:
    """Split recordings into those to train on and those to score: every k-th direction is held out.

    A direction that was trained on would score memorised recordings.

    Raises
    ------
    ValueError
        If there are too few directions.
    """
    directions = sorted({recording.direction for recording in recordings})
    step = round(1 / share)
    held = set(directions[step // 2 :: step])
    if not held or len(held) == len(directions):
        raise ValueError(
            f"one direction in {step} is held out for scores, but the recordings have only "
            f"{len(directions)}: record more directions, or change --validation-share"
        )
    return (
        [recording for recording in recordings if recording.direction not in held],
        [recording for recording in recordings if recording.direction in held],
    )


def score_rows(scenes: LabelledScenes, seed: int) -> dict[str, list[Scene]]:
    """Windows as recorded, windows with the room's noise added, and mixtures of two talkers."""
    rng = np.random.default_rng([seed, 1])
    recorded = scenes.windows(WINDOWS_PER_RECORDING)
    noisy = [scenes.with_noise(rng, scene, ADDED_NOISE_DB) for scene in recorded]
    rows = {AS_RECORDED: recorded, f"{ADDED_NOISE_DB:g} dB noise added": noisy}
    mixed = [scenes.mix(rng, scene, SceneConfig()) for scene in recorded]
    pairs = [pair for pair, alone in zip(mixed, recorded, strict=True) if pair is not alone]
    return {**rows, "two talkers": pairs} if pairs else rows


def score(bundle: Bundle, array: MicrophoneArray, rows: Rows) -> Scores:
    """Score a bundle as the service runs it: directions with the count known, and the count."""
    localizer = localizer_of(bundle, array)
    most = min(DEFAULT_MAX_SOURCES, array.num_microphones - 1)
    scores = {}
    for row, scenes in rows.items():
        found, right = [], []
        for scene in track(scenes, description=f"{bundle.manifest.name}, {row}"):
            count = min(len(scene.azimuth), array.num_microphones - 1)
            (told,) = localizer.estimate(scene.audio[None], count, most)
            (untold,) = localizer.estimate(scene.audio[None], None, most)
            found.append(np.array([source.azimuth for source in told.sources]))
            right.append(len(untold.sources) == len(scene.azimuth))
        scores[row] = {
            "windows": float(len(scenes)),
            **evaluate(found, [scene.azimuth for scene in scenes]),
            "count_accuracy": float(np.mean(right)),
        }
    return scores

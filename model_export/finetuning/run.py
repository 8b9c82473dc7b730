"""Fine-tuning as a command: prints a table, and writes a bundle if it is better."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from model_export.export.bundle_place import in_the_place_of
from model_export.finetuning.finetune import ARRAY, FineTuning, Outcome, finetune
from model_export.finetuning.labelled_recordings import LabelledRecording, load_recordings
from model_export.simulation.room_bank import RoomBank
from neuralmusic.cli.terminal import line, output, table
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray
from service.inference.bundle import load_bundle

COLUMNS = {
    "maae_deg": "mean error",
    "median_error_deg": "median error",
    "f1_10deg": "within 10°",
    "count_accuracy": "count right",
}


def finetune_run(
    bundle: Path,
    recordings: Path,
    array: MicrophoneArray,
    out: Path,
    settings: FineTuning,
    *,
    name: str | None = None,
    channel_map: str | None = None,
    rooms: Path | None = None,
    speech: Sequence[FloatArray] = (),
    test: Path | None = None,
    force: bool = False,
) -> None:
    """Fine-tune the bundle of a folder, print the table, and keep the result if it is better.

    Parameters
    ----------
    rooms : Path, optional
        Room bank for simulated scenes with ``speech``, which are mixed in.
    test : Path, optional
        Folder of further labelled recordings, for scores only.

    Raises
    ------
    ValueError
        If the result is no better and ``force`` is not set, the new folder exists, or the bundle,
        a label or a recording cannot be used.
    """
    if out.exists():
        raise ValueError(f"{out} exists already: name a new folder for the new bundle")
    console = output()
    start = load_bundle(bundle)
    labelled = load_recordings(recordings, array, channel_map)
    tests = load_recordings(test, array, channel_map) if test else []
    for recording in [*labelled, *tests]:
        for warning in recording.warnings:
            line(console, f"{recording.path.name}: {warning}", "yellow")
    with in_the_place_of(out) as unfinished:
        outcome = finetune(
            start,
            labelled,
            array,
            unfinished,
            settings,
            name=name,
            bank=RoomBank(rooms) if rooms else None,
            speech=speech,
            test=tests,
        )
        _print(labelled, outcome)
        if not outcome.better and not force:
            raise ValueError(
                "the held-out recordings are localized no better than before, so nothing was "
                f"written: keep {start.manifest.name}, record more, or insist with --force"
            )
    line(console, f"wrote {out}", "bold")
    if (out / ARRAY).exists():
        line(console, _moved(array, outcome.array, out / ARRAY))


def _print(recordings: list[LabelledRecording], outcome: Outcome) -> None:
    """Scores before and after, a row per kind of window."""
    console = output()
    directions = len({recording.direction for recording in recordings})
    line(console, f"{len(recordings)} recordings of {directions} directions", "bold")
    drawn = table(console, "held out", "windows", *COLUMNS.values(), right=tuple(COLUMNS.values()))
    for row, after in outcome.after.items():
        before = outcome.before[row]
        pairs = (_pair(score, before[score], after[score]) for score in COLUMNS)
        drawn.add_row(row, f"{after['windows']:.0f}", *pairs)
    console.print(drawn)


def _moved(nominal: MicrophoneArray, calibrated: MicrophoneArray, path: Path) -> str:
    moved = np.linalg.norm(calibrated.positions - nominal.positions, axis=-1)
    return (
        f"the microphones are up to {1000 * moved.max():.1f} mm from where {nominal.name} has "
        f"them: localize with --array @{path} from now on"
    )


def _pair(score: str, before: float, after: float) -> str:
    if score.endswith("error_deg") or score == "maae_deg":
        return f"{before:.2f}° → {after:.2f}°"
    return f"{before:.0%} → {after:.0%}"

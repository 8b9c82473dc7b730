"""The document of an evaluation of the tracker: tables, bars, and how they were measured."""

from __future__ import annotations

from collections.abc import Mapping

from model_export.datasets.speech import Split
from model_export.evaluation.bars import Bar, judge
from model_export.evaluation.results import SPLIT_WORDS
from model_export.evaluation.tracking.recordings import RealTracks, real_table
from model_export.evaluation.tracking.scenes import CELLS, LEAD_S, NOISE_S, SNR_DB
from model_export.evaluation.tracking.scores import Tally
from model_export.evaluation.tracking.turning import POSES_A_SECOND, RT60, SECONDS

TRACKED = "tracks"
ODAS_COUNTS = (0.99, 1.00, 1.00, 0.82, 0.93, 0.61, 0.41, 0.31, 0.04)
"""Share of windows with two tracks, in the order of the cells of two still talkers"""
NORM_MUSIC_MISSED = (0.0, 0.0, 0.0, 0.18, 0.03, 0.07, 0.28, 0.18, 0.26)
"""Missed talkers of pyroomacoustics' NormMUSIC, told that there are two, in the same order"""
LATENCY_S = 0.15

PREFACE = """# Tracking

Written by

```
python -m model_export tracking --librispeech LIBRISPEECH --recordings FOLDER
```

The embedded bundle `any-array` localizes streams as the service does, ten times a second and the
number of sources unknown; its detections go through `service.doa.tracking.Tracker` with its default
parameters. Only active tracks are scored, against where the talkers are at the moment of the
result. The parameters were chosen on the training and {tuned} speakers with other seeds; the
figures here are from {split} speakers.

The array is the ReSpeaker square in a room of 6 x 5 x 3 m; talkers read LibriSpeech sentences
with their pauses at {snr:g} dB against white sensor noise, after {lead:g} s of noise alone. Two
who stand are 1.5 m away, equally loud, and begin at the same moment; an update counts if both
talk in its window (no more than 20 dB below their active levels). One walks past at 15 to 40
degrees a second, 1 to 1.6 m away; two cross from about 110 degrees apart within 2.5 to 4 s; one
walks at that speed behind another, 1.6 to 2 m away. Turns last 4 to 8 s, pauses 3 to 10 s; one
walks 30 degrees in 3 s of silence. A room response is simulated every two degrees of a path. A
talker is missed if no track is within 10 degrees; a track belongs to a talker within 20 degrees.
Identity switches are counted over all streams of a cell. HOTA (Luiten et al., 2021) joins
detection and association; a pair's similarity falls to 0 at 30 degrees. Who goes on after 2.5 s
or more of silence should have the same id. The time to the first track starts at the first sample
a tenth as loud as the loudest one; tracks come with results, ten a second.
"""

REAL = """## Real recordings

Talkers who take turns and overlap before the same array in a room, one of them 45 degrees above it;
who speaks when is not labelled (`--recordings FOLDER`).
"""

TURNING = """## A head that turns

The robot turns its head while talkers stand still 1.5 m away, in a room with an RT60 of {rt60:g}
s, and sends its pose {rate} times a second; {seconds:g} s a stream, three streams a row.
Directions are the world's: bias and error are those of all active tracks, an id is one that any
track had.
"""

PEERS = """
ODAS and NormMUSIC (pyroomacoustics, told that there are two talkers) were measured on two talkers
of the same kind (room, distance, SNR, array, angles; 74 windows a cell, other sentences). Their
figures are bars, not a comparison in the same run.
"""


def document(
    tracked: Mapping[str, Tally],
    untracked: Mapping[str, Tally],
    split: Split,
    real: Mapping[str, RealTracks] | None = None,
    turning: str = "",
) -> str:
    """The text of ``docs/tracking.md``; ``real`` holds the tracks of real recordings.

    ``turning`` is the table of heads that turn.
    """
    words = {"tuned": SPLIT_WORDS["development"], "split": SPLIT_WORDS[split]}
    preface = PREFACE.format(**words, snr=SNR_DB, lead=LEAD_S)
    return "\n".join(
        [
            preface,
            "## Bars",
            PEERS,
            _bars(tracked),
            "## Talkers",
            "",
            "In brackets: the detections without tracking.",
            "",
            _talkers(tracked, untracked),
            "## Nobody talks",
            "",
            f"{NOISE_S:g} s each.",
            "",
            _noises(tracked, untracked),
            TURNING.format(rt60=RT60, rate=POSES_A_SECOND, seconds=SECONDS),
            turning,
            *((REAL, real_table(real)) if real else ()),
        ]
    )


def bars(tracked: Mapping[str, Tally]) -> tuple[tuple[Bar, str], ...]:
    """The bars of tracking, each with its origin."""
    still = [cell.name for cell in CELLS if cell.bars and cell.least_voiced == 2]
    others = [cell.name for cell in CELLS if cell.bars and cell.least_voiced == 1]
    noises = [name for name in tracked if name not in {cell.name for cell in CELLS}]
    asked = [
        (Bar(cell, (cell,), "count_right", ("at least", share)), "ODAS")
        for cell, share in zip(still, ODAS_COUNTS, strict=True)
    ]
    asked += [
        (Bar(cell, (cell,), "missed_share", ("at most", share)), "NormMUSIC")
        for cell, share in zip(still, NORM_MUSIC_MISSED, strict=True)
    ]
    asked += [(Bar(cell, (cell,), "identity_switches", ("at most", 0)), "–") for cell in others]
    asked += [
        (Bar(cell, (cell,), "median_latency_s", ("at most", LATENCY_S)), "–") for cell in others
    ]
    asked += [
        (Bar(noise, (noise,), "false_tracks_per_minute", ("at most", 0)), "ODAS")
        for noise in noises
    ]
    return tuple(asked)


WORDS = {
    "count_right": "count right",
    "missed_share": "missed talkers",
    "identity_switches": "identity switches",
    "median_latency_s": "median time to the first track",
    "false_tracks_per_minute": "false tracks a minute",
}


def _bars(tracked: Mapping[str, Tally]) -> str:
    scores = {cell: {TRACKED: tally.scores()} for cell, tally in tracked.items()}
    verdicts = [(judge(bar, scores, TRACKED), source) for bar, source in bars(tracked)]
    met = sum(verdict.met is True for verdict, _ in verdicts)
    lines = [
        f"{met} of {len(verdicts)} bars met.",
        "",
        "| bar | asked | of | tracks | verdict |",
        "|---|---|---|---|---|",
    ]
    for verdict, source in verdicts:
        bar = verdict.bar
        assert bar.limit is not None
        relation, bound = bar.limit
        columns = (
            f"{bar.name}: {WORDS[bar.score]}",
            f"{relation} {_shown(bar.score, bound)}",
            source,
            _shown(bar.score, verdict.ours),
            {True: "met", False: "**short**", None: "–"}[verdict.met],
        )
        lines.append("| " + " | ".join(columns) + " |")
    return "\n".join(lines) + "\n"


def _talkers(tracked: Mapping[str, Tally], untracked: Mapping[str, Tally]) -> str:
    lines = [
        "| streams | audio | count right | missed | error | OSPA | HOTA | identity switches "
        "| same id after a silence | false tracks a minute | first track, median (longest) |",
        "|" + "---|" * 11,
    ]
    for cell in CELLS:
        tally, alone = tracked[cell.name], untracked[cell.name].scores()
        found = tally.scores()
        pairs = [
            f"{_shown(score, found[score])} ({_shown(score, alone[score])})"
            for score in ("count_right", "missed_share", "matched_error_deg", "ospa_deg", "hota")
        ]
        columns = (
            cell.name,
            f"{60 * tally.minutes:.0f} s",
            *pairs,
            f"{found['identity_switches']:g}",
            f"{tally.same_ids} of {tally.returns}" if tally.returns else "–",
            _shown("false_tracks_per_minute", found["false_tracks_per_minute"]),
            f"{found['median_latency_s']:.2f} s ({max(tally.latencies):.2f} s)",
        )
        lines.append("| " + " | ".join(columns) + " |")
    return "\n".join(lines) + "\n"


def _noises(tracked: Mapping[str, Tally], untracked: Mapping[str, Tally]) -> str:
    talking = {cell.name for cell in CELLS}
    lines = ["| noise | false tracks | false detections |", "|---|---|---|"]
    for name in tracked:
        if name not in talking:
            found, alone = (t[name].false_tracks for t in (tracked, untracked))
            lines.append(f"| {name} | {found} | {alone} |")
    return "\n".join(lines) + "\n"


def _shown(score: str, value: float | None) -> str:
    if value is None:
        return "–"
    if score in {"count_right", "missed_share", "hota"}:
        return f"{100 * value:.0f} %"
    if score.endswith("_deg"):
        return f"{value:.1f}°"
    if score.endswith("_per_minute"):
        return f"{value:.1f}"
    return f"{value:.2f} s" if score.endswith("_s") else f"{value:g}"

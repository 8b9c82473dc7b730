"""Tables of an evaluation: for docs/results.md, the README and the bundles' manifests."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from model_export.datasets.speech import Split
from model_export.evaluation.bars import bars_section
from model_export.evaluation.methods import PEER
from model_export.evaluation.reliability import Reliability
from model_export.evaluation.sections import kept_section, renew

SPLIT_WORDS: Mapping[Split, str] = {
    "train": "training",
    "development": "development",
    "heldout": "held-out",
}
TITLES: Mapping[str, str] = {
    "maae_deg": "Mean absolute angular error in degrees (a missing estimate counts 90)",
    "median_error_deg": "Median of the windows' angular errors in degrees",
    "f1_10deg": "F1 at 10 degrees",
    "ospa_deg": "OSPA in degrees (cut-off 30)",
    "within_10deg": "Share of windows whose first estimate is within 10 degrees of a talker",
    "missed_talkers": "Share of talkers without an estimate within 10 degrees",
    "count_accuracy": "Share of windows with the right number of sources",
    "unanswered": "Share of windows without any estimate",
    "false_sources_per_minute": "False sources a minute where nobody speaks: sum of the next two",
    "summary_sources_per_minute": "Sources in the recording's summary, a minute",
    "reporting_windows_per_minute": "Windows that report a source, a minute",
}
README_CELLS = (
    "M=1, order 4, 30 dB",
    "M=1, order 4, 0 dB",
    "M=2, order 4, 30 dB",
    "M=1, 5x4x2.8 m, RT60 0.35 s",
    "M=1, 10x8x3.5 m, RT60 0.6 s",
    "M=1, order 4, 6-mic circular",
)
README_METHODS = ("any-array", "paper", PEER, "gcc_phat", "srp_phat")
README_PREFACE = """\
Mean absolute angular error in degrees, {scenes} simulated scenes a row, held-out speakers, the
number of talkers known. `any-array` is the default model, trained on none of these arrays, but in
the paper's room (the rows with an order). `paper` is the paper's own network, bound to one array:
"""
PREFACE = """# Results

Written by `python -m model_export evaluate` (`docs/training.md` has the whole command);
`results.json` beside this file has every number and protocol. {scenes} scenes a cell, seed
{seed}, {split} speakers of Speech Commands, the same scenes for every method.

A window has 64 frames and begins with the utterance, a single word. In the cells with talkers a
fixed angle apart and in the one with windows of 0.5 s speech is continuous: a word without its
silence is repeated and starts so long before the window that its reverberation fills the room
(6 x 5 x 3 m). In these cells the SNR refers to a second of speech, and windows in which a talker is
20 dB below its own active level do not count. The array is the ReSpeaker square and the room the
paper's (7 x 7 x 3 m, rigid walls, image order 4) unless the cell says otherwise; sources stand at
0.5 to 2 m, at least 10 degrees apart, with equal power. `results.json` has the arrays' positions;
`any-array` was trained on none of them.

`pyroomacoustics NormMUSIC` is the library's own, with its circular peak search, at 300 to 3500 Hz
or 100 to 7900 Hz, whichever is better in the cell. It requires the number of sources and is told
the truth even where the others are not. The classical methods of this service use one signal
dimension where the count is unknown. "–": the method does not fit the cell's array, or has no
such score.

Recordings without any talker (digital silence, white noise, isotropic noise; a synthetic fan 10 cm
from the array, straight below it or 45 degrees behind and below, whose tones reach all microphones
while its turbulence is independent at each; a fan across a room) go through the service's own path
with a request's default options. A minute has 117 windows; every source in the recording's summary
is a false source, and so is every window that reports any.
"""

FIGURES = """## Figures

![Error over SNR](error-over-snr.png)
![Error over the angle between two talkers](error-over-separation.png)
![Error over RT60](error-over-rt60.png)
![Confidence against truth](reliability.png)
"""


@dataclass(slots=True)
class Results:
    """Scores by cell and method."""

    scenes: int
    seed: int
    split: Split = "heldout"
    cells: dict[str, dict[str, dict[str, float]]] = field(default_factory=dict)
    """Values by cell, method and score; recordings without talkers have scores of their own"""
    protocols: dict[str, Any] = field(default_factory=dict)
    reliability: dict[str, Reliability] = field(default_factory=dict)
    """Reliability by bundle"""

    @classmethod
    def read(cls, path: Path) -> Results:
        """The results that ``write`` left in ``results.json``."""
        fields = json.loads(path.read_text())
        found = {n: Reliability.of(r) for n, r in fields.pop("reliability", {}).items()}
        return cls(**fields, reliability=found)

    def write(self, folder: Path) -> None:
        """Write ``results.json``, and ``results.md`` with the bars and a table per score.

        Sections of other commands in ``results.md`` are kept: elevated talkers (``spatial``) and
        the paper's comparison (``experiments.report``).
        """
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "results.json").write_text(json.dumps(asdict(self), indent=1) + "\n")
        document = folder / "results.md"
        kept = [kept_section(document, name) for name in ("spatial", "comparison")]
        document.write_text("\n".join(filter(None, [self.document(), *kept])))

    def document(self) -> str:
        """The text of ``results.md``."""
        preface = PREFACE.format(scenes=self.scenes, seed=self.seed, split=SPLIT_WORDS[self.split])
        return "\n".join([preface, self.tables(), FIGURES])

    def tables(self) -> str:
        """The bars, a table per score and the reliability of what was evaluated."""
        sections = [f"## Bars\n\n{bars_section(self.cells)}"]
        for score, title in TITLES.items():
            cells = [cell for cell, found in self.cells.items() if _has(found, score)]
            methods = dict.fromkeys(method for cell in cells for method in self.cells[cell])
            if cells:
                sections.append(f"## {title}\n\n{self.table(score, cells, list(methods))}")
        sections += [
            f"## Reliability of `{name}`\n\n{found.section()}"
            for name, found in self.reliability.items()
        ]
        return "\n".join(sections)

    def table(self, score: str, cells: Sequence[str], methods: Sequence[str]) -> str:
        """A Markdown table with a row per cell and a column per method."""
        lines = ["| cell | " + " | ".join(methods) + " |", "|---" * (len(methods) + 1) + "|"]
        for cell in cells:
            values = [self.cells[cell].get(method, {}).get(score) for method in methods]
            shown = ["–" if value is None else f"{value:.2f}" for value in values]
            lines.append(f"| {cell} | " + " | ".join(shown) + " |")
        return "\n".join(lines) + "\n"

    def readme_block(self) -> str:
        """The text between the README's markers."""
        ran = {method for cell in README_CELLS for method in self.cells.get(cell, {})}
        methods = [method for method in README_METHODS if method in ran]
        table = self.table("maae_deg", README_CELLS, methods)
        return f"{README_PREFACE.format(scenes=self.scenes)}\n{table}"

    def bundle_scores(self, name: str) -> dict[str, Any]:
        """One bundle's scores for its manifest."""
        return {
            "protocol": "docs/results.md: held-out speakers, "
            f"seed {self.seed}, {self.scenes} scenes a cell",
            "cells": {
                cell: {key: round(value, 3) for key, value in scores[name].items()}
                for cell, scores in self.cells.items()
                if name in scores
            },
        }


def _has(found: Mapping[str, Mapping[str, float]], score: str) -> bool:
    return any(score in scores for scores in found.values())


def update_readme(path: Path, results: Results) -> None:
    """Put the results into the README between its markers."""
    renew(path, "results", results.readme_block())

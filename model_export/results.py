"""Tables of an evaluation: for docs/results.md, the README and the bundles' manifests."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

PEER = "pyroomacoustics NormMUSIC"
TITLES: Mapping[str, str] = {
    "maae_deg": "Mean absolute angular error in degrees (a missing estimate counts 90)",
    "median_error_deg": "Median of the windows' angular errors in degrees",
    "f1_10deg": "F1 at 10 degrees",
    "ospa_deg": "OSPA in degrees (cut-off 30)",
    "count_accuracy": "Share of windows with the right number of sources",
}
README_CELLS = (
    "M=1, order 4, 30 dB",
    "M=1, order 4, 0 dB",
    "M=2, order 4, 30 dB",
    "M=1, 5x4x2.8 m, RT60 0.35 s",
    "M=1, 10x8x3.5 m, RT60 0.6 s",
    "M=1, order 4, 6-mic circular",
)
BEGIN, END = "<!-- results: begin -->", "<!-- results: end -->"
PREFACE = """# Results

Written by `python -m model_export evaluate` (`docs/training.md` has the whole command);
`results.json` beside this file has every number and protocol. {scenes} scenes a cell, seed
{seed}, held-out speakers of Speech Commands, the same scenes for every method: one window of 64
frames from the beginning of the utterance. The array is the ReSpeaker square and the room the
paper's (7 x 7 x 3 m, rigid walls, image order 4) unless the cell says otherwise; sources stand at
0.5 to 2 m, at least 10 degrees apart, each with the same power.

`pyroomacoustics NormMUSIC` is the library's own, with its circular peaks, 300 to 3500 Hz and 100
to 7900 Hz, the better of the two in every cell; it must be told the number of sources and is told
the truth also where the others are not. The classical methods of this service use one signal
dimension where the count is unknown.
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
    cells: dict[str, dict[str, dict[str, float]]] = field(default_factory=dict)
    protocols: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path) -> Results:
        """The results that ``write`` left in ``results.json``."""
        return cls(**json.loads(path.read_text()))

    def write(self, folder: Path) -> None:
        """``results.json``, and ``results.md`` with a table per score."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "results.json").write_text(json.dumps(asdict(self), indent=1) + "\n")
        (folder / "results.md").write_text(self.document())

    def document(self) -> str:
        """The text of ``results.md``."""
        methods = list(next(iter(self.cells.values())))
        tables = [
            f"## {title}\n\n{self.table(score, list(self.cells), methods)}"
            for score, title in TITLES.items()
        ]
        return "\n".join([PREFACE.format(scenes=self.scenes, seed=self.seed), *tables, FIGURES])

    def table(self, score: str, cells: Sequence[str], methods: Sequence[str]) -> str:
        """A Markdown table with a row per cell and a column per method."""
        lines = ["| cell | " + " | ".join(methods) + " |", "|---" * (len(methods) + 1) + "|"]
        for cell in cells:
            values = [f"{self.cells[cell][method][score]:.2f}" for method in methods]
            lines.append(f"| {cell} | " + " | ".join(values) + " |")
        return "\n".join(lines) + "\n"

    def readme_block(self) -> str:
        """What stands between the README's markers."""
        table = self.table("maae_deg", README_CELLS, ["any-array", PEER, "srp_phat"])
        return (
            f"{BEGIN}\nMean absolute angular error in degrees, {self.scenes} simulated scenes "
            "a row, held-out speakers, the\nnumber of talkers known. None of these arrays was in "
            f"the training; the paper's room, in the rows\nwith an order, was:\n\n{table}{END}"
        )

    def bundle_scores(self, name: str) -> dict[str, Any]:
        """What a manifest carries of the evaluation."""
        return {
            "protocol": "docs/results.md: held-out speakers, "
            f"seed {self.seed}, {self.scenes} scenes a cell",
            "cells": {
                cell: {key: round(value, 3) for key, value in scores[name].items()}
                for cell, scores in self.cells.items()
                if name in scores
            },
        }


def update_readme(path: Path, results: Results) -> None:
    """Put the results into the README between its markers."""
    text = path.read_text()
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    path.write_text(before + results.readme_block() + after)

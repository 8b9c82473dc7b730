"""The experiments' outcomes in docs: one JSON file, and a section of results.md."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from model_export.experiments.outcome import Outcome

FOLDER = SECTION = "comparison"
"""The folder of the figures and the JSON file in docs, and the section of results.md"""
PREFACE = """## The paper's comparison

Every table and figure of NeuralMUSIC (arXiv 2606.18664) with every method that it compares or
discusses: `python -m model_export methods` lists them, `docs/training.md` says how to run them at
the paper's own scale. Numbers are written by the commands below, none by hand;
`comparison/findings.json` has them all. At the scale `{scale}` a network sees {train_scenes}
training scenes for {epochs} epochs, and networks that are too heavy for a CPU are narrower than
published. Learned methods are therefore far from what they reach at the paper's scale (72,000
scenes, 100 epochs): compare them with each other, not with the paper's columns. Classical methods
need no training: their figures are final.

The array is the ReSpeaker square, the room the paper's (7 x 7 x 3 m, rigid walls, image order 4;
0 to 4 in training), 30 dB, held-out speakers, sources at 0.5 to 2 m and at least 10 degrees apart;
{test_scenes} scenes in a cell of the main table, {sweep_scenes} elsewhere. A missing estimate
counts 90 degrees. The command above a table makes all of it; with `--methods NAME` and without
`--out` it makes one row.
"""


def keep(docs: Path, name: str, title: str, command: str, scale: str, outcome: Outcome) -> None:
    """Add one experiment's outcome to the JSON file; it replaces an older one."""
    found = _read(docs)
    found[name] = {"title": title, "command": command, "scale": scale, **outcome.as_dict()}
    path = docs / FOLDER / "findings.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n")


def section(docs: Path, order: list[str], scale: dict[str, Any]) -> str:
    """Markdown of all kept outcomes, in this order."""
    parts = [PREFACE.format(scale=scale["name"], **{k: v for k, v in scale.items() if k != "name"})]
    found = _read(docs)
    for name in (name for name in order if name in found):
        fields = found[name]
        parts.append(
            f"### {fields['title']}\n\n`{fields['command']}`\n\n"
            + Outcome.from_dict(fields).markdown()
            + "\n"
        )
    return "\n".join(parts)


def _read(docs: Path) -> dict[str, Any]:
    path = docs / FOLDER / "findings.json"
    return json.loads(path.read_text()) if path.exists() else {}

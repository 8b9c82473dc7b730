"""The tables of ``docs/reliability.md`` from ``docs/reliability.json``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

BEGIN, END = "<!-- {name}: begin -->", "<!-- {name}: end -->"


def write_table(folder: Path) -> None:
    """Renew the tables of the document in a folder, where it has places for them."""
    page = folder / "reliability.md"
    figures = json.loads((folder / "reliability.json").read_text())
    page.write_text(renewed(page.read_text(), figures))


def renewed(text: str, figures: dict[str, Any]) -> str:
    """The document with the figures in their places."""
    for name, table in (("faults", faults_table), ("soak", soak_table)):
        begin, end = BEGIN.format(name=name), END.format(name=name)
        if name in figures and begin in text:
            before, _, rest = text.partition(begin)
            after = rest.partition(end)[2]
            text = f"{before}{begin}\n{table(figures[name])}\n{end}{after}"
    return text


def faults_table(faults: dict[str, Any]) -> str:
    """One row per fault: what was done, what happened, the test that does it."""
    rows = ["| what was done | what happened | test |", "|---|---|---|"]
    for test, fault in faults.items():
        happened = "; ".join(f"{name}: {value}" for name, value in fault["happened"].items())
        rows.append(f"| {fault['did']} | {happened} | `{test}` |")
    return "\n".join(rows)


def soak_table(soak: dict[str, Any]) -> str:
    """One row per judgement of the soak."""
    rows = ["| what | measured | bound | verdict |", "|---|---|---|---|"]
    for each in soak["judgements"]:
        verdict = "kept" if each["kept"] else "**broken**"
        rows.append(f"| {each['what']} | {each['measured']} | {each['bound']} | {verdict} |")
    return "\n".join(rows)

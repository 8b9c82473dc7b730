"""The tables of ``docs/reliability.md`` from ``faults.json`` and ``soak.json`` beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

BEGIN, END = "<!-- {name}: begin -->", "<!-- {name}: end -->"


def write_table(folder: Path) -> None:
    """Renew the tables of the document in a folder, if it is there."""
    page = folder / "reliability.md"
    if page.exists():
        page.write_text(renewed(page.read_text(), folder))


def renewed(text: str, folder: Path) -> str:
    """The document with the figures of a folder in their places."""
    for name, table in (("faults", faults_table), ("soak", soak_table)):
        figures = folder / f"{name}.json"
        if not figures.exists():
            continue
        text = placed(text, name, table(json.loads(figures.read_text())))
    return text


def placed(text: str, name: str, table: str) -> str:
    """A document with a table between its marks."""
    begin, end = BEGIN.format(name=name), END.format(name=name)
    before, _, rest = text.partition(begin)
    after = rest.partition(end)[2]
    return f"{before}{begin}\n{table}\n{end}{after}"


def faults_table(faults: dict[str, Any]) -> str:
    """One row per fault: what was done, what happened, the test that does it."""
    rows = ["| what was done | what happened | test |", "|---|---|---|"]
    for test, fault in faults.items():
        happened = "; ".join(f"{name}: {value}" for name, value in fault["happened"].items())
        rows.append(f"| {fault['did']} | {happened} | `{test}` |")
    return "\n".join(rows)


def soak_table(soak: dict[str, Any]) -> str:
    """What was done, then one row per judgement."""
    faults = ", ".join(f"{name} {count}" for name, count in soak["faults"].items())
    rows = [
        f"{soak['minutes']:g} minutes, {soak['robots']} robots, {soak['results']:,} results; "
        f"{faults}.",
        "",
        "| what | measured | bound | |",
        "|---|---|---|---|",
    ]
    for each in soak["judgements"]:
        verdict = "kept" if each["kept"] else "**broken**"
        rows.append(f"| {each['what']} | {each['measured']} | {each['bound']} | {verdict} |")
    return "\n".join([*rows, "", "![Memory, lag and what is open over the soak](soak.png)"])

"""``python -m model_export datasets list|verify``: list the data sets, check a download."""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from model_export.datasets.fault import Count, Fault
    from model_export.datasets.item import Dataset

SHOWN = 10
"""Most faults of one kind that are printed; the JSON has all"""


def add(commands: Any) -> None:
    """Add ``datasets`` to the subparsers of the command line."""
    datasets = commands.add_parser("datasets", help="list the data sets, or check a download")
    actions = datasets.add_subparsers(required=True, metavar="ACTION")
    listing = actions.add_parser("list", help="names, licences, where to get them, layouts")
    listing.set_defaults(run_command=_list)
    check = actions.add_parser(
        "verify",
        help="check whether a download is complete (exit status 0: yes, 1: no, 2: not recognised)",
    )
    check.add_argument("folder", type=Path, metavar="DIR")
    check.add_argument("--dataset", metavar="NAME", help="default: recognised by the files in DIR")
    check.set_defaults(run_command=_verify)
    for action in (listing, check):
        action.add_argument("--json", action="store_true", help="print JSON")


def _list(arguments: argparse.Namespace) -> int:
    from model_export.datasets.catalogue import DATASETS

    facts = [_facts(dataset) for dataset in DATASETS.values()]
    if arguments.json:
        print(json.dumps(facts, indent=2))
        return 0
    for fact in facts:
        print(fact["name"])
        for key in ("licence", "source", "layout"):
            print(f"  {key:8} {fact[key]}")
        print(f"  splits   {', '.join(fact['splits'])}\n")
    return 0


def _facts(dataset: type[Dataset]) -> dict[str, Any]:
    return {
        "name": dataset.name,
        "licence": dataset.licence,
        "source": dataset.source,
        "layout": dataset.layout,
        "splits": list(dataset.splits),
    }


def _verify(arguments: argparse.Namespace) -> int:

    from model_export.datasets.catalogue import named, recognise

    folder = arguments.folder
    if not folder.is_dir():
        raise FileNotFoundError(
            f"{folder} is no folder: name the folder that a download unpacked to"
        )
    dataset = named(arguments.dataset) if arguments.dataset else recognise(folder)
    counts, faults = dataset.counts(folder), dataset.verify(folder)
    if arguments.json:
        print(json.dumps(_report(dataset, counts, faults), indent=2))
    else:
        _print(dataset, folder, counts, faults)
    return 1 if faults else 0


def _report(
    dataset: type[Dataset], counts: Sequence[Count], faults: Sequence[Fault]
) -> dict[str, Any]:
    return {
        "dataset": dataset.name,
        "complete": not faults,
        "counts": [
            {"what": count.what, "found": count.found, "published": list(count.published)}
            for count in counts
        ],
        "findings": [
            {"code": fault.code, "path": str(fault.path), "detail": fault.detail}
            for fault in faults
        ],
    }


def _print(
    dataset: type[Dataset], folder: Path, counts: Sequence[Count], faults: Sequence[Fault]
) -> None:
    print(f"{dataset.name} in {folder}")
    for count in counts:
        print(f"  {count}")
    totals = Counter(fault.code for fault in faults)
    for code, total in totals.items():
        print(f"{code}: {total}")
        for fault in [fault for fault in faults if fault.code == code][:SHOWN]:
            print(f"  {_relative(fault.path, folder)}: {fault.detail}")
        if total > SHOWN:
            print(f"  and {total - SHOWN} more, see --json")
    print("incomplete" if faults else "complete")


def _relative(path: Path, folder: Path) -> Path:
    return path.relative_to(folder) if path.is_relative_to(folder) else path

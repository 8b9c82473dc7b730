"""``neuralmusic batch``: an archive of recordings into one file, on this machine or a cluster."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from neuralmusic.cli.flags import add_array, add_channel_map, given_options
from neuralmusic.errors import InvalidOption
from service.cli.inputs import generous_limits
from service.cli.options import add_options, read_request
from service.machine.environment import prepare_process

if TYPE_CHECKING:
    from collections.abc import Sequence

    from service.batch.archive import FoundRecording
    from service.batch.jsonl import JsonLinesResult
    from service.batch.parquet import ParquetResult
    from service.batch.plan import Plan
    from service.batch.record import Record

NAME = "batch"
SUMMARY = "localize many recordings into one JSON Lines or Parquet file"

ENGINES = ("local", "ray")
UNUSABLE = 1


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "recordings",
        nargs="+",
        metavar="GLOB",
        help="recordings, or quoted patterns of them; ** matches folders in folders",
    )
    add_array(parser)
    add_channel_map(parser)
    add_options(parser)
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="FILE",
        help="the .jsonl or .parquet file; recordings already in it are skipped",
    )
    parser.add_argument(
        "--engine", choices=ENGINES, default="local", help="processes here, or a Ray cluster"
    )
    parser.add_argument(
        "--jobs", type=int, metavar="N", help="recordings at the same time (default: one per CPU)"
    )


def run(args: argparse.Namespace) -> int:
    prepare_process()
    from service.batch.archive import find_recordings
    from service.batch.parquet import beside
    from service.cli.batch_progress import BatchProgress

    if args.jobs is not None and args.jobs < 1:
        raise InvalidOption(f"--jobs must be at least 1, but is {args.jobs}")
    found = find_recordings(args.recordings, besides=(args.out, beside(args.out)))
    plan = _plan(args)
    with closing(_result(args.out, plan)) as result:
        remaining = result.remaining(found)
        with BatchProgress(found, remaining) as progress:
            for record in _records(args, plan, remaining, progress.told):
                result.append(record)
                progress.done(record)
        errors = result.errors(found)
        result.finish()
    _print(args.out, len(found), len(remaining), errors)
    return UNUSABLE if errors else 0


def _plan(args: argparse.Namespace) -> Plan:
    from service.batch.plan import Plan
    from service.settings import load_settings

    asked = read_request(args)
    given = given_options(args)
    if args.noise is not None:
        given["noise"] = sha256(args.noise.read_bytes()).hexdigest()
    return Plan.settle(asked, given, load_settings(models=args.models), generous_limits())


def _result(path: Path, plan: Plan) -> JsonLinesResult | ParquetResult:
    from service.batch.jsonl import JsonLinesResult
    from service.batch.parquet import ParquetResult

    match path.suffix.lower():
        case ".jsonl":
            return JsonLinesResult(path, plan)
        case ".parquet":
            return ParquetResult(path, plan)
    raise InvalidOption(f"--out {path}: end its name in .jsonl or .parquet")


def _records(
    args: argparse.Namespace,
    plan: Plan,
    recordings: Sequence[FoundRecording],
    told: Callable[[FoundRecording, float], None],
) -> Iterator[Record]:
    if not recordings:
        return iter(())
    if args.engine == "ray":
        from service.batch.cluster import localize_on_ray

        return localize_on_ray(plan, recordings, args.jobs)
    from service.batch.local import localize_here
    from service.machine.cpus import usable_cpus

    return localize_here(plan, recordings, args.jobs or usable_cpus(), told)


def _print(out: Path, found: int, new: int, errors: Sequence[str]) -> None:
    from neuralmusic.cli.terminal import line, output

    before = f", {found - new} of them earlier" if found > new else ""
    line(output(), f"{out}: {found - len(errors)} of {found} recordings localized{before}")
    for code, count in sorted(Counter(errors).items()):
        line(output(), f"{code}: {count}", "yellow")

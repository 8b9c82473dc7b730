"""``neuralmusic check``: the faults of a recording, channel by channel."""

from __future__ import annotations

import argparse
import json
import math
from typing import TYPE_CHECKING, Any

from neuralmusic.cli.flags import add_array
from neuralmusic.cli.terminal import line, output, table, warn
from service.cli.inputs import add_recording, open_recording, read_array, read_channel_map
from service.machine.environment import prepare_process

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from service.doa.diagnostics import ChannelLevels, DiagnosticReport
    from service.inference.results import AudioWarning

NAME = "check"
SUMMARY = "find what is wrong with a recording: dead, copied, clipped, late, swapped channels"

BAR_WIDTH = 30
BAR_FLOOR = -90.0  # dBFS at the left end of the bar
FOUND = 1


def configure(parser: argparse.ArgumentParser) -> None:
    add_recording(parser)
    without = "; without it the order of the channels is not checked"
    add_array(parser, required=False, help=without)
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    prepare_process()
    from service.doa.diagnostics import ChannelDiagnostics, LevelMeter
    from service.inference.geometry import choose_channels
    from service.recordings.results import too_short

    array = read_array(args.array) if args.array is not None else None
    with open_recording(args.file) as recording:
        given = read_channel_map(args.channel_map)
        chosen, assumed = choose_channels(recording.channels, array, given)
        meter = LevelMeter(recording.channels)  # of all channels; only chosen ones are checked
        diagnostics = ChannelDiagnostics(recording.sample_rate, len(chosen), chosen)
        for block in recording.blocks(range(recording.channels), recording.sample_rate):
            meter.add(block)
            diagnostics.add(block[list(chosen)])
        audio = {
            "sample_rate": recording.sample_rate,
            "channels": recording.channels,
            "duration_s": round(recording.duration, 6),
        }
        short = too_short(recording.duration)
    report, warnings = diagnostics.report(array), [*assumed, *short]
    if args.json:
        print(json.dumps(_document(audio, chosen, warnings, meter.levels(), report), indent=2))
    else:
        console = output()
        line(console, f"{args.file}: {_summary(audio)}", "bold")
        _print_levels(console, meter.levels(), chosen)
        for warning in warnings:
            warn(console, warning.code, warning.detail)
        _print_findings(console, report, faultless=not (report.findings or short))
    return FOUND if report.findings or short else 0


def _summary(audio: dict[str, Any]) -> str:
    return f"{audio['duration_s']:.1f} s, {audio['channels']} channels, {audio['sample_rate']:g} Hz"


def _document(
    audio: dict[str, Any],
    chosen: Sequence[int],
    warnings: Sequence[AudioWarning],
    levels: ChannelLevels,
    report: DiagnosticReport,
) -> dict[str, Any]:
    """The document of ``--json``; a level of minus infinity is null."""
    channels = [
        {
            "channel": channel,
            "rms_dbfs": _finite(levels.rms[channel]),
            "peak_dbfs": _finite(levels.peak[channel]),
            "clipped_share": float(levels.clipped[channel]),
            "offset": round(float(levels.offset[channel]), 6),
        }
        for channel in range(levels.rms.size)
    ]
    findings = [
        {"code": finding.code, "detail": finding.detail, "channels": list(finding.channels)}
        for finding in report.findings
    ]
    return {
        "audio": audio,
        "channel_map": list(chosen),
        "warnings": [{"code": warning.code, "detail": warning.detail} for warning in warnings],
        "levels": channels,
        "findings": findings,
        "geometry_unchecked": report.unchecked,
    }


def _finite(level: float) -> float | None:
    return round(float(level), 2) if math.isfinite(level) else None


def _print_levels(console: Console, levels: ChannelLevels, chosen: Sequence[int]) -> None:
    numbers = ("channel", "RMS dBFS", "peak dBFS", "clipped", "offset")
    drawn = table(console, *numbers, "level", right=numbers)
    for channel in range(levels.rms.size):
        used = channel in chosen
        drawn.add_row(
            str(channel),
            f"{levels.rms[channel]:.1f}",
            f"{levels.peak[channel]:.1f}",
            f"{levels.clipped[channel]:.2%}",
            f"{levels.offset[channel]:z.2%}",
            _bar(float(levels.rms[channel])) + ("" if used else " not a microphone"),
            style=None if used else "dim",
        )
    console.print(drawn)


def _bar(level: float) -> str:
    share = (level - BAR_FLOOR) / -BAR_FLOOR if math.isfinite(level) else 0.0
    return "█" * round(BAR_WIDTH * min(max(share, 0.0), 1.0))


def _print_findings(console: Console, report: DiagnosticReport, *, faultless: bool) -> None:
    for finding in report.findings:
        line(console, f"{finding.code}: {finding.detail}", "yellow")
    if faultless:
        line(console, "nothing wrong found", "green")
    if report.unchecked == "no array was named":
        line(console, "order and delays of the channels were not checked: name the --array")
    elif report.unchecked:
        line(console, f"order and delays of the channels were not checked: {report.unchecked}")

"""The tables of ``docs/performance.md`` from ``performance.json`` beside it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from reliability import placed

STAGES = {
    "stft": "STFT",
    "features": "features",
    "covariance_net": "covariance network (onnxruntime)",
    "covariance": "block covariances",
    "evd": "eigenvectors",
    "spectrum": "MUSIC spectra",
    "fusion": "fusion, up to four rounds",
    "peaks": "peaks and descriptors",
    "count_net": "source-count network (onnxruntime)",
}
WHOLES = {
    "neural_window": "**neural window, 256 bins**",
    "norm_music_window": "NormMUSIC, 257 bins",
    "norm_music_speech_window": "NormMUSIC, 300 to 3500 Hz",
    "pyroomacoustics_normmusic_window": "pyroomacoustics NormMUSIC, 257 bins",
    "pyroomacoustics_music_window": "pyroomacoustics MUSIC, 257 bins",
    "pyroomacoustics_srp_window": "pyroomacoustics SRP-PHAT, 257 bins",
    "pyroomacoustics_normmusic_speech_window": "pyroomacoustics NormMUSIC, 300 to 3500 Hz",
    "stream_hop": "a stream's 100 ms, PCM to tracks",
}
RATIOS = {
    "neural": "neural window against NormMUSIC, the same bins",
    "norm_music": "NormMUSIC against NormMUSIC, 257 bins",
    "norm_music_speech": "the same, 300 to 3500 Hz",
    "neural_against_speech_band": "neural window (256 bins) against NormMUSIC of 300 to 3500 Hz",
}
Figures = dict[str, Any]


def windows_table(figures: Figures) -> str:
    """Milliseconds of every stage and of the whole by number of microphones."""
    arrays = figures["windows"]["arrays"]
    rows = _head("CPU ms, one thread: median (p99)", [f"{count} microphones" for count in arrays])
    for key, name in STAGES.items():
        cells = [f"{each['stages_ms'][key]:.2f}" for each in arrays.values()]
        rows.append(_row(name, cells))
    for key, name in WHOLES.items():
        timings = [each[f"{key}_ms"] for each in arrays.values()]
        rows.append(_row(name, [f"{t['median']:.2f} ({t['p99']:.2f})" for t in timings]))
    return "\n".join(rows)


def ratios_table(figures: Figures) -> str:
    """How many times faster than pyroomacoustics, with quartiles over the windows."""
    arrays = figures["windows"]["arrays"]
    rows = _head(
        "times faster than pyroomacoustics: median (quartiles)",
        [f"{count} microphones" for count in arrays],
    )
    for key, name in RATIOS.items():
        ratios = [each["times_faster_than_pyroomacoustics"][key] for each in arrays.values()]
        rows.append(_row(name, [f"{r['median']} ({r['p25']} to {r['p75']})" for r in ratios]))
    return "\n".join(rows)


def fleets_table(figures: Figures) -> str:
    """Paced robots until the lag passes the bound."""
    rows = _head(
        "robots at ten results a second",
        ["lag p50", "p99", "most", "service, share of a core each", "client", "warnings"],
    )
    for each in figures["fleets"]:
        rows.append(
            _row(
                str(each["robots"]),
                [
                    f"{each['lag_p50_ms']:.0f} ms",
                    f"{each['lag_p99_ms']:.0f} ms",
                    f"{each['lag_most_ms']:.0f} ms",
                    f"{100 * each['service_share_of_a_core_per_stream']:.1f} %",
                    f"{100 * each['client_share_of_a_core_per_stream']:.1f} %",
                    str(each["warnings"]),
                ],
            )
        )
    return "\n".join(rows)


def files_table(figures: Figures) -> str:
    """Recordings through the service."""
    rows = _head(
        "recording", ["windows", "answered in", "times real time", "worker's peak", "answer"]
    )
    for each in figures["files"]:
        rows.append(
            _row(
                f"{each['audio_s']:,} s, 4 channels",
                [
                    f"{each['windows']:,}",
                    f"{each['seconds']:.1f} s",
                    f"{each['times_real_time']:.0f}",
                    f"{each['worker_peak_mb']:.0f} MB",
                    f"{each['answer_mb']:.1f} MB",
                ],
            )
        )
    return "\n".join(rows)


def memory_table(figures: Figures) -> str:
    """Memory and start."""
    memory, cold = figures["memory"], figures["cold_start"]
    rows = _head("what", ["measured"])
    rows += [
        _row("a session that sends nothing", [f"{memory['idle_mb']:.2f} MB"]),
        _row(
            f"a session after {memory['seconds']:.0f} s of audio", [f"{memory['active_mb']:.2f} MB"]
        ),
        _row("service and workers at rest", [f"{memory['at_rest_mb']:.0f} MB"]),
        _row("start to ready, median of five", [f"{cold['median_s']:.2f} s"]),
    ]
    return "\n".join(rows)


def roofline_table(figures: Figures) -> str:
    """Every stage against the CPU."""
    rows = _head("4 microphones", ["MFLOP", "MB", "least", "measured", "times the least"])
    stages = figures["roofline"]["stages"]
    for key, each in stages.items():
        least, measured = each["least_ms"], each["measured_ms"]
        rows.append(
            _row(
                STAGES[key],
                [
                    f"{each['mflop']:.1f}",
                    f"{each['megabytes']:.2f}",
                    f"{least:.3f} ms",
                    f"{measured:.3f} ms",
                    f"{measured / least:.1f}",
                ],
            )
        )
    total = sum(each["least_ms"] for each in stages.values())
    peaks = (
        f"One thread: {figures['roofline']['gflops']} GFLOP/s (float32), "
        f"{figures['roofline']['gigabytes_per_s']} GB/s. The least of all together: {total:.2f} ms."
    )
    return "\n".join([peaks, "", *rows])


TABLES: dict[str, Callable[[Figures], str]] = {
    "windows": windows_table,
    "ratios": ratios_table,
    "roofline": roofline_table,
    "fleets": fleets_table,
    "files": files_table,
    "memory": memory_table,
}


def tables(figures: Figures) -> str:
    """All tables."""
    return "\n\n".join(table(figures) for table in TABLES.values())


def write_tables(folder: Path) -> None:
    """Renew the tables of the document in a folder, if it is there."""
    page = folder / "performance.md"
    figures = json.loads((folder / "performance.json").read_text())
    if page.exists():
        text = page.read_text()
        for name, table in TABLES.items():
            text = placed(text, name, table(figures))
        page.write_text(text)


def _head(first: str, columns: list[str]) -> list[str]:
    return [_row(first, columns), "|" + "---|" * (len(columns) + 1)]


def _row(first: str, cells: list[str]) -> str:
    return f"| {first} | {' | '.join(cells)} |"

"""Answers as documents show them, shortened by ``…``, beside those that the service gives."""

from __future__ import annotations

import json
import re
from typing import Any

ELLIPSIS = "…"
TOLERANCES = {
    "azimuth_deg": 2.0,
    "unit_vector": 0.04,
    "velocity_deg_s": 3.0,
    "std_deg": 2.0,
    "share": 0.1,
    "active_s": 0.5,
    "first_s": 0.3,
}
TOLERANCE = 0.05
"""Tolerance of other fractions, such as confidences and seconds"""
OF_THIS_RUN = {
    "buffered_ms",
    "capture_time_ns",
    "lag_ms",
    "duration_ms",
    "results",
    "seq",
    "session",
    "sha256",
}
"""Fields that another run, or a bundle with another model card, gives another value"""
NUMBERS = re.compile(r"\d+(\.\d+)?")


def shown_objects(page: str) -> list[dict[str, Any]]:
    """The JSON objects in a Markdown document's blocks of JSON."""
    found = []
    for block in re.findall(r"```jsonc?\n(.*?)```", page, re.DOTALL):
        text = re.sub(rf",\s*{ELLIPSIS}\s*}}", f', "{ELLIPSIS}": 0}}', block)
        text = re.sub(rf",\s*{ELLIPSIS}", f', "{ELLIPSIS}"', text).strip()
        while text.startswith("{"):
            shown, end = json.JSONDecoder().raw_decode(text)
            found.append(shown)
            text = text[end:].strip()
    return found


def differences(shown: Any, real: Any, name: str = "", place: str = "") -> list[str]:
    """Where an answer that is shown is not like the real one; none where it is."""
    if shown == ELLIPSIS:
        return []
    if isinstance(shown, dict) and isinstance(real, dict):
        named = shown.keys() - {ELLIPSIS}
        if named != real.keys() and not (ELLIPSIS in shown and named <= real.keys()):
            return [f"{place}: the fields are {sorted(real)}"]
        return [
            line
            for key, value in shown.items()
            if key != ELLIPSIS
            for line in differences(value, real[key], key, f"{place}.{key}")
        ]
    if isinstance(shown, list) and isinstance(real, list):
        return _differing_lists(shown, real, name, place)
    if name in OF_THIS_RUN or (isinstance(shown, float) and isinstance(real, float)):
        near = name in OF_THIS_RUN or abs(shown - real) <= TOLERANCES.get(name, TOLERANCE)
        alike = near and type(shown) is type(real)
    elif name == "detail":
        alike = NUMBERS.sub("0", shown) == NUMBERS.sub("0", str(real))
    else:
        alike = shown == real
    return [] if alike else [f"{place} is {real!r}, but {shown!r} is shown"]


def _differing_lists(shown: list[Any], real: list[Any], name: str, place: str) -> list[str]:
    if name == "windows":  # some of many, told apart by their time
        shown = [window for window in shown if window != ELLIPSIS]
        ends = [window["t_end"] for window in shown]
        real = [window for window in real if window["t_end"] in ends]
    elif shown[-1:] == [ELLIPSIS]:
        shown = shown[:-1]
        real = real[: len(shown)]
    if len(shown) != len(real):
        return [f"{place} has {len(real)} parts, but {len(shown)} are shown"]
    return [
        line
        for number, pair in enumerate(zip(shown, real, strict=True))
        for line in differences(*pair, name, f"{place}[{number}]")
    ]

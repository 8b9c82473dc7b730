"""Options of ``POST /localize`` with absurd values."""

from __future__ import annotations

import json
from random import Random

TEXTS = (
    *(
        "",
        " ",
        "\x00",
        "null",
        "NaN",
        "-1",
        "0",
        "1e999",
        "1_0",
        "٣",
        "\ud800",
        "\U0001f3a4",
        "a" * 9000,
    ),
    *(
        "true",
        "[]",
        "{}",
        '"',
        "'",
        "[" * 5000,
        "../../etc/passwd",
        "%00",
        "\r\nX: y",
        "<b>",
        "1" * 400,
    ),
)
VALUES: dict[str, tuple[str, ...]] = {
    "array": (
        "nobody",
        '{"name":"\\ud800","positions_m":[[0.05,0,0],[-0.05,0,0]]}',
        '{"name":"\\u0000","positions_m":[[0.05,0,0],[-0.05,0,0]]}',
        '{"name":"respeaker-usb-4mic-v2"}',
        '{"positions_m":[[0,0,0],[0,0,0]]}',
        '{"positions_m":[[1e-300,0,0],[0,0,0]]}',
        '{"positions_m":[[1e300,0,0],[-1e300,0,0]]}',
        '{"positions_m":[[NaN,0,0],[0,0,0]]}',
        '{"positions_m":[[0,0,0.05],[0,0,-0.05]]}',
        '{"positions_m":[[0.05,0,0],[-0.05,0,0],[0,0.05,0],[0,-0.05,0],[0.05,0,0.02]]}',
        '{"positions_m":[[1,2],[3,4]]}',
        '{"positions_m":[[1,2,3,4],[3,4,5,6]]}',
        '{"positions_m":[],"positions_m":[[0.05,0,0],[-0.05,0,0]]}',
        '{"positions_m":{"0":[0,0,0]}}',
        '{"positions_m":' + "[" * 3000 + "]" * 3000 + "}",
        '{"positions_m":[[true,0,0],[0,0,0]]}',
        json.dumps({"positions_m": [[0.01 * i, 0, 0] for i in range(33)]}),
        json.dumps({"positions_m": [[0.001 * i, 0, 0] for i in range(32)]}),
        json.dumps({"name": "x" * 65, "positions_m": [[0.05, 0, 0], [-0.05, 0, 0]]}),
    ),
    "channel_map": (
        "0,1,2,3",
        "3,2,1,0",
        "0",
        "0,0,0,0",
        "0,1,2,999999999999999999999",
        "-1,0,1,2",
        "[0,1,2,3]",
        "[[0],1,2,3]",
        "0,1,2,3,",
        "[1e2,0,0,0]",
        '{"a":1}',
        "0,1,2,true",
    ),
    "model": ("any-array", "paper", "default", "nobody", "../paper", "\ud800"),
    "method": ("music", "norm_music", "srp_phat", "gcc_phat", "neural", "NEURAL", "nobody"),
    "num_sources": ("1", "2", "3", "4", "5", "0", "99999999999", "1.0", "+1"),
    "max_sources": ("1", "4", "5", "0", "-0"),
    "window_s": ("0.128", "10", "0.127", "0.1280000001", "1e-9", ".5", "5.", "1e1", "9.99999"),
    "hop_s": ("0.02", "10", "0.019", "1e-5", "0.0200000001"),
    "yaw_deg": ("360", "-720.5", "1e300", "1e999", "1e-300", "-0"),
    "exclude_deg": (
        "0:360",
        "10:20",
        "-360:359.999999",
        "1:1",
        "1:2,",
        ",".join(["1:2"] * 3000),
        "a:b",
    ),
    "noise": ("none", "nobody", "..", "\ud800"),
    "spectrum": ("true", "false", "1", "yes", "maybe"),
    "windows": ("1",),
    "audio": ("text",),
    "": ("x",),
    "\ud800": ("x",),
    "é" * 500: ("x",),
}


def spoil(options: dict[str, str], random: Random) -> list[tuple[str, str]]:
    """Some options changed, added, left out or given twice."""
    pairs = dict(options)
    for _ in range(random.choice((1, 1, 2, 4))):
        name = random.choice(tuple(VALUES))
        pairs[name] = random.choice(VALUES[name] if random.random() < 0.75 else TEXTS)
    given = list(pairs.items())
    if random.random() < 0.1:
        given.append(random.choice(given))
    if random.random() < 0.05:
        given = [pair for pair in given if pair[0] != "array"]
    return given

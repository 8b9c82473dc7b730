"""A client's messages with something wrong in them."""

from __future__ import annotations

import json
from copy import deepcopy
from random import Random
from typing import Any

from neuralmusic.protocol.client_messages import OutputOptions

from .seeds import SQUARE

NAN, INFINITY = float("nan"), float("inf")
ODD: tuple[Any, ...] = (
    *(
        None,
        True,
        False,
        0,
        1,
        -1,
        2,
        3,
        4,
        64,
        65,
        20,
        1000,
        1001,
        4000,
        384_000,
        2**31,
        2**53 + 1,
    ),
    *(2**64, 10**400, 0.5, -0.0, 1e-320, 1e308, NAN, INFINITY, "", " ", "x", "\ud800", "\x00"),
    *("none", "default", "neural", "paper", "any-array", "seq_time", "pcm_f32le", "mp3", "é" * 70),
    *("a" * 30_000, [], {}, [[]], [None], [1, 2, 3, 4], [0, 0], [-1], list(range(5000)), {"a": {}}),
)
"""Invalid or unusual values for any field"""
TUNED: dict[str, tuple[Any, ...]] = {
    "sample_rate": (4000, 8000, 11_025, 44_100, 48_000, 96_000, 384_000),
    "channels": (1, 2, 3, 5, 6, 8, 64),
    "encoding": ("pcm_s16le", "pcm_s24le", "pcm_s32le", "pcm_f32le"),
    "header": ("none", "seq_time"),
    "method": ("neural", "norm_music", "music", "srp_phat", "gcc_phat", None),
    "model": ("default", "paper", "any-array"),
    "overflow": ("drop_oldest", "block"),
    "client": ("robot-1", "robot-2", None),
    "noise": ("kept", "none"),
    "channel_map": ([0, 1, 2, 3], [3, 2, 1, 0], [0, 1], [0, 0, 1, 1], [63, 1, 2, 3], None),
    "interval_ms": (20, 21, 50, 333, 999, 1000),
    "max_sources": (1, 2, 3, 4),
    "num_sources": (1, 2, 3, 4, None),
    "include": (["spectrum"], [], ["spectrum", "spectrum"]),
    "format": ("doa", "odas"),
    "yaw_deg": (0, 360, -3600.5, 1e300, 17.5),
    "exclude_deg": ([[0, 359.9]], [[10, 20], [20, 10]], [[-360, 0.1]]),
    "name": (SQUARE, "xvf3800-4mic", "nobody"),
    "positions_m": (
        [[0.05, 0, 0], [-0.05, 0, 0]],
        [[0.01 * i, 0, 0] for i in range(8)],
        [[0.05, 0, 0], [0, 0.05, 0], [-0.05, 0, 0], [0, -0.05, 0.03]],
        [[1e-5, 0, 0], [0, 0, 0], [0, 1e-5, 0], [1e-5, 1e-5, 0]],
    ),
}
"""Values that a field may well have"""


def start() -> dict[str, Any]:
    """A valid ``start``."""
    return {
        "type": "start",
        "audio": {"encoding": "pcm_s16le", "sample_rate": 16_000, "channels": 4},
        "array": {"name": SQUARE},
        "method": "norm_music",
    }


CONTROLS: tuple[dict[str, Any], ...] = (
    {"type": "update", "output": {"interval_ms": 50}},
    {"type": "flush"},
    {"type": "ping", "id": 7},
    {"type": "calibrate", "kind": "noise", "seconds": 1},
    {"type": "stop"},
)


def tuned(random: Random) -> dict[str, Any]:
    """A ``start`` with other possible values, which may not fit each other."""
    message = start()
    for _ in range(random.choice((1, 2, 4))):
        name = random.choice(tuple(TUNED))
        part = message
        if name in ("sample_rate", "channels", "encoding", "header"):
            part = message["audio"]
        elif name in ("name", "positions_m"):
            part = message["array"]
        elif name in OutputOptions.model_fields:
            part = message.setdefault("output", {})
        part[name] = deepcopy(random.choice(TUNED[name]))
    return message


def spoiled(message: dict[str, Any], random: Random) -> str:
    """The message's JSON with something wrong."""
    message = json.loads(json.dumps(message))
    for _ in range(random.choice((1, 1, 2, 5))):
        part = random.choice(list(_objects(message)))
        name = random.choice([*part, "extra"])
        aim = random.random()
        if aim < 0.2:
            part.pop(name, None)
        elif aim < 0.3:
            part[random.choice((name.upper(), name + "\x00", "é", "", "x" * 3000))] = 1
        elif aim < 0.5 and name in TUNED:
            part[name] = deepcopy(random.choice(TUNED[name]))
        else:
            part[name] = deepcopy(random.choice(ODD))
    text = json.dumps(message, ensure_ascii=random.random() < 0.8 or _has_surrogate(message))
    aim = random.random()
    if aim < 0.7:
        return text
    return random.choice(
        (
            text[: random.randrange(len(text) + 1)],
            text + text,
            "\ufeff" + text,
            text + "\x00",
            text.replace(":", ":" + "[" * 300, 1),
            text.replace("{", "{" + text[1:-1] + ",", 1),
            text.replace('"', "'"),
            "[" * 20_000,
            '{"type":' * 500,
            "null",
            "",
            '{"type":"' + "é" * 33_000 + '"}',
            " " * 65_537,
            text + " " * (65_536 - len(text)),
        )
    )


def _objects(message: dict[str, Any]) -> list[dict[str, Any]]:
    return [message, *(each for each in message.values() if isinstance(each, dict))]


def _has_surrogate(message: dict[str, Any]) -> bool:
    return "\\ud8" in json.dumps(message)

"""What ``asyncapi.json`` says of every message of a stream."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

from jsonschema import Draft202012Validator

DOCUMENT = json.loads((Path(__file__).parents[2] / "asyncapi.json").read_text())


@cache
def validator(kind: str) -> Draft202012Validator:
    """Validator of one kind of message."""
    payload = DOCUMENT["components"]["messages"][kind]["payload"]
    return Draft202012Validator({**payload, "components": DOCUMENT["components"]})

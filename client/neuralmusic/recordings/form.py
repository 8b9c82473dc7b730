"""A recording and its options as the form of ``POST /localize``."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Union

from neuralmusic.protocol.message import plain

Recording = Union[str, Path, bytes, BinaryIO]
Array = Union[str, Mapping[str, Any], Sequence[Sequence[float]]]
Sectors = Union[str, Sequence[Sequence[float]]]


@contextlib.contextmanager
def opened(recording: Recording) -> Iterator[BinaryIO]:
    """The recording as a file; a path is opened and closed."""
    if isinstance(recording, (str, Path)):
        with Path(recording).open("rb") as file:
            yield file
    elif isinstance(recording, (bytes, bytearray, memoryview)):
        yield BytesIO(recording)
    else:
        yield recording


def form_fields(array: Array, options: Mapping[str, Any]) -> dict[str, str]:
    """The form's fields beside the recording, without those that are None."""
    geometry = array if isinstance(array, (str, Mapping)) else {"positions_m": array}
    given = {"array": geometry, **options}
    sectors = given.get("exclude_deg")
    if sectors is not None and not isinstance(sectors, str):
        given["exclude_deg"] = ",".join(f"{first}:{last}" for first, last in sectors)
    return {name: _text(value) for name, value in given.items() if value is not None}


def _text(value: Any) -> str:
    """An option as text for the form; other values become JSON."""
    return value if isinstance(value, str) else json.dumps(value, default=plain)

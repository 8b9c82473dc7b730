"""The answer of ``POST /localize`` as it is sent, written window by window."""

from __future__ import annotations

from io import BytesIO

from service.recordings.answers import LocalizationAnswer, WindowAnswer
from service.recordings.results import RecordingResult


def localization_json(result: RecordingResult) -> bytes:
    """A ``LocalizationAnswer`` in UTF-8, without pydantic models of all its windows at once.

    A spectrum that was not asked for is absent, not null.
    """
    whole = LocalizationAnswer.of(result).model_dump_json(exclude_unset=True)
    # A JSON string would escape the quotes, so this occurs once, whatever an array is called.
    before, after = whole.split('"windows":[]')
    body = BytesIO()
    body.write(f'{before}"windows":['.encode())
    for index, window in enumerate(result.windows):
        answer = WindowAnswer.of(window)
        body.write(b"," * bool(index) + answer.model_dump_json(exclude_unset=True).encode())
    body.write(f"]{after}".encode())
    return body.getvalue()

"""``neuralmusic localize``: what its flags mean together."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import run
from stream_command import ARRAY


def test_a_picture_puts_no_spectra_into_the_answer(
    talk_wav: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flags = ["localize", talk_wav, "--array", ARRAY, "--method", "norm_music", "--json"]
    picture = ["--plot", str(tmp_path / "picture.png")]
    alone, drawn, full = (
        json.loads(run(capsys, *flags, *more)[1])
        for more in ([], picture, [*picture, "--spectrum"])
    )
    assert drawn == alone
    assert {len(window["spectrum"]) for window in full["windows"]} == {360}

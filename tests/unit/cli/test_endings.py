"""Commands that are ended from outside: by Ctrl-C, or because nobody reads on."""

from __future__ import annotations

import subprocess
import sys

import pytest

import neuralmusic.cli
from neuralmusic.cli import main


def test_interruption_is_one_line_and_the_exit_code_of_shells(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(args: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(neuralmusic.cli.arrays, "run", interrupted)
    assert main(["arrays"]) == 130
    assert capsys.readouterr() == ("", "interrupted\n")


def test_a_reader_that_went_away_is_no_traceback() -> None:
    code = "import sys; from neuralmusic.cli import main; sys.exit(main(['arrays']))"
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout
    process.stdout.close()
    assert process.stderr
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait() == 141

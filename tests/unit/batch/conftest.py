"""Archives of short recordings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import soundfile

from service.batch.plan import Plan
from service.cli.inputs import generous_limits
from service.doa.array import MicrophoneArray
from service.recordings.options import LocalizeRequest
from service.recordings.results import LocalizeOptions
from service.settings import Settings

RATE = 16_000

WriteTalker = Callable[..., Path]


@pytest.fixture
def write_talker(square: MicrophoneArray, plane_waves: Any) -> WriteTalker:
    """Write a recording of one talker."""

    def write(path: Path, azimuth_deg: float = 60.0, seconds: float = 1.04) -> Path:
        path.parent.mkdir(parents=True, exist_ok=True)
        soundfile.write(path, plane_waves(square, [azimuth_deg], seconds=seconds).T, RATE)
        return path

    return write


@pytest.fixture
def archive(tmp_path: Path, write_talker: WriteTalker, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two recordings in folders, and two files that are none; the working folder."""
    folder = tmp_path / "archive"
    write_talker(folder / "left.wav", 90.0)
    write_talker(folder / "monday" / "kitchen" / "right.flac", 270.0)
    (folder / "monday" / "notes.txt").write_text("no audio")
    (folder / "empty.wav").write_bytes(b"")
    monkeypatch.chdir(tmp_path)
    return folder


@pytest.fixture(scope="session")
def plan(square: MicrophoneArray) -> Plan:
    asked = LocalizeRequest(LocalizeOptions(square, method="norm_music"))
    given = {"array": square.name, "method": "norm_music"}
    return Plan.settle(asked, given, Settings(), generous_limits())

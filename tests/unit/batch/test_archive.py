"""Which files a run is about."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from neuralmusic.errors import InvalidOption
from service.batch.archive import find_recordings


def touch(folder: Path, *names: str) -> None:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def paths(*patterns: str, besides: tuple[Path, ...] = ()) -> list[str]:
    return [found.path for found in find_recordings(patterns, besides)]


def test_two_stars_are_folders_in_folders(here: Path) -> None:
    touch(here, "a/1.wav", "a/b/c/2.wav", "a/3.flac", "4.wav")
    assert paths("a/*.wav") == ["a/1.wav"]
    assert paths("a/**/*.wav") == ["a/1.wav", "a/b/c/2.wav"]
    assert paths("**") == ["4.wav", "a/1.wav", "a/3.flac", "a/b/c/2.wav"]


def test_a_file_is_taken_once_and_the_result_not_at_all(here: Path) -> None:
    touch(here, "1.wav", "2.wav", "out.jsonl")
    assert paths("*.wav", "1.wav", "*", besides=(Path("out.jsonl"),)) == ["1.wav", "2.wav"]


def test_a_name_with_brackets_is_a_name_first(here: Path) -> None:
    touch(here, "[ab].wav", "a.wav")
    assert paths("[ab].wav") == ["[ab].wav"]


def test_a_name_that_is_no_text_can_be_written_down(here: Path) -> None:
    raw = os.fsdecode(b"caf\xe9.wav")
    touch(here, raw)
    (found,) = find_recordings(["*.wav"])
    assert found.path.encode()
    assert found.place == here / raw


def test_a_file_is_another_one_once_it_changed(here: Path) -> None:
    touch(here, "1.wav")
    (before,) = find_recordings(["1.wav"])
    assert find_recordings(["1.wav"]) == [before]
    os.utime("1.wav", ns=(0, 5_000_000))
    (touched,) = find_recordings(["1.wav"])
    (here / "1.wav").write_bytes(b"longer")
    os.utime("1.wav", ns=(0, 5_000_000))
    (longer,) = find_recordings(["1.wav"])
    assert len({before.key, touched.key, longer.key}) == 3


@pytest.mark.parametrize(
    ("pattern", "advice"),
    [
        ("*.ogg", r"no file matches '\*\.ogg': check the folder and the ending"),
        ("none.wav", "no file matches 'none.wav': check the path"),
        ("a", r"a is a folder: give a pattern of files in it, as 'a/\*\*/\*\.wav'"),
    ],
)
def test_nothing_is_an_error_with_advice(here: Path, pattern: str, advice: str) -> None:
    touch(here, "a/1.wav")
    with pytest.raises(InvalidOption, match=advice):
        find_recordings([pattern])

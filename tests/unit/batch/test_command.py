"""``neuralmusic batch`` as users meet it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from command_line import refusal, run

import service.batch.local
from service.batch.archive import find_recordings

ARRAY = "respeaker-usb-4mic-v2"
FLAGS = ["--array", ARRAY, "--method", "norm_music"]


def records(path: Path) -> dict[str, Any]:
    return {record["path"]: record for record in map(json.loads, path.read_text().splitlines())}


def test_an_archive_becomes_one_file(
    archive: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["batch", "archive/**", *FLAGS, "--hop", "0.3", "--out", "out.jsonl", "--jobs", "1"]
    code, out, err = run(capsys, *command)
    assert code == 1
    assert out.splitlines() == ["out.jsonl: 2 of 4 recordings localized", "not_audio: 2"]
    assert sorted(line.split(": ")[0] for line in err.splitlines()) == [
        "archive/empty.wav",
        "archive/monday/notes.txt",
    ]
    found = records(Path("out.jsonl"))
    assert set(found) == {each.path for each in find_recordings(["archive/**"])}
    assert found["archive/empty.wav"]["error"]["code"] == "not_audio"
    for path, azimuth in (("left.wav", 90), ("monday/kitchen/right.flac", 270)):
        record = found[f"archive/{path}"]
        (source,) = record["summary"]["sources"]
        assert source["azimuth_deg"] == pytest.approx(azimuth, abs=3)
        _, out, _ = run(capsys, "localize", record["path"], *FLAGS, "--hop", "0.3", "--json")
        answer = json.loads(out)
        assert {name: record[name] for name in answer} == answer

    # A second run has nothing to do, and says the same.
    monkeypatch.setattr(service.batch.local, "localize_here", None)
    before = Path("out.jsonl").read_bytes()
    code, out, err = run(capsys, *command)
    assert (code, err) == (1, "")
    assert out.splitlines()[0] == "out.jsonl: 2 of 4 recordings localized, 4 of them earlier"
    assert Path("out.jsonl").read_bytes() == before
    assert run(capsys, "batch", "archive/left.wav", *command[2:])[0] == 0


def test_parquet_holds_what_json_lines_hold(
    archive: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow")
    for out in ("out.jsonl", "out.parquet"):
        code, _, _ = run(capsys, "batch", "archive/**", *FLAGS, "--jobs", "1", "--out", out)
        assert code == 1
    table = parquet.read_table("out.parquet")
    lines = records(Path("out.jsonl"))
    told = json.loads(table.schema.metadata[b"neuralmusic"])
    one = lines["archive/left.wav"]
    assert told["options"] == one["options"] == {"array": ARRAY, "method": "norm_music"}
    assert told["array"]["positions_m"] == one["array"]["positions_m"]
    rows = table.to_pylist()
    for path, record in lines.items():
        mine = [row for row in rows if row["path"] == path]
        if record["error"]:
            (row,) = mine
            assert row["error_code"] == record["error"]["code"]
            assert row["error_detail"] == record["error"]["detail"]
            continue
        sources = [
            (index, window["t_start"], window["t_end"], *(source[n] for n in NAMES))
            for index, window in enumerate(record["windows"])
            for source in window["sources"]
        ]
        assert [
            (row["window"], row["t_start"], row["t_end"], *(row[n] for n in NAMES)) for row in mine
        ] == sources
        assert {row["duration_s"] for row in mine} == {record["audio"]["duration_s"]}


NAMES = ("id", "azimuth_deg", "confidence")


@pytest.mark.processes
def test_a_killed_run_goes_on_where_it_was(
    archive: Path, write_talker: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is killed once it has told of ``empty.wav``, whose record it has written before."""
    for name in ("a", "b"):
        write_talker(archive / f"{name}.wav")
    write_talker(archive / "f.wav", seconds=60.0)
    flags = ["batch", "archive/*.wav", *FLAGS, "--jobs", "1", "--out", "out.jsonl"]
    code = "import sys; from neuralmusic.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", code, *flags]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as running:
        assert running.stderr is not None
        assert "empty.wav: not_audio" in running.stderr.readline()
        running.kill()
    done = whole_lines(Path("out.jsonl"))
    assert len(done) >= 3
    run(capsys, *flags)
    after = whole_lines(Path("out.jsonl"))
    assert after[: len(done)] == done
    paths = [json.loads(line)["path"] for line in after]
    assert sorted(paths) == [found.path for found in find_recordings(["archive/*.wav"])]


def whole_lines(path: Path) -> list[bytes]:
    lines = path.read_bytes().splitlines(keepends=True)
    return [line for line in lines if line.endswith(b"\n")]


@pytest.mark.parametrize(
    ("flags", "reason"),
    [
        (["archive/*.ogg", "--out", "out.jsonl"], "no file matches 'archive/*.ogg'"),
        (["archive", "--out", "out.jsonl"], "archive is a folder"),
        (["archive/*.wav", "--out", "out.csv"], "end its name in .jsonl or .parquet"),
        (["archive/*.wav", "--out", "none/out.jsonl"], "No such file or directory"),
        (["archive/*.wav", "--out", "out.jsonl", "--jobs", "0"], "--jobs must be at least 1"),
        (["archive/*.wav", "--out", "out.jsonl", "--model", "none"], "no model is named 'none'"),
        (["archive/*.wav", "--out", "out.jsonl", "--num-sources", "4"], "at most 3"),
    ],
)
def test_wrong_usage_is_one_sentence(
    archive: Path, flags: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert reason in refusal(capsys, "batch", *flags, "--array", ARRAY)
    assert not Path("out.jsonl").exists()

"""Result files: what survives interruptions, and what a second run leaves out."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from neuralmusic.errors import (
    DoaError,
    InvalidOption,
    NotAudio,
    RecordingUnreadable,
    WorkerLost,
)
from service.batch.archive import FoundRecording
from service.batch.jsonl import JsonLinesResult
from service.batch.parquet import ParquetResult, beside, rows_of
from service.batch.plan import Plan
from service.batch.record import Record, failed

KINDS = {".jsonl": JsonLinesResult, ".parquet": ParquetResult}


def found(name: str, modified_ms: int = 1) -> FoundRecording:
    return FoundRecording(name, 10, modified_ms, Path("/", name))


A, B, C = found("a.wav"), found("b.wav"), found("c.wav")


@pytest.fixture(params=list(KINDS))
def out(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    if request.param == ".parquet":
        pytest.importorskip("pyarrow", reason="needs pyarrow: pip install ./client '.[parquet]'")
    return tmp_path / f"results{request.param}"


def remaining(
    out: Path, plan: Plan, *asked: FoundRecording, then: list[Record], finish: bool = True
) -> list[FoundRecording]:
    """A run over these recordings that writes these records; what it had to do."""
    with closing(KINDS[out.suffix](out, plan)) as result:
        left = result.remaining(asked)
        for record in then:
            result.append(record)
        if finish:
            result.finish()
    return left


def records(out: Path) -> Iterator[tuple[str, str]]:
    """Paths and error codes, whatever the kind."""
    if out.suffix == ".jsonl":
        for line in out.read_text().splitlines():
            record = json.loads(line)
            yield record["path"], record["error"]["code"]
    else:
        import pyarrow.parquet

        for row in pyarrow.parquet.read_table(out).to_pylist():
            yield row["path"], row["error_code"]


def refused(recording: FoundRecording, plan: Plan, error: type[DoaError] = NotAudio) -> Record:
    return failed(recording, plan, error("for the test"))


@pytest.mark.parametrize("finish", [True, False], ids=["finished", "interrupted"])
def test_what_is_written_is_left_out(out: Path, plan: Plan, finish: bool) -> None:
    first = [refused(A, plan), refused(B, plan)]
    assert remaining(out, plan, A, B, C, then=first, finish=finish) == [A, B, C]
    assert remaining(out, plan, A, B, C, then=[refused(C, plan)]) == [C]
    assert remaining(out, plan, A, B, C, then=[]) == []
    assert sorted(records(out)) == [(each.path, "not_audio") for each in (A, B, C)]


def test_every_recording_has_one_cpu(plan: Plan) -> None:
    """Every CPU has its recording: with helpers for each, processes would be CPUs squared."""
    assert plan.setup.settings.processes == 1


def test_a_file_that_changed_has_one_record_again(out: Path, plan: Plan) -> None:
    remaining(out, plan, A, B, then=[refused(A, plan), refused(B, plan)])
    newer = found("a.wav", modified_ms=2)
    assert remaining(out, plan, newer, B, then=[refused(newer, plan)]) == [newer]
    assert sorted(path for path, _ in records(out)) == ["a.wav", "b.wav"]
    assert remaining(out, plan, newer, B, then=[]) == []


@pytest.mark.parametrize("error", [WorkerLost, RecordingUnreadable])
def test_errors_that_may_pass_are_tried_again(out: Path, plan: Plan, error: type[DoaError]) -> None:
    remaining(out, plan, A, B, then=[refused(A, plan, error), refused(B, plan)])
    assert remaining(out, plan, A, B, then=[refused(A, plan)]) == [A]
    assert sorted(records(out)) == [("a.wav", "not_audio"), ("b.wav", "not_audio")]


def test_recordings_of_another_pattern_stay(out: Path, plan: Plan) -> None:
    remaining(out, plan, A, then=[refused(A, plan)])
    remaining(out, plan, B, then=[refused(B, plan)])
    assert sorted(path for path, _ in records(out)) == ["a.wav", "b.wav"]


def test_errors_are_those_of_the_recordings_that_were_asked_for(out: Path, plan: Plan) -> None:
    remaining(out, plan, A, then=[refused(A, plan)])
    with closing(KINDS[out.suffix](out, plan)) as result:
        assert result.remaining([A, B]) == [B]
        result.append(refused(B, plan, WorkerLost))
        assert sorted(result.errors([A, B])) == ["not_audio", "worker_lost"]
        assert result.errors([B]) == ["worker_lost"]


def test_other_options_are_another_result(out: Path, plan: Plan) -> None:
    remaining(out, plan, A, then=[refused(A, plan)])
    other = replace(plan, given={**plan.given, "hop_s": "0.1"})
    with pytest.raises(InvalidOption, match=r"hop_s=0\.1: name another --out"):
        KINDS[out.suffix](out, other)


@pytest.mark.parametrize("end", [b"\n", b""])
def test_a_file_of_somebody_else_is_left_alone(out: Path, plan: Plan, end: bytes) -> None:
    out.write_bytes(b'{"my": "notes"}' + end)
    with pytest.raises(InvalidOption, match="name another --out"):
        KINDS[out.suffix](out, plan)
    assert out.read_bytes() == b'{"my": "notes"}' + end


def test_a_table_of_somebody_else_is_left_alone(tmp_path: Path, plan: Plan) -> None:
    pyarrow = pytest.importorskip("pyarrow", reason="needs pyarrow")
    from pyarrow import parquet

    path = tmp_path / "table.parquet"
    parquet.write_table(pyarrow.table({"path": ["a.wav"]}), path)
    with pytest.raises(InvalidOption, match="is not a result of neuralmusic batch"):
        ParquetResult(path, plan)


def test_two_runs_do_not_write_one_result(out: Path, plan: Plan) -> None:
    kind = KINDS[out.suffix]
    with closing(kind(out, plan)), pytest.raises(InvalidOption, match="another run is writing"):
        kind(out, plan)
    kind(out, plan).close()


@pytest.mark.parametrize("left", [1, 40, -1])
def test_a_half_written_line_is_cut_off(tmp_path: Path, plan: Plan, left: int) -> None:
    out = tmp_path / "results.jsonl"
    remaining(out, plan, A, B, then=[refused(A, plan), refused(B, plan)])
    first, second = out.read_bytes().splitlines(keepends=True)
    out.write_bytes(first + second[:left])
    assert remaining(out, plan, A, B, then=[refused(B, plan)]) == [B]
    assert out.read_bytes() == first + second


def test_a_parquet_result_left_beside_its_records_has_them_once(tmp_path: Path, plan: Plan) -> None:
    """The last two steps of ``finish`` are one after the other."""
    pytest.importorskip("pyarrow", reason="needs pyarrow")
    out = tmp_path / "results.parquet"
    remaining(out, plan, A, then=[refused(A, plan)], finish=False)
    kept = beside(out).read_bytes()
    remaining(out, plan, A, then=[])
    assert not beside(out).exists()
    beside(out).write_bytes(kept)
    assert remaining(out, plan, A, B, then=[refused(B, plan)]) == [B]
    assert sorted(path for path, _ in records(out)) == ["a.wav", "b.wav"]


def test_rows_are_sources_windows_or_recordings(plan: Plan) -> None:
    source = {"azimuth_deg": 1.5, "confidence": 0.5, "id": 3, "unit_vector": [1, 0, 0]}
    windows: list[dict[str, Any]] = [
        {"t_start": 0.0, "t_end": 1.0, "num_sources": 2, "sources": [source, source]},
        {"t_start": 0.5, "t_end": 1.5, "num_sources": 0, "sources": []},
    ]
    audio = {"sample_rate": 16000, "channels": 4, "duration_s": 1.5}
    whole = {**refused(A, plan), "error": None, "audio": audio, "warnings": [{"code": "quiet"}]}
    rows = [*rows_of({**whole, "windows": windows}), *rows_of({**whole, "windows": []})]
    assert [(row["window"], row["azimuth_deg"], row["id"]) for row in rows] == [
        (0, 1.5, 3),
        (0, 1.5, 3),
        (1, None, None),
        (None, None, None),
    ]
    assert {(row["path"], row["duration_s"], row["warnings"]) for row in rows} == {
        ("a.wav", 1.5, "quiet")
    }

"""The outputs of ``neuralmusic stream``: JSON, CSV, datagrams, ODAS' objects, the table."""

from __future__ import annotations

import csv
import io
import json
import socket
import subprocess
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from scripted_service import TIMEOUT_S, ready, result
from stream_command import run

from neuralmusic import Reconnecting
from neuralmusic.cli.addresses import Address, read_address
from neuralmusic.cli.odas import odas_text
from neuralmusic.cli.stream_outputs import CsvRows, JsonLines
from neuralmusic.cli.stream_table import LiveTable
from neuralmusic.errors import InvalidOption
from neuralmusic.protocol.server_messages import (
    OdasPotential,
    OdasSource,
    OdasSsl,
    OdasSst,
    StreamWarning,
)

SST = OdasSst(
    seq=1,
    timeStamp=57,
    src=[
        OdasSource(id=3, tag="dynamic", x=0.5, y=-0.8660254, z=0.0, activity=0.9),
        OdasSource(id=0, tag="", x=0.0, y=0.0, z=0.0, activity=0.0),
    ],
)
SSL = OdasSsl(seq=2, timeStamp=57, src=[OdasPotential(x=1.0, y=0.0, z=0.0, E=0.25)] * 4)


def test_odas_objects_are_printed_as_odas_prints_them() -> None:
    """The truth is printf itself with the format strings of snk_tracks.c and snk_pots.c."""
    rows = [
        'printf \'        { "id": %d, "tag": "%s", "x": %1.3f, "y": %1.3f, "z": %1.3f, '
        f'"activity": %1.3f }}{comma}\\n\' {values}'
        for values, comma in [
            ("3 dynamic 0.5 -0.8660254 0 0.9", ","),
            *[("0 '' 0 0 0 0", comma) for comma in (",", ",", "")],
        ]
    ]
    head, tail = 'printf \'{\\n    "timeStamp": 57,\\n    "src": [\\n\'', "printf '    ]\\n}\\n'"
    printed = subprocess.run(
        ["bash", "-c", "\n".join([head, *rows, tail])], capture_output=True, check=True, text=True
    )
    assert odas_text(SST) == printed.stdout
    potential = '        { "x": 1.000, "y": 0.000, "z": 0.000, "E": 0.250 }'
    assert odas_text(SSL).splitlines()[3:7] == [f"{potential},"] * 3 + [potential]
    assert len(json.loads(odas_text(SST))["src"]) == len(json.loads(odas_text(SSL))["src"]) == 4


def test_addresses_of_other_programs() -> None:
    assert read_address("--udp", "robot:9000") == Address("robot", 9000)
    assert read_address("--udp", "[::1]:80") == Address("::1", 80)
    assert read_address("--udp", "[::1]:80").text == "[::1]:80"
    for text in ("robot", "robot:", ":80", "robot:0", "robot:70000", "::1:80", "[]:80", "a:b"):
        with pytest.raises(InvalidOption, match="--udp must be HOST:PORT"):
            read_address("--udp", text)


def test_a_file_gives_lines_of_json_rows_and_datagrams(
    stream_flags: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved = tmp_path / "out.csv"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(TIMEOUT_S)
        to = ["--udp", f"127.0.0.1:{listener.getsockname()[1]}", "--save", str(saved)]
        code, out, err = run(
            capsys, *stream_flags, *to, "--interval-ms", "200", "--max-sources", "1"
        )
        lines = [json.loads(line) for line in out.splitlines()]
        assert [json.loads(listener.recv(65_536)) for _ in lines] == lines
    assert code == 0
    assert np.diff([line["t_end"] for line in lines[:-1]]) == pytest.approx(0.2)
    found = [s["azimuth_deg"] for line in lines for s in line["sources"] if s["active"]]
    assert np.median(found) == pytest.approx(60, abs=3)
    rows = list(csv.DictReader(io.StringIO(saved.read_text())))
    assert [float(row["azimuth_deg"]) for row in rows] == [
        source["azimuth_deg"] for line in lines for source in line["sources"]
    ]
    assert err.splitlines()[-1].startswith("2.0 s of audio, ")


def test_warnings_are_lines_and_rows_have_their_start_and_booleans_of_json() -> None:
    lines, rows = io.StringIO(), io.StringIO()
    warning = StreamWarning(seq=2, code="clipping", detail="channel 2 clips: turn it down")
    heard = result(1, 10.0)
    for output in (JsonLines(lines), CsvRows(rows)):
        for event in (ready(), heard, warning):
            output.show(event)
    first, second = map(json.loads, lines.getvalue().splitlines())
    assert (first["type"], second["type"], second["code"]) == ("result", "warning", "clipping")
    (row,) = csv.DictReader(io.StringIO(rows.getvalue()))
    assert (float(row["t_start"]), float(row["t_end"])) == (heard.t_start, heard.t_end)
    assert json.loads(row["active"]) is heard.sources[0].active


class OdasReader:
    """A program such as odas_web, which listens until the sender closes."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._text = ""
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self) -> None:
        peer, _ = self._listener.accept()
        with peer, peer.makefile(encoding="utf-8") as file:
            self._text = file.read()

    def text(self) -> str:
        self._thread.join(TIMEOUT_S)
        self._listener.close()
        return self._text


def objects(text: str) -> list[Any]:
    return [json.loads(part + "\n}") for part in text.split("\n}\n") if part]


def test_odas_objects_go_to_programs_that_listen(
    stream_flags: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    tracks, potentials = OdasReader(), OdasReader()
    to = ["--odas-sst", tracks.address, "--odas-ssl", potentials.address, "--output", "odas"]
    code, out, _ = run(capsys, *stream_flags, *to)
    written = tracks.text()
    assert (code, written) == (0, out)
    found = objects(written)
    assert all(len(one["src"]) == 4 for one in found)
    assert {tuple(source) for one in found for source in one["src"]} == {
        ("id", "tag", "x", "y", "z", "activity")
    }
    assert found[-1]["src"][0]["x"] == pytest.approx(0.5, abs=0.05)
    assert {tuple(s) for o in objects(potentials.text()) for s in o["src"]} == {
        ("x", "y", "z", "E")
    }
    _, out, _ = run(capsys, *stream_flags, "--output", "odas", "--ssl")
    assert all("E" in one["src"][0] for one in objects(out))


def test_the_table_says_who_is_where_in_words() -> None:
    screen = io.StringIO()
    shown = LiveTable(Console(file=screen, width=100))
    warning = StreamWarning(seq=2, code="clipping", detail="channel 2 clips: turn it down")
    for event in (ready(), result(1, 10.0), warning, warning, result(3, 60.0, 270.0)):
        shown.show(event)
    shown.close()
    drawn = screen.getvalue()
    assert "square (channels 0, 1) by norm_music, session one" in drawn
    assert "0:00.8, 12 ms behind" in drawn
    rows = [line.split() for line in drawn.splitlines()]
    assert ["1", "60°", "front", "left", "0.90", "active"] in rows
    assert ["2", "270°", "right", "0.80", "active"] in rows
    assert not any("10°" in row for row in rows)
    assert "clipping: channel 2 clips: turn it down (2x)" in drawn


def test_the_table_shows_odas_tracks_silence_and_outages() -> None:
    screen = io.StringIO()
    shown = LiveTable(Console(file=screen, width=100))
    shown.show(SST)
    shown.show(Reconnecting("the connection to the service was lost", 0, 1.25))
    shown.close()
    rows = [line.split() for line in screen.getvalue().splitlines()]
    assert ["3", "300°", "front", "right", "0.90", "active"] in rows
    assert "was lost: next attempt in 1.2 s" in screen.getvalue()
    shown = LiveTable(Console(file=(screen := io.StringIO()), width=100))
    shown.show(result(1))
    shown.close()
    assert "12 ms behind, silence" in screen.getvalue()


def test_the_table_ends_with_the_summary(
    stream_flags: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = run(capsys, *stream_flags, "--output", "table")
    assert (code, err) == (0, "")
    assert "60° front left" in " ".join(out.split())
    assert out.splitlines()[-1].startswith("2.0 s of audio, ")

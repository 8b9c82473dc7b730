"""A robot has neither numpy nor onnxruntime nor a web server: the client does without them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import service.client

ROOT = Path(__file__).parents[3]
ABSENT = (
    "fastapi", "starlette", "uvicorn", "onnxruntime", "numpy", "scipy", "soundfile", "soxr",
    "rich", "pydantic_settings", "service.api", "service.doa", "service.inference",
)  # fmt: skip

PROGRAM = """
import sys
for name in {absent!r}:
    sys.modules[name] = None  # importing it raises ImportError
from service.client import LocalizationClient, ServiceUnreachable, StreamClient
from service.client.audio import read_frames
stream = StreamClient(
    "http://127.0.0.1:{port}",
    array={{"positions_m": [[0, 0, 0], [0.1, 0, 0]]}},
    audio={{"encoding": "pcm_f32le", "sample_rate": 16000, "channels": 2}},
)
for use in (stream.open, LocalizationClient("http://127.0.0.1:{port}").models):
    try:
        use()
    except ServiceUnreachable as error:
        print(error.code)
"""


def test_the_client_runs_without_the_service_s_libraries(unused_tcp_port: int) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(absent=ABSENT, port=unused_tcp_port)],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    assert (done.stdout.split(), done.stderr) == (["unreachable", "unreachable"], "")


def test_streams_do_without_httpx2(unused_tcp_port: int) -> None:
    program = PROGRAM.replace("LocalizationClient, ", "").replace(
        ', LocalizationClient("http://127.0.0.1:{port}").models', ","
    )
    done = subprocess.run(
        [sys.executable, "-c", program.format(absent=(*ABSENT, "httpx2"), port=unused_tcp_port)],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    assert (done.stdout.split(), done.stderr) == (["unreachable"], "")


def test_the_client_exports_what_it_says_and_in_order() -> None:
    names = service.client.__all__
    assert names == sorted(names)
    public = {
        name
        for name, value in vars(service.client).items()
        if not name.startswith("_") and not isinstance(value, type(sys))
    }
    assert public <= set(names)
    assert all(hasattr(service.client, name) for name in names)

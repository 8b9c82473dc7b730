"""A robot has neither numpy nor onnxruntime nor a web server: the client does without them."""

from __future__ import annotations

import inspect
import pydoc
import subprocess
import sys

import pytest
from source_tree import ROOT

import neuralmusic
from neuralmusic import AsyncLocalizationClient, LocalizationClient, StreamClient
from neuralmusic.protocol.client_messages import OutputOptions, Start
from service.in_process import localize
from service.recordings.options import OPTIONS

ABSENT = (
    "fastapi", "starlette", "uvicorn", "onnxruntime", "numpy", "scipy", "soundfile", "soxr",
    "rich", "pydantic_settings", "service", "sounddevice",
)  # fmt: skip
WITHOUT = "import sys\nfor name in {absent!r}: sys.modules[name] = None  # importing it fails\n"

STREAMS = """
from neuralmusic import ServiceUnreachable, StreamClient
stream = StreamClient(
    "http://127.0.0.1:{port}",
    array={{"positions_m": [[0, 0, 0], [0.1, 0, 0]]}},
    audio={{"encoding": "pcm_f32le", "sample_rate": 16000, "channels": 2}},
)
try:
    stream.open()
except ServiceUnreachable as error:
    print(error.code)
"""
RECORDINGS = """
from neuralmusic import LocalizationClient, ServiceUnreachable
try:
    LocalizationClient("http://127.0.0.1:{port}").models()
except ServiceUnreachable as error:
    print(error.code)
"""
NO_HTTP = """
from neuralmusic import LocalizationClient
from neuralmusic.errors import ConfigError
try:
    LocalizationClient("http://127.0.0.1:{port}")
except ConfigError as error:
    print(error.detail)
"""
NO_CHANGE = """
import logging, os, sys, threading
before = dict(os.environ), list(logging.root.handlers), threading.active_count()
import neuralmusic
for name in neuralmusic.__all__:
    getattr(neuralmusic, name)
assert before == (dict(os.environ), list(logging.root.handlers), threading.active_count())
print(sorted({{"httpx", "sounddevice", "service"}} & set(sys.modules)))
"""


def said(program: str, port: int, *more: str) -> str:
    """What a program prints in a process that lacks the service's libraries, and more."""
    code = WITHOUT.format(absent=(*ABSENT, *more)) + program.format(port=port)
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert done.stderr == ""
    return done.stdout.strip()


def test_the_client_runs_without_the_service_s_libraries(unused_tcp_port: int) -> None:
    assert said(RECORDINGS, unused_tcp_port) == "unreachable"


def test_streams_do_without_an_http_library(unused_tcp_port: int) -> None:
    assert said(STREAMS, unused_tcp_port, "httpx", "httpx2") == "unreachable"


def test_recordings_without_an_http_library_say_what_brings_it(unused_tcp_port: int) -> None:
    assert "pip install './client[http]'" in said(NO_HTTP, unused_tcp_port, "httpx")


def test_importing_the_client_changes_nothing_in_the_process(unused_tcp_port: int) -> None:
    code = NO_CHANGE.format()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == ("[]", "")


def test_the_client_exports_what_it_says_and_in_order() -> None:
    names = neuralmusic.__all__
    assert names == sorted(names)
    assert all(hasattr(neuralmusic, name) for name in names)
    assert set(dir(neuralmusic)) == {*names, "__version__"}
    with pytest.raises(AttributeError, match="no attribute 'Robot'"):
        neuralmusic.Robot  # noqa: B018


def keywords(function: object) -> set[str]:
    """The names of a function's keyword-only parameters; it must not take just any."""
    parameters = inspect.signature(function).parameters.values()  # type: ignore[arg-type]
    assert inspect.Parameter.VAR_KEYWORD not in {each.kind for each in parameters}
    return {each.name for each in parameters if each.kind is inspect.Parameter.KEYWORD_ONLY}


def test_editors_complete_every_option() -> None:
    assert set(Start.model_fields) - {"type"} <= keywords(StreamClient.__init__)
    assert set(OutputOptions.model_fields) == keywords(StreamClient.update)
    for client in (LocalizationClient, AsyncLocalizationClient):
        assert set(OPTIONS) == keywords(client.localize)
    assert set(OPTIONS) == keywords(localize)


def test_help_shows_the_clients_and_what_they_take() -> None:
    shown = pydoc.plain(pydoc.render_doc(neuralmusic))
    assert "class StreamClient(" in shown
    assert "class LocalizationClient(" in shown
    assert "exclude_deg: 'Sectors | None' = None" in shown

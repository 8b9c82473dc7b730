"""Models that are loaded again: new work gets the new ones, running work keeps its own."""

from __future__ import annotations

import asyncio
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from running_service import WORKERS_LATER, RunningService
from websocket_stream import PATIENCE, SECOND, end, opened, started, until

from service.inference.registry import EMBEDDED_MODELS
from service.settings import Settings

pytestmark = pytest.mark.processes

ARRAY = "respeaker-usb-4mic-v2"
NEURAL = {"method": "neural", "model": "robot"}


def write_version(folder: Path, version: str) -> None:
    path = folder / "bundle.json"
    fields = json.loads(path.read_text())
    path.write_text(json.dumps({**fields, "name": "robot", "version": version}))


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of bundles."""
    return tmp_path_factory.mktemp("bundles") / "models"


@pytest.fixture
def bundle(models: Path) -> Iterator[Path]:
    """A bundle of the user's, whose files the test may change."""
    yield write_bundle(models)
    shutil.rmtree(models, ignore_errors=True)


def write_bundle(models: Path) -> Path:
    folder = models / "robot"
    shutil.copytree(EMBEDDED_MODELS / "any-array", folder)
    write_version(folder, "1.0.0")
    return folder


@pytest.fixture(scope="module")
def service(models: Path) -> Iterator[RunningService]:
    write_bundle(models)
    settings = Settings(workers=1, stream_workers=1, models=(models,))
    running = RunningService(settings=settings, workers_ahead=True)
    shutil.rmtree(models)
    yield running
    running.stop()


def version(url: str) -> str:
    """Version of the model that new requests get."""
    models = httpx2.get(f"{url}/models", timeout=PATIENCE).json()["models"]
    return next(str(model["version"]) for model in models if model["name"] == "robot")


def localized_with(service: RunningService, body: bytes) -> str:
    response = httpx2.post(
        f"{service.url}/localize",
        params={"array": ARRAY, **NEURAL},
        content=body,
        headers={"Content-Type": "audio/wav"},
        timeout=PATIENCE,
    )
    assert response.status_code == 200
    return str(response.json()["model"]["version"])


def reload(service: RunningService) -> httpx2.Response:
    return httpx2.post(f"{service.url}/admin/reload", timeout=PATIENCE)


@pytest.mark.parametrize("damage", ["covariance.onnx", "bundle.json", "golden.npz"])
def test_a_bad_bundle_leaves_the_old_one_serving(
    service: RunningService, bundle: Path, sounds: Any, damage: str
) -> None:
    pids, serving = service.worker_pids, version(service.url)
    write_version(bundle, "3.0.0")
    content = bytearray((bundle / damage).read_bytes())
    content[len(content) // 2] ^= 0xFF
    (bundle / damage).write_bytes(content)
    refused = reload(service)
    assert (refused.status_code, refused.json()["code"]) == (409, "reload_refused")
    assert damage in refused.json()["detail"]
    assert version(service.url) == localized_with(service, sounds.wav()) == serving
    assert service.worker_pids == pids


def test_a_folder_that_is_gone_leaves_the_old_models_serving(
    service: RunningService, bundle: Path
) -> None:
    """A volume may not be mounted: the embedded models must not take over silently."""
    serving = version(service.url)
    shutil.rmtree(bundle.parent)
    refused = reload(service)
    assert (refused.status_code, refused.json()["code"]) == (409, "reload_refused")
    assert version(service.url) == serving


def test_a_folder_that_changes_without_a_reload_changes_nothing(
    service: RunningService, bundle: Path
) -> None:
    serving = version(service.url)
    shutil.rmtree(bundle)

    async def run() -> str:
        async with opened(service) as lost:
            await started(lost, **NEURAL)
            (pid,) = service.worker_pids
            os.kill(pid, signal.SIGKILL)
            assert (await end(lost))[0]["code"] == "worker_lost"
        async with opened(service) as socket:  # on a worker that starts only now
            return str((await started(socket, **NEURAL))["model"]["version"])

    assert asyncio.run(run()) == serving


def test_new_work_gets_the_new_models_and_a_running_stream_keeps_its_own(
    service: RunningService, bundle: Path, sounds: Any
) -> None:
    serving = version(service.url)
    assert localized_with(service, sounds.wav()) == serving != "2.0.0"

    async def run() -> list[str]:
        async with opened(service) as old:
            versions = [(await started(old, **NEURAL))["model"]["version"]]
            write_version(bundle, "2.0.0")
            response = await asyncio.to_thread(reload, service)
            assert response.status_code == 200
            async with opened(service) as new:
                versions.append((await started(new, **NEURAL))["model"]["version"])
                for socket in (old, new):
                    await socket.send(SECOND[:65_536])
                    assert (await until(socket, "result"))["t_end"] == pytest.approx(0.1)
        return versions

    (before,) = service.worker_pids
    assert asyncio.run(run()) == [serving, "2.0.0"]
    assert version(service.url) == localized_with(service, sounds.wav()) == "2.0.0"
    while before in service.worker_pids:  # it ends with its last stream
        assert httpx2.get(f"{service.url}/livez").status_code == 200


def line_with(words: str, process: subprocess.Popen[str]) -> str:
    """The next line of a process's output with these words."""
    assert process.stdout is not None
    return next(line for line in process.stdout if words in line)


def test_a_hang_up_signal_reloads_and_is_not_lost_during_the_start(bundle: Path) -> None:
    """The first SIGHUP comes after the models are read and before anything handles signals."""
    program = f"""{WORKERS_LATER}
import os, signal, sys
from pathlib import Path
import service.server
from neuralmusic.cli import main
load = service.server.load_registry
def loaded(settings):
    registry = load(settings)
    manifest = Path({str(bundle / "bundle.json")!r})
    manifest.write_text(manifest.read_text().replace('"1.0.0"', '"2.0.0"'))
    os.kill(os.getpid(), signal.SIGHUP)
    return registry
service.server.load_registry = loaded
sys.exit(main(["serve", "--port", "0", "--workers", "1", "--models", {str(bundle.parent)!r}]))
"""
    with subprocess.Popen(
        [sys.executable, "-c", program],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    ) as process:
        try:
            url = re.findall(r"http://\S+", line_with("http://", process))[0]
            line_with("the models were reloaded", process)
            assert version(url) == "2.0.0"
            write_version(bundle, "3.0.0")
            process.send_signal(signal.SIGHUP)
            line_with("the models were reloaded", process)
            assert version(url) == "3.0.0"
        finally:
            process.terminate()
    assert process.returncode in (0, -signal.SIGTERM)


def test_lost_workers_are_replaced_before_anybody_meets_them(
    service: RunningService, sounds: Any
) -> None:
    recording_pids = service.state.recording_workers.pids
    for pid in (*service.worker_pids, *recording_pids):
        os.kill(pid, signal.SIGKILL)
    for status, code in ((503, "not_ready"), (200, None)):
        while (answer := httpx2.get(f"{service.url}/readyz")).status_code != status:
            pass
        assert answer.json().get("code") == code
    assert not set(recording_pids) & set(service.state.recording_workers.pids)
    assert localized_with_default(service, sounds.wav()) == 200


def localized_with_default(service: RunningService, body: bytes) -> int:
    params, headers = {"array": ARRAY}, {"Content-Type": "audio/wav"}
    url = f"{service.url}/localize"
    return httpx2.post(
        url, params=params, content=body, headers=headers, timeout=PATIENCE
    ).status_code


def test_a_stream_worker_that_stands_still_is_killed(
    service: RunningService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.workers.stream_pool.STALL_S", 0.5)

    async def run() -> tuple[dict[str, Any], int | None]:
        async with opened(service) as socket:
            await started(socket)
            (pid,) = service.worker_pids
            os.kill(pid, signal.SIGSTOP)
            await socket.send(SECOND[:65_536])
            return await end(socket)

    last, close_code = asyncio.run(run())
    assert (last["code"], close_code) == ("worker_lost", 1011)

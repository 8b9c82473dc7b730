"""A bundle is damaged on disk."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import httpx2
import pytest
from bench.fleet import fleet, until
from bench.served import COMMAND, ROOT, Served, heap_mb

BUNDLE = ROOT / "service" / "models" / "any-array"
FILES = ("bundle.json", "covariance.onnx", "source_count.onnx", "fusion.npz", "golden.npz")


@pytest.fixture
def models(tmp_path: Path) -> Path:
    """A copy of the shipped bundle, as a user's would lie in a folder."""
    shutil.copytree(BUNDLE, tmp_path / "copy")
    manifest = tmp_path / "copy" / "bundle.json"
    manifest.write_text(manifest.read_text().replace('"any-array"', '"copy"', 1))
    return tmp_path


def flip(path: Path) -> None:
    """Change one bit in the middle of a file, as a failing disk does."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x10
    path.write_bytes(data)


@pytest.mark.parametrize("name", FILES[1:2])
def test_corrupt_bundle_at_the_start(figures: Callable[..., None], models: Path, name: str) -> None:
    flip(models / "copy" / name)
    began = time.monotonic()
    ended = subprocess.run(
        [COMMAND, "serve", "--port", "0", "--models", models / "copy"],
        env={**os.environ, "PYTHONPATH": f"{ROOT / 'client'}:{ROOT}"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    error = ended.stderr.strip().splitlines()[-1]
    figures(
        f"One bit of `{name}` flipped, `neuralmusic serve`",
        exit_status=f"{ended.returncode} after {time.monotonic() - began:.1f} s",
        says=f"“{error.replace(str(models), 'MODELS')}”",
    )
    assert ended.returncode == 2
    assert "serves on" not in ended.stdout
    assert error.startswith("error: ")
    assert name in error
    assert "Traceback" not in ended.stderr


@pytest.mark.faults
@pytest.mark.parametrize("way", ["SIGHUP", "POST /admin/reload"])
def test_corrupt_bundle_on_reload(figures: Callable[..., None], models: Path, way: str) -> None:
    async def scenario(service: Served) -> int:
        async with fleet(service.url, 3) as robots:
            moment = time.monotonic()
            if way == "SIGHUP":
                service.process.send_signal(signal.SIGHUP)
                await until(lambda: "bundle" in service.log, "the refusal is logged")
            else:
                answer = await asyncio.to_thread(httpx2.post, f"{service.url}/admin/reload")
                assert answer.status_code >= 400
            await until(
                lambda: all(sum(h.arrived > moment for h in r.heard) >= 10 for r in robots),
                "robots hear",
            )
            return sum(robot.cut for robot in robots)

    with Served("--models", str(models / "copy")) as service:
        if "/admin/reload" not in service.get("/openapi.json")["paths"]:
            pytest.skip("this version cannot reload its bundles")
        before = service.get("/models")
        flip(models / "copy" / "covariance.onnx")
        cut = asyncio.run(scenario(service))
        assert service.get("/models") == before
        assert service.get("/readyz") == {"status": "ok"}
    figures(
        f"One bit of `covariance.onnx` flipped, {way}",
        refused="the old bundles go on serving",
        streams=f"{cut} of 3 cut",
    )
    assert cut == 0


@pytest.mark.faults
def test_memory_of_reloads(figures: Callable[..., None]) -> None:
    times = 20

    async def scenario(service: Served) -> list[float]:
        memory = []
        for number in range(1, 2 * times + 1):
            answer = await asyncio.to_thread(httpx2.post, f"{service.url}/admin/reload", timeout=60)
            assert answer.status_code == 200, answer.text
            if number % times == 0 or number == times // 2:
                memory.append(heap_mb(service.pid))
        return memory

    with Served() as service:
        start = heap_mb(service.pid)
        early, middle, late = asyncio.run(scenario(service))
    figures(
        f"{2 * times} reloads of good bundles",
        memory=f"{start:.0f} MB at the start, {early:.0f} MB after {times // 2}, "
        f"{middle:.0f} MB after {times}, {late:.0f} MB after {2 * times}",
    )
    assert late - middle < 15  # half a megabyte a reload would be a leak of a whole bundle

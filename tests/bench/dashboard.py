"""The dashboard under load: a service, robots, uploads, errors, a real Prometheus, one picture.

``python tests/bench/dashboard.py docs/dashboard.png`` starts all of it on the loopback, runs every
query of every panel of ``docker/grafana/dashboards/neuralmusic.json``, fails where a panel would be
empty, and draws the panels in the dashboard's own layout. It needs the binary ``prometheus``
(Debian's package) and ``make install``.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx2
from panels import Series, draw

ROOT = Path(__file__).parents[2]
DASHBOARD = ROOT / "docker" / "grafana" / "dashboards" / "neuralmusic.json"
RULES = ROOT / "docker" / "prometheus" / "rules.yml"
RECORDING = ROOT / "examples" / "two-talkers.flac"
ARRAY = "respeaker-usb-4mic-v2"
RATE_INTERVAL = "15s"
"""Value of ``$__rate_interval`` at a scrape a second"""
PATIENCE_S = 30
FLOOD_S = 4.0
TAIL_S = 3.0
"""Seconds before the end of the load at which the picture ends"""
MISTAKES: tuple[tuple[bytes, dict[str, str]], ...] = (
    (b"no audio at all", {"array": ARRAY}),
    (b"RIFF", {"array": "nobody's"}),
    (b"RIFF", {"array": ARRAY, "windows": "5"}),
    (b"", {"array": ARRAY}),
)


@contextmanager
def running(command: list[str], **options: Any) -> Iterator[subprocess.Popen[str]]:
    """A process for as long as the context lasts."""
    process = subprocess.Popen(command, text=True, **options)
    try:
        yield process
    finally:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(PATIENCE_S)
        process.kill()
        process.wait()


@contextmanager
def service(settings: list[str], log: Path) -> Iterator[str]:
    """A service on a free port; its address."""
    command = [sys.executable, "-c", "from neuralmusic.cli import main; raise SystemExit(main())"]
    environment = {**os.environ, "PYTHONPATH": f"{ROOT / 'client'}:{ROOT}"}
    with (
        log.open("w") as errors,
        running(
            [*command, "serve", "--port", "0", "--log-format", "json", *settings],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=errors,
        ) as process,
    ):
        assert process.stdout is not None
        yield process.stdout.readline().split()[-1]


@contextmanager
def prometheus(target: str, folder: Path) -> Iterator[str]:
    """A Prometheus that scrapes ``target`` every second; its address."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    config = {
        "global": {"scrape_interval": "1s", "evaluation_interval": "5s"},
        "rule_files": [str(RULES)],
        "scrape_configs": [
            {
                "job_name": "neuralmusic",
                "static_configs": [{"targets": [target.removeprefix("http://")]}],
            }
        ],
    }
    path = folder / "prometheus.yml"
    path.write_text(json.dumps(config))  # YAML takes JSON
    command = [
        "prometheus",
        f"--config.file={path}",
        f"--storage.tsdb.path={folder / 'data'}",
        f"--web.listen-address=127.0.0.1:{port}",
    ]
    with running(command, stderr=subprocess.DEVNULL):
        address = f"http://127.0.0.1:{port}"
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            with suppress(httpx2.TransportError):
                if httpx2.get(f"{address}/-/ready").status_code == 200:
                    yield address
                    return
            time.sleep(0.2)
        raise SystemExit("error: prometheus did not become ready")


def uploads(url: str, ended: threading.Event) -> None:
    """A recording, a mistake, a pause, again."""
    recording, turn = RECORDING.read_bytes(), 0
    with httpx2.Client(base_url=url, timeout=PATIENCE_S) as client:
        while not ended.wait(1.5):
            headers = {"Content-Type": "audio/flac"}
            client.post("/localize", params={"array": ARRAY}, content=recording, headers=headers)
            body, params = MISTAKES[turn % len(MISTAKES)]
            client.post("/localize", params=params, content=body, headers=headers)
            client.get("/models/any-array" if turn % 3 else "/nowhere")
            turn += 1


def load(url: str, arguments: argparse.Namespace) -> float:
    """Robots that stay and robots that go, one client that floods, uploads and a reload.

    Returns the moment at which the load was still whole, shortly before its end.
    """
    ended = threading.Event()
    uploading = threading.Thread(target=uploads, args=(url, ended))
    uploading.start()
    script = [sys.executable, str(Path(__file__).with_name("robots.py"))]
    script += ["--url", url.replace("http", "ws") + "/stream"]

    def robots(count: int, seconds: float, *further: str) -> list[str]:
        return [*script, "--robots", str(count), "--seconds", str(seconds), *further]

    third, quiet = arguments.seconds / 3, {"stdout": subprocess.DEVNULL}
    whole = time.time() + arguments.seconds - TAIL_S
    try:
        with running(robots(arguments.robots, arguments.seconds), **quiet) as staying:
            time.sleep(third / 2)
            subprocess.run(robots(max(arguments.robots // 2, 1), third), **quiet, check=True)
            httpx2.post(f"{url}/admin/reload", timeout=PATIENCE_S)
            subprocess.run(robots(1, FLOOD_S, "--flood", "1"), **quiet, check=True)
            staying.wait()
    finally:
        ended.set()
        uploading.join()
    return whole


def filled(expression: str) -> str:
    """A panel's query with the dashboard's variables put in."""
    for variable, value in (
        ("$__rate_interval", RATE_INTERVAL),
        ("$instance", ".*"),
        ("$job", ".*"),
    ):
        expression = expression.replace(variable, value)
    assert "$" not in expression, expression
    return expression


def queried(address: str, target: Any, began: float, ended: float) -> list[Series]:
    """The series of one query of a panel."""
    step = max((ended - began) / 300, 1.0)
    params = {"query": filled(target["expr"]), "start": began, "end": ended, "step": step}
    answer = httpx2.get(f"{address}/api/v1/query_range", params=params, timeout=PATIENCE_S)
    content = answer.json()
    if content["status"] != "success":
        raise SystemExit(f"error: {content['error']}: {params['query']}")
    lines = []
    for result in content["data"]["result"]:
        labels = result["metric"]
        name = re.sub(
            r"\{\{\s*(\w+)\s*\}\}",
            lambda found, labels=labels: labels.get(found[1], ""),
            target["legendFormat"],
        )
        times = [at - began for at, _ in result["values"]]
        values = [float(value) for _, value in result["values"]]
        lines.append(Series(name, times, values, labels))
    return lines


def all_series(
    dashboard: Any, address: str, began: float, ended: float
) -> tuple[dict[int, list[Series]], list[str]]:
    """What every panel shows, and the titles of those that show nothing."""
    shown: dict[int, list[Series]] = {}
    empty = []
    for panel in dashboard["panels"]:
        if panel["type"] == "row":
            continue
        shown[panel["id"]] = []
        for target in panel["targets"]:
            lines = queried(address, target, began, ended)
            if not any(math.isfinite(value) for line in lines for value in line.values):
                empty.append(f"{panel['title']}: {target['expr']}")
            shown[panel["id"]] += lines
    return shown, empty


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", type=Path, help="PNG that is written")
    parser.add_argument("--robots", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=150.0)
    arguments = parser.parse_args()
    if shutil.which("prometheus") is None:
        raise SystemExit("error: there is no prometheus: apt-get install prometheus")
    dashboard = json.loads(DASHBOARD.read_text())
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with service([], folder / "log.json") as url, prometheus(url, folder) as address:
            began = time.time()
            ended = load(url, arguments)
            shown, empty = all_series(dashboard, address, began, ended)
            alerts = httpx2.get(f"{address}/api/v1/alerts").json()["data"]["alerts"]
    version = subprocess.run(
        ["prometheus", "--version"], capture_output=True, text=True, check=True
    )
    release = (version.stdout or version.stderr).split("version ")[1].split()[0].split("+")[0]
    title = (
        f"Drawn by tests/bench/dashboard.py from Prometheus {release} (not by Grafana): "
        f"{arguments.robots} robots for {arguments.seconds:g} s, half as many that come and go, "
        f"one client that floods for {FLOOD_S:g} s, uploads, mistakes and a reload beside them"
    )
    draw(dashboard, shown, title, ended - began, arguments.picture)
    print(f"{arguments.picture}: {len(shown)} panels; alerts: {alerts or 'none'}")
    if empty:
        raise SystemExit("\n  ".join(["error: these are empty:", *empty]))


if __name__ == "__main__":
    main()

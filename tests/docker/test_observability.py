"""Prometheus finds every replica, with the rules; Grafana's files are what it provisions from."""

from __future__ import annotations

import json
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import pytest
import yaml
from container_engine import ROOT, run
from running_containers import ComposeProject, wait_for

pytestmark = pytest.mark.docker

FILES = ("compose.scale.yaml", "compose.observability.yaml")
PATIENCE_S = 60.0
GRAFANA = ROOT / "docker" / "grafana"


def ask(url: str, what: str, **parameters: str) -> Any:
    return httpx2.get(f"{url}/api/v1/{what}", params=parameters).json()["data"]


def until(url: str, what: str, enough: Callable[[Any], bool], **parameters: str) -> Any:
    """What Prometheus says once it is enough."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        said = ask(url, what, **parameters)
        if enough(said):
            return said
    raise AssertionError(f"{what} stays {said}")


def up(said: Any) -> list[str]:
    """The jobs of the targets that were scraped."""
    return sorted(t["labels"]["job"] for t in said["activeTargets"] if t["health"] == "up")


def test_every_replica_and_the_proxy_are_scraped_and_the_rules_are_loaded(
    image: str, provided: Callable[[str], None]
) -> None:
    provided("haproxy:2.6")
    provided("prom/prometheus:v2.53.4")
    with ComposeProject("watched", *FILES, MEMORY="1g") as project:
        project.up("proxy", "prometheus")
        url = project.url("prometheus", 9090)
        wait_for(f"{url}/-/ready")
        jobs = ["neuralmusic"] * 3 + ["proxy"]
        until(url, "targets", lambda said: up(said) == jobs)
        ready = until(
            url, "query", lambda said: len(said["result"]) == 3, query="neuralmusic_ready"
        )
        assert {sample["value"][1] for sample in ready["result"]} == {"1"}
        groups = ask(url, "rules")["groups"]
        written = yaml.safe_load((ROOT / "docker/prometheus/rules.yml").read_text())["groups"]
        assert {rule["name"] for group in groups for rule in group["rules"]} == {
            rule["alert"] for group in written for rule in group["rules"]
        }
        assert all(rule["health"] == "ok" for group in groups for rule in group["rules"])


def test_with_keys_prometheus_has_one_and_strangers_have_none(
    image: str, provided: Callable[[str], None], tmp_path: Path
) -> None:
    provided("prom/prometheus:v2.53.4")
    keys, token = tmp_path / "keys.jsonl", tmp_path / "token"
    token.write_text(new_key(keys, "prometheus", "watch"))
    for path, mode in ((keys, 0o644), (token, 0o644), (tmp_path, 0o755)):
        path.chmod(mode)  # the containers' users are others
    files = ("compose.yaml", "compose.keys.yaml", "compose.observability.yaml")
    given = {"NEURALMUSIC_KEYS": keys, "WATCH_TOKEN": token}
    with ComposeProject("guarded", *files, **given) as project:
        project.up("neuralmusic", "prometheus")
        service, url = project.url("neuralmusic", 8000), project.url("prometheus", 9090)
        wait_for(f"{service}/readyz")
        assert httpx2.get(f"{service}/metrics").status_code == 401
        wait_for(f"{url}/-/ready")
        until(url, "targets", lambda said: up(said) == ["neuralmusic"])


def new_key(file: Path, name: str, roles: str) -> str:
    """A new key's token; the file has its line."""
    program = (sys.executable, "-m", "neuralmusic")
    printed = run(*program, "key", "new", name, "--roles", roles, "--file", str(file))
    (token,) = re.findall(r"^token: (\S+)$", printed, re.M)
    return str(token)


def test_grafana_finds_its_source_and_its_dashboard_where_compose_mounts_them() -> None:
    compose = yaml.safe_load((ROOT / "docker/compose.observability.yaml").read_text())
    mounted = dict(each.split(":")[:2] for each in compose["services"]["grafana"]["volumes"])
    (provider,) = provisioned("dashboards/neuralmusic.yaml")["providers"]
    assert mounted["./grafana/dashboards"] == provider["options"]["path"]
    assert mounted["./grafana/provisioning"] == "/etc/grafana/provisioning"
    (source,) = provisioned("datasources/prometheus.yaml")["datasources"]
    assert source["url"] == "http://prometheus:9090"
    assert source["isDefault"] is True
    dashboards = list((GRAFANA / "dashboards").glob("*.json"))
    assert [json.loads(path.read_text())["title"] for path in dashboards]


def provisioned(name: str) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((GRAFANA / "provisioning" / name).read_text())
    return found

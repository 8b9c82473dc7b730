"""Metrics, alerts, dashboard and document name the same things."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
import yaml

from neuralmusic.protocol.server_messages import WarningCode
from service.inference.results import ModelIdentity
from service.observability.metrics import Gauges, Metrics

ROOT = Path(__file__).parents[2]
DOCUMENT = (ROOT / "docs" / "monitoring.md").read_text()
DOCKER = ROOT / "docker"
RULES = DOCKER / "prometheus" / "rules.yml"
DASHBOARD = DOCKER / "grafana" / "dashboards" / "neuralmusic.json"
COLUMNS = 24
"""Columns of Grafana's grid"""


def registry_metrics() -> dict[str, tuple[str, tuple[str, ...]]]:
    """Type and labels of every metric of our own, by its name in the text format."""
    metrics = Metrics()
    model = ModelIdentity("one", "1.0", "weights", "0" * 64)
    metrics.read_from(lambda: Gauges(models=(model,)))
    metrics.requested("GET", "/livez", 200, 0.1)
    found = {}
    for family in metrics.registry.collect():
        if family.name.startswith("neuralmusic_"):
            name = family.name + ("_total" if family.type == "counter" else "")
            labels = {key for sample in family.samples for key in sample.labels} - {"le"}
            found[name] = (family.type, tuple(sorted(labels)))
    return found


def documented_metrics() -> dict[str, tuple[str, tuple[str, ...]]]:
    rows = re.findall(r"^\| `(neuralmusic_\w+)` \| (\w+) \|([^|]*)\|", DOCUMENT, re.MULTILINE)
    return {
        name: (kind, tuple(sorted(re.findall(r"`(\w+)`", labels)))) for name, kind, labels in rows
    }


def series(metrics: dict[str, tuple[str, tuple[str, ...]]]) -> Iterator[str]:
    """Names that a query may use."""
    for name, (kind, _) in metrics.items():
        if kind == "histogram":
            yield from (f"{name}_bucket", f"{name}_sum", f"{name}_count")
        else:
            yield name


def named(expression: str) -> set[str]:
    return set(re.findall(r"\bneuralmusic_\w+", expression))


@pytest.fixture(scope="module")
def dashboard() -> Any:
    return json.loads(DASHBOARD.read_text())


def alerts() -> list[Any]:
    groups = yaml.safe_load(RULES.read_text())["groups"]
    return [rule for group in groups for rule in group["rules"]]


def test_the_table_of_the_document_is_the_registry() -> None:
    assert documented_metrics() == registry_metrics()


def test_alerts_name_metrics_that_exist() -> None:
    known = set(series(registry_metrics()))
    for alert in alerts():
        assert named(alert["expr"]) <= known, alert["alert"]


def test_alerts_name_warnings_that_exist() -> None:
    known = set(get_args(WarningCode))
    named = [re.findall(r'stream_warnings_total{code=~"([a-z_|]+)"', a["expr"]) for a in alerts()]
    codes = [code for (listed,) in filter(None, named) for code in listed.split("|")]
    assert len(set(codes)) == len(codes) > 0
    assert set(codes) <= known


@pytest.mark.parametrize("alert", alerts(), ids=lambda alert: alert["alert"])
def test_every_alert_says_how_bad_what_and_what_to_do(alert: Any) -> None:
    assert alert["labels"]["severity"] in ("critical", "warning")
    assert "for" in alert
    assert {"summary", "description", "runbook"} == set(alert["annotations"])
    page, _, anchor = alert["annotations"]["runbook"].partition("#")
    assert page == "docs/monitoring.md"
    assert anchor == alert["alert"].lower()


def test_every_alert_has_its_place_in_the_document_and_no_other_has() -> None:
    headings = re.findall(r"^### (NeuralMusic\w+)$", DOCUMENT, re.MULTILINE)
    assert headings == [alert["alert"] for alert in alerts()]


@pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool is not installed")
@pytest.mark.parametrize(
    "command",
    [
        ("check", "rules", RULES),
        ("test", "rules", Path(__file__).with_name("prometheus_rules.yml")),
    ],
    ids=["check", "test"],
)
def test_prometheus_takes_the_rules(command: tuple[str, str, Path]) -> None:
    done = subprocess.run(["promtool", *command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_alerts_go_to_the_alertmanager_of_compose_and_a_receiver_may_be_named() -> None:
    services = yaml.safe_load((DOCKER / "compose.observability.yaml").read_text())["services"]
    (sent_to,) = yaml.safe_load((DOCKER / "prometheus/prometheus.yml").read_text())["alerting"][
        "alertmanagers"
    ]
    assert sent_to == {"static_configs": [{"targets": ["alertmanager:9093"]}]}
    mounted, _ = services["alertmanager"]["volumes"]
    default = mounted.partition(":-")[2].partition("}")[0]
    assert mounted == f"${{ALERTS:-{default}}}:/etc/alertmanager/alertmanager.yml:ro"
    config = yaml.safe_load((DOCKER / default).read_text())
    assert config["route"]["receiver"] in [each["name"] for each in config["receivers"]]


def test_every_alert_is_shown_to_fire() -> None:
    cases = Path(__file__).with_name("prometheus_rules.yml").read_text()
    for alert in alerts():
        assert f'alertname="{alert["alert"]}"' in cases, alert["alert"]
        assert f"alertname: {alert['alert']}," in cases, alert["alert"]


def test_panels_have_unique_ids_and_lie_beside_each_other_on_the_grid(dashboard: Any) -> None:
    assert dashboard["schemaVersion"] >= 39
    ids = [panel["id"] for panel in dashboard["panels"]]
    assert len(set(ids)) == len(ids)
    taken: set[tuple[int, int]] = set()
    for panel in dashboard["panels"]:
        place = panel["gridPos"]
        assert place["x"] + place["w"] <= COLUMNS
        cells = {
            (x, y)
            for x in range(place["x"], place["x"] + place["w"])
            for y in range(place["y"], place["y"] + place["h"])
        }
        assert not taken & cells, panel["title"]
        taken |= cells


def test_panels_query_what_exists_from_the_chosen_source_and_replicas(dashboard: Any) -> None:
    variables = {each["name"]: each["type"] for each in dashboard["templating"]["list"]}
    assert variables == {"datasource": "datasource", "job": "query", "instance": "query"}
    known = set(series(registry_metrics()))
    panels = [panel for panel in dashboard["panels"] if panel["type"] != "row"]
    used: set[str] = set()
    for panel in panels:
        assert panel["title"]
        assert panel["description"]
        assert panel["datasource"]["uid"] == "${datasource}"
        assert panel["targets"], panel["title"]
        for target in panel["targets"]:
            expression = target["expr"]
            selectors = re.findall(r"\b(?:neuralmusic|process)_\w+(\{[^}]*\})?", expression)
            assert all('instance=~"$instance"' in each for each in selectors), expression
            used |= named(expression)
    assert used <= known


def test_the_dashboard_shows_every_metric(dashboard: Any) -> None:
    text = json.dumps(dashboard)
    for name in registry_metrics():
        assert name in text, name

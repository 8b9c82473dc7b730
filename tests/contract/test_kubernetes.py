"""docker/kubernetes.yaml against Kubernetes' own schemas, and against the service."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from service.app import create_app
from service.server import FAREWELL
from service.settings import GRACE, PREFIX, Settings, load_settings
from service.workers.process import END_S

ROOT = Path(__file__).parents[2]
MANIFESTS: list[dict[str, Any]] = list(
    yaml.safe_load_all((ROOT / "docker" / "kubernetes.yaml").read_text())
)
BY_KIND = {manifest["kind"]: manifest for manifest in MANIFESTS}
POD = BY_KIND["Deployment"]["spec"]["template"]
(CONTAINER,) = POD["spec"]["containers"]
OLDEST = "1.30"
"""First version in which a preStop may sleep by itself"""


@pytest.mark.parametrize("manifest", MANIFESTS, ids=lambda manifest: manifest["kind"])
def test_kubernetes_schemas_know_every_field(manifest: dict[str, Any]) -> None:
    schemas = pytest.importorskip("kubernetes_validate", reason="needs kubernetes-validate")
    for version in (OLDEST, schemas.latest_version()):
        schemas.validate(manifest, version, strict=True)


def test_the_schemas_find_what_is_wrong() -> None:
    schemas = pytest.importorskip("kubernetes_validate", reason="needs kubernetes-validate")
    wrong = {**BY_KIND["Service"], "spec": {"selectors": {}}}
    with pytest.raises(schemas.ValidationError, match="selectors"):
        schemas.validate(wrong, OLDEST, strict=True)


def test_everything_is_about_the_same_pods() -> None:
    labels = POD["metadata"]["labels"]
    assert BY_KIND["Deployment"]["spec"]["selector"]["matchLabels"] == labels
    assert BY_KIND["Service"]["spec"]["selector"] == labels
    assert BY_KIND["PodDisruptionBudget"]["spec"]["selector"]["matchLabels"] == labels
    assert BY_KIND["NetworkPolicy"]["spec"]["podSelector"]["matchLabels"] == labels
    scaled = BY_KIND["HorizontalPodAutoscaler"]["spec"]["scaleTargetRef"]
    deployment = BY_KIND["Deployment"]
    assert scaled == {
        "apiVersion": deployment["apiVersion"],
        "kind": deployment["kind"],
        "name": deployment["metadata"]["name"],
    }
    assert "replicas" not in deployment["spec"]


def test_ports_are_the_container_s() -> None:
    (port,) = CONTAINER["ports"]
    assert port["containerPort"] == Settings.model_fields["port"].default
    assert str(port["containerPort"]) == POD["metadata"]["annotations"]["prometheus.io/port"]
    used = [
        BY_KIND["Service"]["spec"]["ports"][0]["targetPort"],
        BY_KIND["NetworkPolicy"]["spec"]["ingress"][0]["ports"][0]["port"],
        *(probe["httpGet"]["port"] for probe in probes().values()),
    ]
    assert set(used) == {port["name"]}


def probes() -> dict[str, Any]:
    return {name: CONTAINER[name] for name in ("startupProbe", "readinessProbe", "livenessProbe")}


def test_probes_are_the_service_s() -> None:
    paths = {name: probe["httpGet"]["path"] for name, probe in probes().items()}
    assert paths == {
        "startupProbe": "/readyz",
        "readinessProbe": "/readyz",
        "livenessProbe": "/livez",
    }
    assert set(paths.values()) <= set(create_app(Settings()).openapi()["paths"])


def test_variables_are_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in CONTAINER["env"]:
        monkeypatch.setenv(variable["name"], variable["value"])
    settings = load_settings()
    assert settings.host == "0.0.0.0"
    assert POD["spec"]["enableServiceLinks"] is False
    assert BY_KIND["Service"]["metadata"]["name"].upper() + "_" == PREFIX


def test_uploads_fit_into_the_temporary_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in CONTAINER["env"]:
        monkeypatch.setenv(variable["name"], variable["value"])
    limits = CONTAINER["resources"]["limits"]
    settings = load_settings(workers=int(limits["cpu"]))
    most = (settings.workers + settings.queue) * settings.max_upload_bytes
    (volume,) = POD["spec"]["volumes"]
    (mount,) = CONTAINER["volumeMounts"]
    assert (mount["name"], mount["mountPath"]) == (volume["name"], "/tmp")
    assert most < gibibytes(volume["emptyDir"]["sizeLimit"]) * 2**30
    assert volume["emptyDir"]["sizeLimit"] == limits["ephemeral-storage"]


def gibibytes(quantity: str) -> int:
    return int(quantity.removesuffix("Gi"))


def test_a_pod_that_leaves_has_the_time_that_it_takes() -> None:
    pause = CONTAINER["lifecycle"]["preStop"]["sleep"]["seconds"]
    ending = FAREWELL + GRACE + FAREWELL + END_S  # streams, requests, what they are told, workers
    assert POD["spec"]["terminationGracePeriodSeconds"] > pause + ending
    update = BY_KIND["Deployment"]["spec"]["strategy"]["rollingUpdate"]
    assert update == {"maxUnavailable": 0, "maxSurge": 1}


def test_pods_keep_the_restricted_standard() -> None:
    """kubernetes.io/docs/concepts/security/pod-security-standards, and more."""
    spec = POD["spec"]
    assert not {"hostNetwork", "hostPID", "hostIPC"} & set(spec)
    assert all(set(volume) == {"name", "emptyDir"} for volume in spec["volumes"])
    assert spec["automountServiceAccountToken"] is False
    assert spec["securityContext"]["runAsNonRoot"] is True
    assert spec["securityContext"]["runAsUser"] == 10001
    assert spec["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    assert CONTAINER["securityContext"] == {
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
    }


def test_the_session_metric_is_the_one_that_the_document_adapts() -> None:
    sessions, cpu = BY_KIND["HorizontalPodAutoscaler"]["spec"]["metrics"]
    name = sessions["pods"]["metric"]["name"]
    assert cpu["resource"]["name"] == "cpu"
    text = (ROOT / "docs" / "scale-out.md").read_text()
    (rules,) = [
        found
        for block in text.split("```yaml\n")[1:]
        if "rules" in (found := yaml.safe_load(block.split("```")[0]))
    ]
    (rule,) = rules["rules"]
    assert rule["seriesQuery"].startswith(name + "{")
    assert rule["name"]["as"] == name

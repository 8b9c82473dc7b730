"""Keys in the OpenAPI document: the scheme, the role of each operation, the refusals."""

from __future__ import annotations

from typing import Any

from neuralmusic.errors import (
    AudioQuota,
    DoaError,
    HostRefused,
    KeyExpired,
    KeyInAddress,
    KeyMissing,
    KeyUnknown,
    OriginRefused,
    RoleMissing,
    TooManyUploads,
)
from service.access.key_file import ROLES
from service.api.middleware.guard import needed_roles
from service.api.middleware.origins import SAFE_METHODS
from service.api.problems import MEDIA_TYPE, problem_responses

SCHEME = "key"
EVERYWHERE: tuple[type[DoaError], ...] = (HostRefused, KeyInAddress)
NEEDS_KEY: tuple[type[DoaError], ...] = (KeyMissing, KeyUnknown, KeyExpired)
LIMITED: tuple[type[DoaError], ...] = (TooManyUploads, AudioQuota)
UPLOADS = frozenset({"/localize", "/noise/{name}"})
"""Paths whose unsafe methods, except DELETE, count as uploads"""


def document_guard(document: dict[str, Any]) -> None:
    """Add keys to every operation of an OpenAPI document; call it once per document."""
    schemes = document["components"].setdefault("securitySchemes", {})
    if SCHEME in schemes:
        return
    schemes[SCHEME] = {
        "type": "http",
        "scheme": "bearer",
        "description": "A key with the role that the operation names, where the service has keys "
        "(`docs/keys.md`). Services without keys need none.",
    }
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            _document(operation, path, method.upper())


def _document(operation: dict[str, Any], path: str, method: str) -> None:
    roles = needed_roles(path)
    errors = [*EVERYWHERE]
    if roles:
        operation["security"] = [{}, {SCHEME: []}]
        operation["x-roles"] = sorted({*roles, "admin"})
        errors += NEEDS_KEY
    if roles and roles != ROLES:
        errors.append(RoleMissing)
    if method not in SAFE_METHODS:
        errors.append(OriginRefused)
    if path in UPLOADS and method in ("POST", "PUT"):
        errors += LIMITED
    for status, response in problem_responses(*errors).items():
        _merge(operation["responses"], str(status), response)


def _merge(responses: dict[str, Any], status: str, added: dict[str, Any]) -> None:
    """Add a response's examples to those already documented for this status."""
    present = responses.setdefault(status, added)
    if present is added:
        return
    examples = present["content"][MEDIA_TYPE].setdefault("examples", {})
    examples |= added["content"][MEDIA_TYPE]["examples"]
    present["description"] = ", ".join(f"`{code}`" for code in sorted(examples))
    if "headers" in added:
        present.setdefault("headers", {}).update(added["headers"])

"""A file of keys with the tokens that belong to it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from service.access.key_file import Key, new_token, token_sha256


@dataclass
class KeyFile:
    """A keys file and the tokens that belong to it."""

    path: Path
    tokens: dict[str, str] = field(default_factory=dict)
    lines: dict[str, str] = field(default_factory=dict)

    def add(self, name: str, *roles: str, **limits: Any) -> str:
        token = self.tokens[name] = new_token()
        fields = {"name": name, "sha256": token_sha256(token), "roles": roles or [name], **limits}
        self.lines[name] = Key.model_validate(fields).line
        return self.write(token)

    def remove(self, name: str) -> None:
        del self.lines[name]
        self.write()

    def write(self, token: str = "") -> str:
        self.path.write_text("\n".join(self.lines.values()))
        self.path.chmod(0o600)
        return token

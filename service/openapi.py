"""Print the OpenAPI document as YAML: ``python -m service.openapi > openapi.yaml``."""

from __future__ import annotations

import sys
from typing import Any

from service.app import create_app
from service.settings import Settings


def document_yaml() -> str:
    """The application's document as it is checked in.

    Raises
    ------
    ModuleNotFoundError
        If PyYAML, a development dependency, is not installed.
    """
    import yaml  # type: ignore[import-untyped]

    class Dumper(yaml.SafeDumper):  # type: ignore[misc]
        """Writes texts of several lines as blocks."""

        def represent_str(self, text: str) -> Any:
            style = "|" if "\n" in text else None
            return self.represent_scalar("tag:yaml.org,2002:str", text, style)

        def ignore_aliases(self, _: object) -> bool:
            return True

    Dumper.add_representer(str, Dumper.represent_str)
    document = create_app(Settings.model_construct()).openapi()
    text: str = yaml.dump(document, Dumper=Dumper, sort_keys=False, allow_unicode=True, width=100)
    return text


def main() -> int:
    """Print the document; 1 where PyYAML is missing."""
    try:
        sys.stdout.write(document_yaml())
    except ModuleNotFoundError as error:
        print(f"{error}: pip install ./client '.[dev]'", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

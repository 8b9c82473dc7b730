"""The place of a new bundle: it appears whole or not at all, and no foreign file is lost."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from service.inference.bundle import FILES, MANIFEST, OPTIONAL_FILES


def check_replaceable(out: Path) -> None:
    """Raise ValueError unless a folder is missing, empty, or a bundle with nothing else in it."""
    if not out.exists():
        return
    if not out.is_dir():
        raise ValueError(f"{out} is no folder: name a folder for the bundle")
    held = {path.name for path in out.iterdir()}
    foreign = (
        sorted(held - {MANIFEST, *FILES, *OPTIONAL_FILES}) if MANIFEST in held else sorted(held)
    )
    if foreign:
        raise ValueError(
            f"{out} holds {foreign[0]}, which is no part of a bundle and would be lost: name a new "
            "folder"
        )


@contextmanager
def in_the_place_of(out: Path) -> Iterator[Path]:
    """A folder to write a bundle into, which replaces ``out`` if nothing is raised."""
    out.parent.mkdir(parents=True, exist_ok=True)
    # On the same file system, so that a bundle appears whole or not at all.
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=".bundle-") as folder:
        unfinished = Path(folder) / "bundle"
        yield unfinished
        if out.exists():
            shutil.rmtree(out)
        unfinished.rename(out)

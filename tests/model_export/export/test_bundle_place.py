"""The place of a new bundle: whole or not at all, and nothing else is lost."""

from __future__ import annotations

from pathlib import Path

import pytest

from model_export.export.bundle_place import check_replaceable, in_the_place_of

pytestmark = pytest.mark.torch


def bundle(folder: Path, content: str) -> Path:
    folder.mkdir(parents=True)
    (folder / "bundle.json").write_text(content)
    return folder


def test_a_bundle_takes_the_place_of_another(tmp_path: Path) -> None:
    out = bundle(tmp_path / "mine", "old")
    check_replaceable(out)
    with in_the_place_of(out) as folder:
        bundle(folder, "new")
        assert (out / "bundle.json").read_text() == "old"
    assert (out / "bundle.json").read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_a_refused_export_leaves_the_old_bundle(tmp_path: Path) -> None:
    out = bundle(tmp_path / "mine", "old")

    def export() -> None:
        with in_the_place_of(out) as folder:
            bundle(folder, "refused")
            raise ValueError("torch and onnxruntime differ")

    with pytest.raises(ValueError, match="differ"):
        export()
    assert (out / "bundle.json").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


@pytest.mark.parametrize("name", ["any-array/bundle.json", "notes.txt"])
@pytest.mark.parametrize("beside", [True, False])
def test_a_folder_with_anything_else_is_refused(tmp_path: Path, name: str, beside: bool) -> None:
    out = bundle(tmp_path / "models", "{}") if beside else tmp_path / "models"
    path = out / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("mine")
    with pytest.raises(ValueError, match=f"holds {Path(name).parts[0]}, which is no part"):
        check_replaceable(out)
    assert path.read_text() == "mine"


def test_a_missing_folder_and_an_empty_one_are_free(tmp_path: Path) -> None:
    check_replaceable(tmp_path)
    check_replaceable(tmp_path / "new")
    with pytest.raises(ValueError, match="no folder"):
        check_replaceable(Path(__file__))

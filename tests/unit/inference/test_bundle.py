"""Bundles are verified before they serve: hashes, contract, golden self-test."""

from __future__ import annotations

import io
import json
import shutil
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from neuralmusic.errors import (
    BundleCorrupt,
    BundleIncompatible,
    BundleNotFound,
    GeometryMismatch,
    SelfTestFailed,
    UnknownModel,
)
from service.doa.presets import preset
from service.inference.bundle import FILES, file_sha256, load_bundle, read_manifest
from service.inference.engine import Engine
from service.inference.manifest import Manifest
from service.inference.npz import read_npz
from service.inference.registry import (
    EMBEDDED_MODELS,
    BundleRegistry,
    bundle_folders,
    by_error,
    self_test,
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (embedded, *_) = bundle_folders(EMBEDDED_MODELS)
    return Path(shutil.copytree(embedded, tmp_path / "copy"))


def edit(folder: Path, change: Callable[[dict], object]) -> None:
    path = folder / "bundle.json"
    fields = json.loads(path.read_text())
    change(fields)
    path.write_text(json.dumps(fields))


def test_the_embedded_bundles_load_and_pass_their_self_test() -> None:
    registry = BundleRegistry.load()
    assert [bundle.manifest.name for bundle in registry.bundles] == ["any-array", "paper"]
    scores = registry.bundles[0].manifest.scores["cells"]
    assert scores["M=1, order 4, 30 dB"]["median_error_deg"] <= 2.0


@pytest.mark.parametrize("name", FILES)
def test_a_changed_file_is_noticed(folder: Path, name: str) -> None:
    content = bytearray((folder / name).read_bytes())
    content[len(content) // 2] ^= 1
    (folder / name).write_bytes(content)
    with pytest.raises(BundleCorrupt, match=f"{name} differs from its hash"):
        load_bundle(folder)


@pytest.mark.parametrize("name", FILES)
def test_a_missing_file_is_named(folder: Path, name: str) -> None:
    (folder / name).unlink()
    with pytest.raises(BundleCorrupt, match=f"lacks {name}"):
        load_bundle(folder)


def test_a_card_is_verified_where_there_is_one(folder: Path) -> None:
    (folder / "card.md").write_text("another card")
    with pytest.raises(BundleCorrupt, match=r"card\.md differs from its hash"):
        load_bundle(folder)
    edit(folder, lambda fields: fields["files"].pop("card.md"))
    assert load_bundle(folder).card is None


def test_no_bundle(tmp_path: Path) -> None:
    with pytest.raises(BundleNotFound, match=r"bundle\.json"):
        load_bundle(tmp_path)


def test_another_schema_version(folder: Path) -> None:
    edit(folder, lambda fields: fields.update(schema_version=99))
    with pytest.raises(BundleIncompatible, match="schema_version 99"):
        load_bundle(folder)


def test_a_manifest_with_a_wrong_field(folder: Path) -> None:
    edit(folder, lambda fields: fields.update(grid_size="many"))
    with pytest.raises(BundleCorrupt, match="grid_size"):
        load_bundle(folder)


def test_a_manifest_that_is_no_json(folder: Path) -> None:
    (folder / "bundle.json").write_text("{")
    with pytest.raises(BundleCorrupt, match="not JSON"):
        load_bundle(folder)


@pytest.mark.parametrize(
    "place",
    [
        lambda fields, value: fields.update(version=value),
        lambda fields, value: fields.update(description=value),
        lambda fields, value: fields["licences"].append(value),
        lambda fields, value: fields["scores"].update({"cell": value + "\ud800"}),
        lambda fields, value: fields["scores"].update({"cell": float("nan")}),
        lambda fields, value: fields["stft"].update(n_fft=2**40),
        lambda fields, value: fields.update(grid_size=2**40),
    ],
)
def test_a_manifest_that_answers_could_not_repeat(
    folder: Path, place: Callable[[dict, str], object]
) -> None:
    edit(folder, lambda fields: place(fields, "1.0\x1b[2J"))
    with pytest.raises(BundleCorrupt):
        load_bundle(folder)


def test_an_error_shows_a_folder_in_one_line(tmp_path: Path) -> None:
    """Names of files need be no text."""
    with pytest.raises(BundleNotFound) as caught:
        load_bundle(tmp_path / "mo\ndels\udcff")
    assert caught.value.detail.isprintable()
    caught.value.detail.encode()


def npz(shape: tuple[int, ...], data: bytes) -> bytes:
    """A file of one compressed array of 32-bit floats."""
    file = io.BytesIO()
    with (
        zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("floor.npy", "w") as member,
    ):
        header = {"descr": "<f4", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(member, header)
        member.write(data)
    return file.getvalue()


@pytest.mark.parametrize("content", [npz((2**48,), b""), npz((-1, -1), bytes(4)), b"PK", b""])
def test_arrays_that_are_not_what_they_say(folder: Path, content: bytes) -> None:
    (folder / "fusion.npz").write_bytes(content)
    digest = file_sha256(folder / "fusion.npz")
    edit(folder, lambda fields: fields["files"].update({"fusion.npz": digest}))
    with pytest.raises(BundleCorrupt, match=r"fusion\.npz cannot be read"):
        load_bundle(folder)


def test_an_array_that_grows_a_thousandfold_is_not_read() -> None:
    content = npz((2**22,), bytes(2**24))
    assert len(content) < 2**15
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match="more than 1048576 bytes"):
            read_npz(content, most_bytes=2**20, compressed=True)
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()


def test_parts_that_fit_nothing_fail_the_self_test(folder: Path) -> None:
    """Each is what its hash says; together they raise whatever numpy and onnxruntime do."""
    np.savez(folder / "golden.npz", windows=np.zeros((1, 9, 5), np.float32))
    digest = file_sha256(folder / "golden.npz")
    edit(folder, lambda fields: fields.update(name="robot"))
    edit(folder, lambda fields: fields["files"].update({"golden.npz": digest}))
    with pytest.raises(SelfTestFailed, match="do not fit each other"):
        BundleRegistry.load([folder])


def test_a_graph_that_is_no_onnx(folder: Path) -> None:
    (folder / "covariance.onnx").write_bytes(b"not a graph")
    digest = file_sha256(folder / "covariance.onnx")
    edit(folder, lambda fields: fields["files"].update({"covariance.onnx": digest}))
    with pytest.raises(BundleCorrupt, match="not an ONNX graph"):
        load_bundle(folder)


def test_pickles_are_never_loaded(folder: Path) -> None:
    np.savez(folder / "fusion.npz", floor=np.array([{"a": 1}], dtype=object))
    digest = file_sha256(folder / "fusion.npz")
    edit(folder, lambda fields: fields["files"].update({"fusion.npz": digest}))
    with pytest.raises(BundleCorrupt, match="cannot be read"):
        load_bundle(folder)


def test_other_numbers_fail_the_self_test(folder: Path) -> None:
    with np.load(folder / "fusion.npz") as archive:
        fusion = {**archive, "floor": archive["floor"] * 3}
    np.savez(folder / "fusion.npz", **fusion)
    digest = file_sha256(folder / "fusion.npz")
    edit(folder, lambda fields: fields["files"].update({"fusion.npz": digest}))
    with pytest.raises(SelfTestFailed, match="golden"):
        self_test(load_bundle(folder))


def test_the_registry_chooses_by_geometry(folder: Path) -> None:
    square = preset("respeaker-usb-4mic-v2")
    bound = {"name": square.name, "positions_m": square.positions.tolist()}
    edit(folder, lambda fields: fields.update(name="bound", array=bound))
    registry = BundleRegistry([load_bundle(folder), *BundleRegistry.load().bundles])
    chosen = registry.for_array(square)
    assert chosen is not None
    assert chosen.manifest.name == "bound"
    other = registry.for_array(preset("matrix-voice"))
    assert other is not None
    assert other.manifest.name == "any-array"
    with pytest.raises(GeometryMismatch, match="respeaker-usb-4mic-v2"):
        registry.for_array(preset("matrix-voice"), "bound")
    with pytest.raises(UnknownModel, match="loaded are: bound, any-array"):
        registry.get("nothing")


@pytest.mark.parametrize("default", ["any-array", "bound"])
def test_the_default_bundle_is_preferred_where_it_fits(folder: Path, default: str) -> None:
    square = preset("respeaker-usb-4mic-v2")
    bound = {"name": square.name, "positions_m": square.positions.tolist()}
    edit(folder, lambda fields: fields.update(name="bound", array=bound))
    registry = BundleRegistry.load([folder], default=default)
    names = {
        array: bundle and bundle.manifest.name
        for array in ("respeaker-usb-4mic-v2", "matrix-voice")
        for bundle in [registry.for_array(preset(array))]
    }
    assert names == {"respeaker-usb-4mic-v2": default, "matrix-voice": "any-array"}


def test_of_the_embedded_bundles_the_one_with_the_smallest_error_answers(folder: Path) -> None:
    def scored(name: str, **errors: float) -> Manifest:
        cells = {cell: {"maae_deg": error} for cell, error in errors.items()}
        edit(folder, lambda fields: fields.update(name=name, scores={"cells": cells}))
        return read_manifest(folder)[0]

    manifests = [scored("worse", a=2.0, b=3.0), scored("better", a=1.0, b=3.5, c=90.0)]
    assert [manifest.name for manifest in by_error(manifests)] == ["better", "worse"]
    assert by_error([]) == []


@pytest.mark.parametrize(
    ("purpose", "names"),
    [
        ("localization", ["mine", "any-array", "paper"]),
        ("comparison", ["any-array", "mine", "paper"]),
    ],
)
def test_models_to_compare_with_come_after_those_to_use(
    folder: Path, purpose: str, names: list[str]
) -> None:
    edit(folder, lambda fields: fields.update(name="mine", purpose=purpose))
    registry = BundleRegistry.load([folder])
    assert [bundle.manifest.name for bundle in registry.bundles] == names
    answers = registry.for_array(preset("respeaker-usb-4mic-v2"))
    assert answers is registry.bundles[0]


def test_a_users_bundle_hides_the_embedded_one_of_its_name_wherever_it_lies(folder: Path) -> None:
    edit(folder, lambda fields: fields.update(version="9.9.9"))
    registry = BundleRegistry.load([folder.rename(folder.with_name("my-version"))])
    assert str(registry) == f"any-array 9.9.9, paper {registry.get('paper').manifest.version}"
    edit(folder.with_name("my-version"), lambda fields: fields.update(name="mine"))
    own = folder.with_name("my-version").rename(folder.with_name("any-array"))
    names = [bundle.manifest.name for bundle in BundleRegistry.load([own]).bundles]
    assert names == ["mine", "any-array", "paper"]


def test_a_folder_that_does_not_exist_is_an_error_and_an_empty_one_is_not(tmp_path: Path) -> None:
    assert len(BundleRegistry.load([tmp_path]).bundles) == 2
    with pytest.raises(BundleNotFound, match=r"no folder .*mistyped"):
        BundleRegistry.load([tmp_path / "mistyped"])


def test_two_bundles_of_one_name_are_refused(folder: Path) -> None:
    with pytest.raises(BundleCorrupt, match="any-array"):
        BundleRegistry([load_bundle(folder), load_bundle(folder)])


@pytest.mark.parametrize(
    "name", ["../../etc/passwd", "/etc/passwd", "a/b", "..", ".hidden", "a\nb"]
)
def test_a_manifest_names_no_file_elsewhere(folder: Path, name: str) -> None:
    edit(folder, lambda fields: fields["files"].update({name: "0" * 64}))
    with pytest.raises(BundleCorrupt, match="files"):
        load_bundle(folder)


@pytest.mark.parametrize("place", ["weights.bin", "../secret.bin", "{folder}/../secret.bin"])
def test_a_graph_that_wants_further_files_is_refused(tmp_path: Path, place: str) -> None:
    """ONNX may keep tensors in files beside the graph, which no hash would cover."""
    onnx = pytest.importorskip("onnx", reason="needs onnx")
    folder = tmp_path / "bundle"
    folder.mkdir()
    for path in (folder / "weights.bin", tmp_path / "secret.bin"):
        path.write_bytes(np.arange(4, dtype=np.float32).tobytes())
    float32 = onnx.TensorProto.FLOAT
    outside = onnx.TensorProto.EXTERNAL
    tensor = onnx.TensorProto(name="w", data_type=float32, dims=[4], data_location=outside)
    for key, value in {"location": place.format(folder=folder), "length": "16"}.items():
        entry = tensor.external_data.add()
        entry.key, entry.value = key, value
    ends = [onnx.helper.make_tensor_value_info(name, float32, [4]) for name in "xy"]
    node = onnx.helper.make_node("Add", ["x", "w"], ["y"])
    graph = onnx.helper.make_graph([node], "g", ends[:1], ends[1:], [tensor])
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)])
    model.ir_version = 8
    with pytest.raises(BundleCorrupt, match=r"graph\.onnx"):
        Engine(model.SerializeToString(), "graph.onnx")

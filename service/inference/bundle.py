"""A model bundle on disk: hashes verified, graphs loaded, self-tested before it serves."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from service.doa.array import MicrophoneArray
from service.doa.stft import Stft
from service.doa.types import FloatArray
from service.errors import BundleCorrupt, BundleIncompatible, BundleNotFound
from service.inference.engine import Engine
from service.inference.manifest import SCHEMA_VERSION, Graph, Manifest
from service.inference.results import ModelIdentity

MANIFEST = "bundle.json"
COVARIANCE = "covariance.onnx"
SOURCE_COUNT = "source_count.onnx"
FUSION = "fusion.npz"
GOLDEN = "golden.npz"
FILES = (COVARIANCE, SOURCE_COUNT, FUSION, GOLDEN)
COVARIANCE_STREAM = "covariance_stream.onnx"
"""The covariance network over a stream, frame after frame with its state; `weights` bundles"""
CARD = "card.md"
PARAMETERS = "parameters.npz"
OPTIONAL_FILES = (COVARIANCE_STREAM, CARD, PARAMETERS)
"""Nothing that recordings need; verified where the manifest names them"""
MAX_FILE_BYTES = 256 * 2**20


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """A loaded bundle; one instance serves all arrays and threads."""

    folder: Path
    manifest: Manifest
    sha256: str
    """Of bundle.json, which holds the hashes of all other files"""
    covariance: Engine
    source_count: Engine
    fusion: Mapping[str, FloatArray]
    golden: Mapping[str, FloatArray]
    covariance_stream: Engine | None = None
    card: str | None = None
    """The model card, Markdown"""

    @property
    def identity(self) -> ModelIdentity:
        manifest = self.manifest
        return ModelIdentity(manifest.name, manifest.version, manifest.variant, self.sha256)

    @property
    def stft(self) -> Stft:
        section = self.manifest.stft
        return Stft(section.sample_rate, section.n_fft, section.hop)

    def bound_array(self) -> MicrophoneArray | None:
        """The array that the bundle is bound to, or None where it works on any."""
        bound = self.manifest.array
        if bound == "any":
            return None
        return MicrophoneArray(bound.name, np.array(bound.positions_m))

    def fits(self, array: MicrophoneArray) -> bool:
        """True where the networks may be used with this array."""
        bound = self.bound_array()
        return bound is None or bound.matches(array)


def load_bundle(folder: Path, *, threads: int = 1) -> Bundle:
    """Read and verify a bundle's files and start its onnxruntime sessions.

    Raises
    ------
    BundleNotFound
        If the folder holds no ``bundle.json``.
    BundleIncompatible
        If the manifest was written for another version of this service.
    BundleCorrupt
        If a file is missing, differs from its hash or cannot be read.
    """
    manifest, digest = read_manifest(folder)
    named = set(manifest.files) | ({COVARIANCE_STREAM} if manifest.covariance_stream else set())
    for name in (*FILES, *(name for name in OPTIONAL_FILES if name in named)):
        _verify(folder, name, manifest.files.get(name))
    return Bundle(
        folder=folder,
        manifest=manifest,
        sha256=digest,
        covariance=_engine(folder / COVARIANCE, manifest.covariance, threads),
        source_count=_engine(folder / SOURCE_COUNT, manifest.source_count, threads),
        fusion=read_arrays(folder / FUSION),
        golden=read_arrays(folder / GOLDEN),
        covariance_stream=_engine(folder / COVARIANCE_STREAM, manifest.covariance_stream, threads)
        if manifest.covariance_stream
        else None,
        card=_text(folder / CARD) if CARD in manifest.files else None,
    )


def read_manifest(folder: Path) -> tuple[Manifest, str]:
    """A bundle's manifest and its SHA-256, without loading any network."""
    path = folder / MANIFEST
    if not path.is_file():
        raise BundleNotFound(f"{folder} holds no {MANIFEST}: name the folder of a model bundle")
    content = path.read_bytes()
    try:
        fields = json.loads(content)
    except ValueError as error:
        raise BundleCorrupt(f"{path} is not JSON: {error}") from error
    found = fields.get("schema_version") if isinstance(fields, dict) else None
    if found != SCHEMA_VERSION:
        raise BundleIncompatible(
            f"{path} has schema_version {found!r}, this service reads {SCHEMA_VERSION}: "
            "export the model again"
        )
    try:
        manifest = Manifest.model_validate(fields)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise BundleCorrupt(f"{path}: {place}: {first['msg']}") from error
    return manifest, hashlib.sha256(content).hexdigest()


def file_sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _verify(folder: Path, name: str, expected: str | None) -> None:
    path = folder / name
    if expected is None or not path.is_file():
        raise BundleCorrupt(f"{folder} lacks {name}: copy the whole bundle again")
    if path.stat().st_size > MAX_FILE_BYTES:
        raise BundleCorrupt(f"{path} is larger than {MAX_FILE_BYTES} bytes")
    if file_sha256(path) != expected:
        raise BundleCorrupt(f"{path} differs from its hash in {MANIFEST}: copy the bundle again")


def _engine(path: Path, graph: Graph, threads: int) -> Engine:
    engine = Engine(path, threads=threads)
    inputs, outputs = [t.name for t in graph.inputs], [t.name for t in graph.outputs]
    if engine.inputs != inputs or engine.outputs != outputs:
        raise BundleCorrupt(
            f"{path} takes {engine.inputs} and gives {engine.outputs}, but {MANIFEST} says "
            f"{inputs} and {outputs}"
        )
    return engine


def read_arrays(path: Path) -> dict[str, FloatArray]:
    """The arrays of one of a bundle's npz files by their names, or BundleCorrupt; no pickle."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (OSError, ValueError) as error:
        raise BundleCorrupt(f"{path} cannot be read: {error}") from error


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except ValueError as error:
        raise BundleCorrupt(f"{path} is not text: {error}") from error

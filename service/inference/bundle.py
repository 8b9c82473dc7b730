"""A model bundle on disk: hashes verified, graphs loaded, self-tested before it serves."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from pydantic import ValidationError
from pydantic_core import from_json

from neuralmusic.errors import BundleCorrupt, BundleIncompatible, BundleNotFound
from service.doa.array import MicrophoneArray
from service.doa.stft import Stft
from service.doa.types import FloatArray
from service.inference.engine import Engine
from service.inference.manifest import SCHEMA_VERSION, Graph, Manifest
from service.inference.npz import read_npz
from service.inference.results import MAX_SOURCES, ModelIdentity

MANIFEST = "bundle.json"
COVARIANCE = "covariance.onnx"
SOURCE_COUNT = "source_count.onnx"
FUSION = "fusion.npz"
GOLDEN = "golden.npz"
FILES = (COVARIANCE, SOURCE_COUNT, FUSION, GOLDEN)
COVARIANCE_STREAM = "covariance_stream.onnx"
"""Covariance network of `weights` bundles for streams, frame after frame with its state"""
CARD = "card.md"
PARAMETERS = "parameters.npz"
COVARIANCE_BY_COUNT = {count: f"covariance_{count}.onnx" for count in range(1, MAX_SOURCES + 1)}
"""Covariance networks of `regression` bundles for one number of sources each"""
OPTIONAL_FILES = (COVARIANCE_STREAM, CARD, PARAMETERS, *COVARIANCE_BY_COUNT.values())
"""Files that not every bundle has; verified where the manifest names them"""
MAX_FILE_BYTES = 256 * 2**20


@dataclass(frozen=True, slots=True, eq=False)
class BundleFiles:
    """A bundle's verified files in memory; they can be pickled, so workers run the very same.

    The hashed bytes are the ones that run: a later change of the folder has no effect.
    """

    folder: Path
    """Folder that was read"""
    manifest: Manifest
    sha256: str
    """Hash of bundle.json, which holds the hashes of all other files"""
    content: Mapping[str, bytes]
    """Content by file name, without the parameters for fine-tuning, which the service never uses"""


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """A loaded bundle; one instance serves all arrays and threads."""

    files: BundleFiles
    covariance: Engine
    source_count: Engine
    fusion: Mapping[str, FloatArray]
    golden: Mapping[str, FloatArray]
    covariance_by_count: Mapping[int, Engine] = field(default_factory=dict)
    covariance_stream: Engine | None = None
    card: str | None = None
    """The model card, Markdown"""

    @property
    def folder(self) -> Path:
        return self.files.folder

    @property
    def manifest(self) -> Manifest:
        return self.files.manifest

    @property
    def sha256(self) -> str:
        return self.files.sha256

    @property
    def identity(self) -> ModelIdentity:
        manifest = self.manifest
        return ModelIdentity(manifest.name, manifest.version, manifest.variant, self.sha256)

    @property
    def stft(self) -> Stft:
        section = self.manifest.stft
        return Stft(section.sample_rate, section.n_fft, section.hop)

    def bound_array(self) -> MicrophoneArray | None:
        """The array that the bundle is bound to, or None where it works with any."""
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
    BundleNotFound, BundleIncompatible, BundleCorrupt
        As ``read_bundle`` and ``open_bundle``.
    """
    return open_bundle(read_bundle(folder), threads=threads)


def read_bundle(folder: Path) -> BundleFiles:
    """Read a bundle's files and verify their hashes.

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
    named |= {COVARIANCE_BY_COUNT[count] for count in manifest.covariance_by_count}
    wanted = (*FILES, *(name for name in OPTIONAL_FILES if name in named))
    content = {name: _verified(folder, name, manifest.files.get(name)) for name in wanted}
    content.pop(PARAMETERS, None)
    return BundleFiles(folder, manifest, digest, content)


def open_bundle(files: BundleFiles, *, threads: int = 1) -> Bundle:
    """Start a bundle's onnxruntime sessions.

    Raises
    ------
    BundleCorrupt
        If a graph or an array cannot be read, or differs from the manifest.
    """
    manifest = files.manifest
    stream = manifest.covariance_stream
    return Bundle(
        files=files,
        covariance=_engine(files, COVARIANCE, manifest.covariance, threads),
        source_count=_engine(files, SOURCE_COUNT, manifest.source_count, threads),
        fusion=_arrays(files, FUSION),
        golden=_arrays(files, GOLDEN),
        covariance_by_count={
            count: _engine(files, COVARIANCE_BY_COUNT[count], graph, threads)
            for count, graph in manifest.covariance_by_count.items()
        },
        covariance_stream=_engine(files, COVARIANCE_STREAM, stream, threads) if stream else None,
        card=_text(files, CARD) if CARD in files.content else None,
    )


def read_manifest(folder: Path) -> tuple[Manifest, str]:
    """A bundle's manifest and its SHA-256, without loading any network."""
    path = folder / MANIFEST
    if not path.is_file():
        raise BundleNotFound(f"{folder} holds no {MANIFEST}: name the folder of a model bundle")
    content = _content(path)
    try:
        # Neither NaN nor half a surrogate pair: answers repeat what is in here.
        fields = from_json(content, allow_inf_nan=False)
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


def _verified(folder: Path, name: str, expected: str | None) -> bytes:
    """The content of a file, checked against its hash."""
    path = folder / name
    if expected is None or not path.is_file():
        raise BundleCorrupt(f"{folder} lacks {name}: copy the whole bundle again")
    content = _content(path)
    if hashlib.sha256(content).hexdigest() != expected:
        raise BundleCorrupt(f"{path} differs from its hash in {MANIFEST}: copy the bundle again")
    return content


def _content(path: Path) -> bytes:
    """Of a file that is not too large."""
    try:
        with path.open("rb") as file:
            content = file.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise BundleCorrupt(f"{path} cannot be read: {error}") from error
    if len(content) > MAX_FILE_BYTES:
        raise BundleCorrupt(f"{path} is larger than {MAX_FILE_BYTES} bytes")
    return content


def _engine(files: BundleFiles, name: str, graph: Graph, threads: int) -> Engine:
    engine = Engine(files.content[name], name, threads=threads)
    inputs, outputs = [t.name for t in graph.inputs], [t.name for t in graph.outputs]
    if engine.inputs != inputs or engine.outputs != outputs:
        raise BundleCorrupt(
            f"{files.folder / name} takes {engine.inputs} and gives {engine.outputs}, but "
            f"{MANIFEST} says {inputs} and {outputs}"
        )
    return engine


def _arrays(files: BundleFiles, name: str) -> dict[str, FloatArray]:
    return read_arrays(files.content[name], files.folder / name)


def read_arrays(content: bytes, path: Path) -> dict[str, FloatArray]:
    """The arrays of a bundle's npz file by name, without pickle; raises BundleCorrupt."""
    try:
        return read_npz(content, most_bytes=MAX_FILE_BYTES, compressed=True)
    except ValueError as error:
        raise BundleCorrupt(f"{path} cannot be read: {error}") from error


def _text(files: BundleFiles, name: str) -> str:
    try:
        return files.content[name].decode("utf-8")
    except ValueError as error:
        raise BundleCorrupt(f"{files.folder / name} is not text: {error}") from error

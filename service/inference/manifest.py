"""bundle.json, the manifest of a model bundle."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from service.inference.results import MAX_SOURCES

SCHEMA_VERSION: Literal[2] = 2
Variant = Literal["weights", "regression"]
NAME_PATTERN = r"^[a-z0-9][a-z0-9._-]{0,63}$"
FILE_PATTERN = r"^[A-Za-z0-9_][A-Za-z0-9._-]{0,63}$"
"""Names of files beside the manifest; none leads out of the folder"""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


class BoundArray(_Section):
    """The array that a `regression` bundle was trained for."""

    name: str
    positions_m: list[tuple[float, float, float]]
    """Metres, in channel order"""


class StftSection(_Section):
    """The transform in front of the networks."""

    sample_rate: int
    """Hertz"""
    n_fft: int
    """Samples in a frame"""
    hop: int
    """Samples between frames"""
    frames: int
    """Frames per window that the networks were trained on"""


class Tensor(_Section):
    """One input or output of a graph; named dimensions are dynamic."""

    name: str
    shape: list[int | str]


class Graph(_Section):
    """The inputs and outputs of an ONNX graph; all tensors are float32."""

    inputs: list[Tensor]
    outputs: list[Tensor]


class Manifest(_Section):
    """The content of bundle.json."""

    schema_version: Literal[2] = SCHEMA_VERSION
    name: str = Field(pattern=NAME_PATTERN)
    version: str
    variant: Variant
    """`weights` gives time-frequency weights, for any array; `regression` matrices, for one"""
    description: str
    array: Literal["any"] | BoundArray
    stft: StftSection
    grid_size: int
    """Azimuths of the spectra; a `weights` bundle takes twice as many for arrays above 0.3 m"""
    first_bin: int
    """First STFT bin of the networks' input"""
    num_bins: int
    """Number of STFT bins of the networks' input"""
    level_exponent: float = 0.0
    """Exponent of the level in a `regression` bundle's features (`service/doa/spectrogram.py`)"""
    max_sources: int
    """Largest count that the source-count network can give"""
    files: dict[Annotated[str, Field(pattern=FILE_PATTERN)], str]
    """SHA-256 of every other file of the bundle"""
    covariance: Graph
    covariance_by_count: dict[Annotated[int, Field(ge=1, le=MAX_SOURCES)], Graph] = {}
    """Graphs of a `regression` bundle's covariance networks for one number of sources each"""
    source_count: Graph
    covariance_stream: Graph | None = None
    """Graph of the covariance network for streams, where the bundle has one"""
    training: dict[str, Any]
    """Configuration, seed, steps and data"""
    scores: dict[str, Any]
    """Results on held-out speakers, with the protocol of the measurement"""
    parity: dict[str, Any]
    """Largest differences of the spectra between torch, onnxruntime and numpy"""
    licences: list[str]
    """Licences of the training data"""

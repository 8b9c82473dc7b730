"""bundle.json: what a model bundle says of itself."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from service.doa.array import MAX_MICROPHONES
from service.protocol.client_messages import MAX_SAMPLE_RATE, MIN_SAMPLE_RATE
from service.protocol.names import MAX_LABEL, is_label

SCHEMA_VERSION: Literal[2] = 2
Variant = Literal["weights", "regression"]
NAME_PATTERN = r"^[a-z0-9][a-z0-9._-]{0,63}$"
FILE_PATTERN = r"^[A-Za-z0-9_][A-Za-z0-9._-]{0,63}$"
"""Of a file beside the manifest: nothing that leads out of the folder"""


MAX_FFT = 4096
MAX_ANGLES = 3600


def _label(text: str) -> str:
    if not is_label(text):
        raise ValueError(f"must be 1 to {MAX_LABEL} printable characters")
    return text


def _line(text: str) -> str:
    if not text.isprintable():
        raise ValueError("must be one line of printable text")
    return text


Label = Annotated[str, AfterValidator(_label)]
Line = Annotated[str, AfterValidator(_line)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)


class BoundArray(_Section):
    """The array that a `regression` bundle was trained for."""

    name: Label
    positions_m: list[tuple[float, float, float]]
    """Metres, in channel order"""


class StftSection(_Section):
    """The transform in front of the networks."""

    sample_rate: Annotated[int, Field(ge=MIN_SAMPLE_RATE, le=MAX_SAMPLE_RATE)]
    """Hertz"""
    n_fft: Annotated[int, Field(ge=16, le=MAX_FFT)]
    """Samples"""
    hop: Annotated[int, Field(ge=1, le=MAX_FFT)]
    """Samples"""
    frames: Annotated[int, Field(ge=1, le=MAX_FFT)]
    """Frames per window that the networks were trained on"""


class Tensor(_Section):
    """One input or output of a graph; named dimensions are dynamic."""

    name: str
    shape: list[int | str]


class Graph(_Section):
    """An ONNX graph's contract; all tensors are float32."""

    inputs: list[Tensor]
    outputs: list[Tensor]


class Manifest(_Section):
    """Everything that a bundle says of itself."""

    schema_version: Literal[2] = SCHEMA_VERSION
    name: str = Field(pattern=NAME_PATTERN)
    version: Label
    variant: Variant
    """`weights`: time-frequency weights come out, any array; `regression`: matrices, one array"""
    description: Line
    array: Literal["any"] | BoundArray
    stft: StftSection
    grid_size: Annotated[int, Field(ge=4, le=MAX_ANGLES)]
    """Azimuths of the spectra; a `weights` bundle takes twice as many for arrays above 0.3 m"""
    first_bin: Annotated[int, Field(ge=0, le=MAX_FFT)]
    """First STFT bin that the networks see"""
    num_bins: Annotated[int, Field(ge=1, le=MAX_FFT)]
    """Bins that the networks see"""
    max_sources: Annotated[int, Field(ge=1, le=MAX_MICROPHONES)]
    """Largest count that the source-count network can give"""
    files: dict[Annotated[str, Field(pattern=FILE_PATTERN)], str]
    """SHA-256 of every other file of the bundle"""
    covariance: Graph
    source_count: Graph
    covariance_stream: Graph | None = None
    """Of the covariance network over a stream, where the bundle has one"""
    training: dict[str, Any]
    """Configuration, seed, steps and data"""
    scores: dict[str, Any]
    """Results on held-out speakers, with the protocol that they were measured on"""
    parity: dict[str, Any]
    """Largest differences of the spectra between torch, onnxruntime and numpy"""
    licences: list[Line]
    """Licences of the training data"""

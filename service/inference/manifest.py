"""bundle.json, the manifest of a model bundle."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from neuralmusic.protocol.client_messages import MAX_SAMPLE_RATE, MIN_SAMPLE_RATE
from neuralmusic.protocol.names import MAX_LABEL, is_label
from service.doa.array import MAX_MICROPHONES
from service.inference.results import MAX_SOURCES

SCHEMA_VERSION: Literal[2] = 2
Variant = Literal["weights", "regression"]
Purpose = Literal["localization", "comparison"]
NAME_PATTERN = r"^[a-z0-9][a-z0-9._-]{0,63}$"
FILE_PATTERN = r"^[A-Za-z0-9_][A-Za-z0-9._-]{0,63}$"
"""Names of files beside the manifest; none leads out of the folder"""


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
    """Samples in a frame"""
    hop: Annotated[int, Field(ge=1, le=MAX_FFT)]
    """Samples between frames"""
    frames: Annotated[int, Field(ge=1, le=MAX_FFT)]
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
    version: Label
    variant: Variant
    """`weights` gives time-frequency weights, for any array; `regression` matrices, for one"""
    description: Line
    purpose: Purpose = "localization"
    """`comparison` for a model that another one surpasses wherever it fits"""
    array: Literal["any"] | BoundArray
    stft: StftSection
    grid_size: Annotated[int, Field(ge=4, le=MAX_ANGLES)]
    """Azimuths of the spectra; a `weights` bundle takes twice as many for arrays above 0.3 m"""
    first_bin: Annotated[int, Field(ge=0, le=MAX_FFT)]
    """First STFT bin of the networks' input"""
    num_bins: Annotated[int, Field(ge=1, le=MAX_FFT)]
    """Number of STFT bins of the networks' input"""
    level_exponent: float = 0.0
    """Exponent of the level in a `regression` bundle's features (`service/doa/spectrogram.py`)"""
    max_sources: Annotated[int, Field(ge=1, le=MAX_MICROPHONES)]
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
    licences: list[Line]
    """Licences of the training data"""

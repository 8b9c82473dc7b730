"""Every training run as a frozen dataclass, by name."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np

from model_export.simulation.scene_config import SceneConfig
from service.doa.spectrogram import PhaseReference

Variant = Literal["weights", "regression", "sscl"]
Trunk = Literal["strided", "separable"]
"""The convolutions of the `weights` variant's network"""


@dataclass(frozen=True, slots=True)
class TrainingConfig:
    """One training run."""

    name: str
    variant: Variant
    steps: int
    """Optimizer steps"""
    batch_size: int = 16
    """Scenes per step"""
    final_batch_size: int | None = None
    """Scenes per step in the last tenth of the steps; None keeps ``batch_size``"""
    learning_rate: float = 2e-3
    """Rate at the start; it falls to a hundredth along a cosine"""
    weight_decay: float = 1e-4
    grid_size: int = 120
    """Angles of the training grid; its offset is drawn anew for every batch"""
    target_sigma_deg: float = 6.0
    """Width of the target's wrapped Gaussians in degrees"""
    count_weight: float = 0.0
    """Lambda of the source-count cross entropy (the paper's 0.5)"""
    subspace_weight: float = 1.0
    """Weight of the `regression` variant's subspace distance; 0 leaves the paper's loss"""
    phase_reference: PhaseReference = "first"
    """Phases of the `regression` variant's features; "absolute" is the paper's text"""
    level_exponent: float = 0.0
    """Exponent of the level in its features (``service.doa.spectrogram``); 0 keeps unit vectors"""
    smooth_kernels: int = 0
    """Cosines that its last convolution is trained as (``reparametrize``); 0 trains free kernels"""
    pool_first: bool = False
    """Whether its networks are trained with pooling before batch norm (``reparametrize``)"""
    bin_step: int = 1
    """Step between the bins whose spectra enter its loss; the first bin is random"""
    attention: bool = True
    """Whether the `regression` variant weighs bins (FAF); False takes their mean, an ablation"""
    array: str | None = None
    """Preset that the run is bound to; None draws random arrays from the room bank"""
    singles: bool = False
    """Whether scenes are sums of single talkers from a bank, instead of drawn in a room bank"""
    starts_from: str | None = None
    """Name of the run whose parameters this one starts from"""
    earlier_scenes: int = 0
    """Scenes that its network had met before, where it is trained further"""
    trunk: Trunk = "strided"
    distils: bool = False
    """Whether the run that this one starts from teaches it its weights and attentions"""
    scenes: SceneConfig = field(default_factory=SceneConfig)
    short_windows: float = 0.0
    """Share of the `weights` variant's batches that are cut to half a second"""
    batches_per_chunk: int = 6
    """Batches drawn from one chunk of rooms before the next is loaded"""
    checkpoint_every: int = 250
    """Steps between checkpoints, curves and validation"""
    validation_scenes: int = 128
    """Scenes that every validation is scored on"""
    seed: int = 1

    def __post_init__(self) -> None:
        if min(self.steps, self.batch_size, self.final_batch_size or 1) < 1:
            raise ValueError("steps and batch sizes must be positive")
        if self.variant != "weights" and self.array is None:
            raise ValueError(f"the {self.variant} variant is bound to one array: name its preset")
        if self.level_exponent and self.phase_reference != "first":
            raise ValueError("level_exponent is for features of phase_reference 'first' only")

    def batch_size_at(self, step: int) -> int:
        """Scenes of one step, which counts from 0."""
        return self.batch_size if step < self._early_steps else self._late_batch_size

    def scenes_in(self, steps: int) -> int:
        """Scenes that the network has met after so many steps."""
        early = min(steps, self._early_steps)
        late = (steps - early) * self._late_batch_size
        return self.earlier_scenes + early * self.batch_size + late

    @property
    def _early_steps(self) -> int:
        return self.steps - self.steps // 10

    @property
    def _late_batch_size(self) -> int:
        return self.batch_size if self.final_batch_size is None else self.final_batch_size

    def check_features(self, other: TrainingConfig) -> None:
        """Raise ValueError if another run's networks take other features."""
        for setting in ("array", "phase_reference", "level_exponent"):
            ours, theirs = getattr(self, setting), getattr(other, setting)
            if ours != theirs:
                raise ValueError(
                    f"{self.name} was trained with {setting} {ours}, but {other.name} has "
                    f"{theirs}: train both with the same {setting}"
                )

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_dict(cls, fields: dict[str, Any]) -> TrainingConfig:
        """The configuration that ``as_dict`` wrote, also after a round trip through JSON.

        Fields that an older version did not write have their defaults.
        """
        scenes: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value
            for key, value in fields["scenes"].items()
        }
        return cls(**{**fields, "scenes": SceneConfig(**scenes)})


ANY_ARRAY = TrainingConfig(
    name="any-array",
    variant="weights",
    steps=4500,
    grid_size=180,
    target_sigma_deg=4.0,
    scenes=SceneConfig(source_counts=(0.06, 0.50, 0.34, 0.10), snr_db=(-6.0, 35.0)),
)

ANY_ARRAY_FINE = replace(
    ANY_ARRAY,
    name="any-array-fine",
    starts_from="any-array",
    steps=2500,
    learning_rate=1e-3,
    grid_size=240,
    target_sigma_deg=3.0,
    short_windows=0.2,
    scenes=replace(ANY_ARRAY.scenes, snr_db=(-8.0, 35.0)),
    seed=2,
)
"""A finer grid and narrower targets, once the network knows where to look"""

ANY_ARRAY_NOISE = replace(
    ANY_ARRAY_FINE,
    name="any-array-noise",
    starts_from="any-array-fine",
    steps=1500,
    learning_rate=5e-4,
    short_windows=0.1,
    scenes=replace(ANY_ARRAY.scenes, snr_db=(-8.0, 25.0)),
    seed=3,
)
"""More of the noise in which errors are large"""

MANY_FANS = replace(
    ANY_ARRAY.scenes, source_counts=(0.16, 0.46, 0.29, 0.09), snr_db=(-8.0, 35.0), machine=0.24
)
"""A small network tells a fan from a talker only where it has met many"""

ANY_ARRAY_LIGHT = replace(
    ANY_ARRAY,
    name="any-array-light",
    starts_from="any-array-noise",
    distils=True,
    trunk="separable",
    steps=8000,
    learning_rate=3e-3,
    short_windows=0.15,
    scenes=MANY_FANS,
    batches_per_chunk=12,
    seed=4,
)
"""A network of half the cost, taught by the dense one"""

ANY_ARRAY_LIGHT_FINE = replace(
    ANY_ARRAY_NOISE,
    name="any-array-light-fine",
    starts_from="any-array-light",
    trunk="separable",
    scenes=MANY_FANS,
    seed=5,
)
"""A last stage of spectra for the distilled network"""

PAPER_SCENES = SceneConfig(
    source_counts=(0.05, 0.40, 0.40, 0.15),
    min_separation=np.deg2rad(10.0),
    snr_db=(30.0, 30.0),
    symmetric=True,
)
"""The paper's protocol, with counts of 0 to 3: sums of single talkers, and sensor noise alone"""

PAPER_SSCL = TrainingConfig(
    name="paper-sscl",
    variant="sscl",
    steps=50_000,
    batch_size=4,
    level_exponent=0.15,
    smooth_kernels=16,
    pool_first=True,
    array="respeaker-usb-4mic-v2",
    singles=True,
    scenes=replace(PAPER_SCENES, source_counts=(0.0, 0.6, 0.3, 0.1)),
    checkpoint_every=2500,
    validation_scenes=256,
)
"""The paper's first stage: a masked microphone is reconstructed, no direction is ever told"""

PAPER = replace(
    PAPER_SSCL,
    name="paper",
    variant="regression",
    starts_from="paper-sscl",
    steps=250_000,
    target_sigma_deg=5.0,
    count_weight=0.5,
    bin_step=2,
    scenes=PAPER_SCENES,
)
"""The paper's second stage for an unknown number of talkers, with the count branch"""


def _known(count: int) -> TrainingConfig:
    """The second stage for scenes of so many talkers, as the paper trains one network for each."""
    certain = tuple(float(each == count) for each in range(count + 1))
    scenes = replace(PAPER_SCENES, source_counts=certain)
    return replace(PAPER, name=f"paper-{count}", count_weight=0.0, scenes=scenes)


PAPER_KNOWN = tuple(_known(count) for count in (1, 2, 3))

CONFIGS = {
    config.name: config
    for config in (
        ANY_ARRAY,
        ANY_ARRAY_FINE,
        ANY_ARRAY_NOISE,
        ANY_ARRAY_LIGHT,
        ANY_ARRAY_LIGHT_FINE,
        PAPER_SSCL,
        PAPER,
        *PAPER_KNOWN,
    )
}


def smoke(config: TrainingConfig) -> TrainingConfig:
    """The same run cut to a few steps, for tests and for trying an installation."""
    return replace(
        config,
        steps=4,
        batch_size=4,
        checkpoint_every=2,
        batches_per_chunk=2,
        validation_scenes=8,
    )

"""Scenes that the experiments train and score on."""

from __future__ import annotations

from dataclasses import dataclass, replace

from model_export.evaluation.cells import large_room, small_room
from model_export.experiments.scale import Scale
from model_export.experiments.scene_set import Recipe
from model_export.simulation.protocol import SceneProtocol

TRAIN = "train"
COUNTS = (1, 2, 1, 2, 1, 2, 1, 2, 3)
"""Numbers of talkers of the training scenes, in turn"""
SPARSE_DEG = (5, 10)
PLACES = {
    "room B": SceneProtocol(room=small_room(0.35)),
    "room C": SceneProtocol(room=large_room(0.6)),
    "array B": SceneProtocol(array="4-mic ring r 50 mm"),
    "array C": SceneProtocol(array="irregular 4-mic"),
}
"""Rooms and arrays other than those of the training (A), chosen by us, since the paper does not say
what its B and C are. Room B is small and dry, C large and reverberant; array B is another ring,
turned by 45 degrees, C irregular and not flat."""
LINEAR = "4-mic line, 40 mm apart"


@dataclass(frozen=True, slots=True)
class Cell:
    """Scenes that a method is scored on, and whether it knows the count."""

    scenes: str
    """Name of the scene set"""
    count_known: bool = True
    snr_db: float | None = None
    """SNR of further white noise"""
    first: int | None = None
    """Number of scenes to score, the first ones; None is all"""

    @property
    def key(self) -> str:
        """A name for files."""
        parts = [self.scenes.replace(" ", "-"), "known" if self.count_known else "unknown"]
        parts += [] if self.snr_db is None else [f"{self.snr_db:g}dB"]
        parts += [] if self.first is None else [f"first{self.first}"]
        return "-".join(parts)


def recipes(scale: Scale) -> dict[str, Recipe]:
    """Recipes of all scene sets by name."""
    train = tuple(SceneProtocol(num_sources=count, orders=(0, 4)) for count in COUNTS)
    found = [Recipe(TRAIN, train, "train", scale.train_scenes, 101)]
    for step in SPARSE_DEG:
        allowed = tuple(float(angle) for angle in range(0, 360, step))
        sparse = tuple(replace(protocol, azimuths_deg=allowed) for protocol in train)
        found.append(Recipe(f"train-{step}", sparse, "train", scale.train_scenes, 101 + step))
    for count in (1, 2, 3):
        protocol = SceneProtocol(num_sources=count)
        found.append(
            Recipe(f"test-{count}", (protocol,), "heldout", scale.test_scenes, 200 + count)
        )
    for place, (name, protocol) in enumerate(PLACES.items()):
        found.append(Recipe(name, (protocol,), "heldout", scale.sweep_scenes, 300 + place))
        step_deg = 360 / scale.labelled_directions
        labelled = tuple(
            replace(protocol, azimuths_deg=(direction * step_deg,))
            for direction in range(scale.labelled_directions)
        )
        found.append(Recipe(f"{name} labelled", labelled, "train", len(labelled), 400 + place))
    for count in (1, 2):
        line = SceneProtocol(num_sources=count, array=LINEAR)
        found.append(Recipe(f"line-{count}", (line,), "heldout", scale.sweep_scenes, 500 + count))
    return {recipe.name: recipe for recipe in found}

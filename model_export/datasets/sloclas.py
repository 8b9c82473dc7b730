"""SLoClas: ten classes of sounds from a loudspeaker at 72 directions, heard by four microphones."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np

from model_export.datasets.audio import check_audio, read_audio
from model_export.datasets.fault import Count, DatasetError, Fault, collect, miscounts
from model_export.datasets.item import DatasetItem, Directions, check_split
from service.doa.array import MicrophoneArray
from service.doa.presets import preset

AUDIO = "Segmented_Sound"
CLASSES = 10
DIRECTIONS = 72
CHANNELS = 4
TRAIN_SHARE = 0.8
AZIMUTH = re.compile(r"class\d+_(\d+)")
"""Pattern of a sequence's folder name, with the direction in degrees"""

ARRAY = MicrophoneArray(
    "sloclas",
    # The NeuralMUSIC paper's code orders them as 135, 45, 315, 225 degrees.
    preset("respeaker-usb-4mic-v2").positions[[1, 0, 3, 2]],
    "the ReSpeaker square, in the order of the NeuralMUSIC paper's code; not published with the "
    "data",
)


class SLoClas:
    """Every segment is one item with one constant direction, a multiple of 5 degrees plus 1.

    In the order of names, the first four fifths of each sequence's segments train, the rest test.
    The annotated zero is not the array's: see ``offset``.
    """

    name: ClassVar[str] = "sloclas"
    licence: ClassVar[str] = "as the Zenodo record says"
    source: ClassVar[str] = (
        "Qian et al., SLoClas: A Database for Joint Sound Localization and Classification, "
        "O-COCOSDA 2021, arXiv 2108.02539; https://zenodo.org/records/5211296"
    )
    layout: ClassVar[str] = (
        "SoClas_database/Segmented_Sound/<class>/class<k>_<degrees>.../*.wav, 4 channels"
    )
    splits: ClassVar[tuple[str, ...]] = ("train", "test")

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def items(self, split: str) -> Iterator[DatasetItem]:
        check_split(self, split)
        sequences = _sequences(self.folder)
        if not sequences:
            raise DatasetError("missing", self.folder, f"holds no {AUDIO}/: expected {self.layout}")
        for sequence, paths in sequences.items():
            degrees = _degrees(sequence)
            cut = int(TRAIN_SHARE * len(paths))
            for path in paths[:cut] if split == "train" else paths[cut:]:
                yield DatasetItem(
                    read_audio(path, CHANNELS),
                    ARRAY,
                    Directions.constant(np.deg2rad(degrees % 360)),
                    {
                        "dataset": self.name,
                        "split": split,
                        "sequence": sequence.name,
                        "path": str(path),
                        "licence": self.licence,
                        "class": sequence.parent.name,
                        "annotated_deg": degrees,
                    },
                )

    @classmethod
    def recognises(cls, folder: Path) -> bool:
        return _root(folder) is not None

    @classmethod
    def counts(cls, folder: Path) -> list[Count]:
        sequences = _sequences(folder)
        return [
            Count("classes", len({path.parent for path in sequences}), (CLASSES,)),
            Count("directions", len(set().union(*_directions(sequences).values())), (DIRECTIONS,)),
            Count("segments", sum(map(len, sequences.values())), ()),
        ]

    @classmethod
    def verify(cls, folder: Path) -> list[Fault]:
        root = _root(folder)
        if root is None:
            return [Fault("missing", folder / AUDIO, f"is missing: expected {cls.layout}")]
        sequences = _sequences(folder)
        faults = miscounts(root, cls.counts(folder))
        faults += collect(partial(_degrees, sequence) for sequence in sequences)
        faults += [
            Fault(
                "missing",
                kind,
                f"has sounds from {len(found)} of {DIRECTIONS} directions: unpack it again",
            )
            for kind, found in _directions(sequences).items()
            if len(found) < DIRECTIONS
        ]
        return faults + collect(
            partial(check_audio, path, CHANNELS) for paths in sequences.values() for path in paths
        )


def _root(folder: Path) -> Path | None:
    for root in (folder, folder / AUDIO, folder / "SoClas_database" / AUDIO):
        if root.name == AUDIO and root.is_dir():
            return root
    return None


def _sequences(folder: Path) -> dict[Path, list[Path]]:
    """Segments by the folder of their sequence, both sorted."""
    root = _root(folder)
    sequences: dict[Path, list[Path]] = {}
    for path in sorted(root.glob("*/*/*.wav")) if root is not None else ():
        sequences.setdefault(path.parent, []).append(path)
    return sequences


def _directions(sequences: Iterable[Path]) -> dict[Path, set[int]]:
    """Directions of each class, in degrees."""
    directions: dict[Path, set[int]] = {}
    for sequence in sequences:
        found = directions.setdefault(sequence.parent, set())
        with suppress(DatasetError):  # a fault of its own
            found.add(_degrees(sequence))
    return directions


def _degrees(sequence: Path) -> int:
    """The annotated direction, 1 to 360."""
    match = AZIMUTH.search(sequence.name)
    if match is None or not 1 <= int(match[1]) <= 360:
        raise DatasetError(
            "annotation",
            sequence,
            "the folder's name has no direction from 1 to 360 as class<k>_<degrees>: keep the "
            "names of the download",
        )
    return int(match[1])

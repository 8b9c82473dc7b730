"""The data sets by name, and recognition of a folder's data set."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from model_export.datasets.afpild import AFPILD
from model_export.datasets.av163 import AV163
from model_export.datasets.item import Dataset
from model_export.datasets.locata import LOCATA
from model_export.datasets.sloclas import SLoClas
from model_export.datasets.speech_commands_rooms import SpeechCommandsRooms

DATASETS: Mapping[str, type[Dataset]] = MappingProxyType(
    {dataset.name: dataset for dataset in (SpeechCommandsRooms, AV163, SLoClas, AFPILD, LOCATA)}
)


def named(name: str) -> type[Dataset]:
    """The data set with this name.

    Raises
    ------
    ValueError
        If there is none.
    """
    if name not in DATASETS:
        raise ValueError(f"no data set is named {name!r}; the data sets are {', '.join(DATASETS)}")
    return DATASETS[name]


def recognise(folder: Path) -> type[Dataset]:
    """The data set that a folder holds, complete or not.

    Raises
    ------
    ValueError
        If the folder looks like none of them or like several.
    """
    found = [dataset for dataset in DATASETS.values() if dataset.recognises(folder)]
    if len(found) == 1:
        return found[0]
    looks = f"like {' and '.join(dataset.name for dataset in found)}" if found else "like none"
    raise ValueError(
        f"{folder} looks {looks} of {', '.join(DATASETS)}: name the folder that the download "
        "unpacked to, or --dataset; datasets list shows the layouts"
    )

"""Speech Commands in simulated rooms, by the NeuralMUSIC paper's protocol, speakers kept apart."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import ClassVar, overload

from model_export import SAMPLE_RATE
from model_export.datasets.audio import check_audio
from model_export.datasets.fault import Count, DatasetError, Fault, collect, miscounts, require
from model_export.datasets.item import DatasetItem, Directions, check_split
from model_export.datasets.speech import Clip, Split, load, speech_commands
from model_export.simulation.protocol import SceneProtocol, simulate_scene
from service.doa.types import FloatArray

LISTS = ("validation_list.txt", "testing_list.txt")
SPLITS: dict[str, Split] = {
    "train": "train",
    "development": "development",
    "test": "heldout",
}
FILES = (64_727, 105_829)
WORDS = (30, 35)
"""Numbers of words in versions 0.01 and 0.02, as in ``FILES``"""
PAPER = SceneProtocol(orders=(0, 4))
"""The paper's room of 7 x 7 x 3 m, image orders 0 to 4, its ReSpeaker square, 30 dB"""


class SpeechCommandsRooms:
    """Scenes in the paper's room; a scene is simulated when it is iterated.

    Unlike in the paper's code, no speaker is in two splits, background noise is not speech, every
    source has a distance of its own and two sources are at least ten degrees apart.

    Parameters
    ----------
    folder : Path
        Folder of the corpus, with its two lists.
    scenes : int
        Number of items in every split; the paper trains on 36,000 and tests on 9,000 or 14,400.
    """

    name: ClassVar[str] = "speech-commands"
    licence: ClassVar[str] = "CC BY 4.0"
    source: ClassVar[str] = (
        "Warden, Speech Commands: A Dataset for Limited-Vocabulary Speech Recognition, 2018, arXiv "
        "1804.03209; http://download.tensorflow.org/data/speech_commands_v0.02.tar.gz"
    )
    layout: ClassVar[str] = "<word>/<speaker>_nohash_<k>.wav, validation_list.txt, testing_list.txt"
    splits: ClassVar[tuple[str, ...]] = tuple(SPLITS)

    def __init__(
        self, folder: Path, *, protocol: SceneProtocol = PAPER, scenes: int = 1000, seed: int = 0
    ) -> None:
        self.folder = folder
        self.protocol = protocol
        self.scenes = scenes
        self.seed = seed

    def items(self, split: str) -> Iterator[DatasetItem]:
        check_split(self, split)
        speech = _Speech(speech_commands(self.folder, SPLITS[split]))
        for index in range(self.scenes):
            seed = [self.seed, self.splits.index(split), index]
            scene = simulate_scene(self.protocol, speech, seed)
            said = [speech.audible(clip)[0] for clip in scene.metadata["clips"]]
            yield DatasetItem(
                scene.audio,
                scene.array,
                Directions.constant(scene.azimuth),
                {
                    **scene.metadata,
                    "dataset": self.name,
                    "split": split,
                    "sequence": f"scene_{index:05d}",
                    "path": [str(clip.path) for clip in said],
                    "licence": self.licence,
                    "speaker": [clip.speaker for clip in said],
                    "class": [clip.path.parent.name for clip in said],
                },
            )

    @classmethod
    def recognises(cls, folder: Path) -> bool:
        return any((folder / name).exists() for name in LISTS) or bool(_clips(folder))

    @classmethod
    def counts(cls, folder: Path) -> list[Count]:
        clips = _clips(folder)
        return [
            Count("clips", len(clips), FILES),
            Count("words", len({path.parent for path in clips}), WORDS),
        ]

    @classmethod
    def verify(cls, folder: Path) -> list[Fault]:
        faults = miscounts(folder, cls.counts(folder))
        for name in LISTS:
            faults += collect([partial(_check_list, folder / name)])
        return faults + collect(
            partial(check_audio, path, 1, SAMPLE_RATE) for path in _clips(folder)
        )


@dataclass(frozen=True, slots=True)
class _Speech(Sequence[FloatArray]):
    """Clips that are read when a scene needs them; the corpus takes gigabytes in memory."""

    clips: Sequence[Clip]

    def __len__(self) -> int:
        return len(self.clips)

    @overload
    def __getitem__(self, index: int) -> FloatArray: ...
    @overload
    def __getitem__(self, index: slice) -> list[FloatArray]: ...
    def __getitem__(self, index: int | slice) -> FloatArray | list[FloatArray]:
        if isinstance(index, slice):
            return load(self.clips[index])
        return self.audible(index)[1]

    def audible(self, index: int) -> tuple[Clip, FloatArray]:
        """The clip of this index and its audio, or the next clip if it is silent, as a few are."""
        for clip in chain(self.clips[index:], self.clips[:index]):
            if audio := load([clip]):
                return clip, audio[0]
        raise DatasetError("audio", self.clips[index].path, "is silent, as are all other clips")


def _clips(folder: Path) -> list[Path]:
    return sorted(
        path
        for path in folder.glob("*/*_nohash_*")
        if path.suffix in {".wav", ".flac"} and not path.parent.name.startswith("_")
    )


def _check_list(path: Path) -> None:
    """Raise DatasetError unless the list is there and so is every clip that it names."""
    require(path, "unpack the whole archive, the splits are made from it")
    for line in path.read_text().split():
        clip = path.parent / line
        if not clip.with_suffix(".flac").exists():
            require(clip, f"{path.name} names it: unpack the whole archive")

"""A corpus of synthetic voices, and a run and a bundle that were trained on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile
import torch

from model_export.__main__ import main
from model_export.simulation import singles as bank
from model_export.simulation.synthesis import synthetic_voice

# The networks here are small, and busy machines run other tests beside them.
torch.set_num_threads(1)

SPEAKERS = [f"{index:08x}" for index in range(40)]


@pytest.fixture(scope="session")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Synthetic voices in the layout of Speech Commands."""
    folder = tmp_path_factory.mktemp("speech_commands")
    rng = np.random.default_rng(1)
    (folder / "yes").mkdir()
    for speaker in SPEAKERS:
        soundfile.write(
            folder / "yes" / f"{speaker}_nohash_0.wav", synthetic_voice(rng, 1.0), 16000
        )
    listed = "".join(f"yes/{speaker}_nohash_0.wav\n" for speaker in SPEAKERS[:4])
    (folder / "validation_list.txt").write_text(listed)
    return folder


@pytest.fixture(scope="session")
def singles(corpus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bank of a dozen single talkers."""
    folder = tmp_path_factory.mktemp("singles")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bank, "CHUNK_TALKERS", 12)
        command = ["singles", "--chunks", "1", "--speech-commands", str(corpus)]
        assert main([*command, "--out", str(folder)]) == 0
    return folder


@pytest.fixture(scope="session")
def paper_run(corpus: Path, singles: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A few steps of both of the paper's stages by the command line, in ``sscl`` and ``paper``."""
    folder = tmp_path_factory.mktemp("runs")
    command = ["train", "--smoke", "--speech-commands", str(corpus), "--singles", str(singles)]
    first = [*command, "--config", "paper-sscl", "--run", str(folder / "sscl")]
    assert main(first) == 0
    second = [*command, "--config", "paper", "--run", str(folder / "paper")]
    assert main([*second, "--init", str(folder / "sscl")]) == 0
    return folder


@pytest.fixture(scope="session")
def paper_bundle(paper_run: Path, corpus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The supervised stage's run as a bundle named ``tiny``."""
    out = tmp_path_factory.mktemp("bundles") / "tiny"
    command = ["export", "--run", str(paper_run / "paper"), "--out", str(out), "--name", "tiny"]
    assert main([*command, "--speech-commands", str(corpus)]) == 0
    return out

"""A corpus of synthetic voices for everything that reads one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile
import torch

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

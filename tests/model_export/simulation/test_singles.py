"""The bank of single talkers: what it keeps, what it refuses, and scenes that are its sums."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from model_export.simulation import singles
from model_export.simulation.scene_config import SceneConfig
from model_export.simulation.singles import SinglesBank, write_singles
from model_export.simulation.synthesis import synthetic_voice
from service.doa.presets import preset
from service.doa.scoring import circular_error
from service.doa.types import FloatArray
from service.inference.classical import ClassicalLocalizer

ARRAY = "respeaker-usb-4mic-v2"
ALONE = SceneConfig(source_counts=(0.0, 1.0), snr_db=(30.0, 30.0))
TWO = replace(ALONE, source_counts=(0.0, 0.0, 1.0), min_separation=np.deg2rad(40.0))


@pytest.fixture(scope="module")
def voices() -> list[FloatArray]:
    rng = np.random.default_rng(0)
    return [synthetic_voice(rng, 1.0) for _ in range(3)]


@pytest.fixture(scope="module")
def folder(voices: Sequence[FloatArray], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two chunks of six talkers each."""
    folder = tmp_path_factory.mktemp("singles")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(singles, "CHUNK_TALKERS", 6)
        write_singles(folder, ARRAY, voices, 2, 5)
    return folder


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(singles, "CHUNK_TALKERS", 6)


def test_an_interrupted_bank_is_completed_with_the_same_talkers(
    folder: Path, voices: Sequence[FloatArray], tmp_path: Path
) -> None:
    write_singles(tmp_path, ARRAY, voices, 1, 5)
    kept = (tmp_path / "audio-00000.npy").stat().st_mtime_ns
    write_singles(tmp_path, ARRAY, voices, 2, 5)
    assert (tmp_path / "audio-00000.npy").stat().st_mtime_ns == kept
    for name in ("audio-00000.npy", "azimuth-00000.npy", "audio-00001.npy", "azimuth-00001.npy"):
        np.testing.assert_array_equal(np.load(tmp_path / name), np.load(folder / name))
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "audio-00000.npy", "audio-00001.npy", "azimuth-00000.npy", "azimuth-00001.npy",
        "singles.json",
    ]  # fmt: skip


def test_a_bank_of_something_else_is_refused(
    folder: Path, voices: Sequence[FloatArray], tmp_path: Path
) -> None:
    for array, speech, seed in (
        ("respeaker-4mic-hat", voices, 5),
        (ARRAY, voices[:2], 5),
        (ARRAY, voices, 6),
    ):
        with pytest.raises(ValueError, match="name another folder"):
            write_singles(folder, array, speech, 2, seed)
    with pytest.raises(ValueError, match="another protocol"):
        SinglesBank(folder, "respeaker-4mic-hat")
    with pytest.raises(FileNotFoundError, match="model_export singles"):
        SinglesBank(tmp_path, ARRAY)


@pytest.mark.parametrize("symmetric", [False, True])
def test_a_talker_alone_is_heard_from_where_the_label_says(folder: Path, symmetric: bool) -> None:
    bank = SinglesBank(folder, ARRAY)
    localizer = ClassicalLocalizer("srp_phat", preset(ARRAY))
    rng = np.random.default_rng(1)
    drawn = [bank.draw(rng, replace(ALONE, symmetric=symmetric)) for _ in range(20)]
    estimates = localizer.estimate(np.stack([scene.audio for scene in drawn]), 1, 1)
    errors = [
        circular_error(np.array(estimate.sources[0].azimuth), scene.azimuth[0])
        for estimate, scene in zip(estimates, drawn, strict=True)
    ]
    assert np.rad2deg(np.median(errors)) < 4
    assert len({round(float(scene.azimuth[0]), 4) for scene in drawn}) > (12 if symmetric else 8)


def test_two_talkers_are_the_sum_of_two_far_enough_apart(folder: Path) -> None:
    bank = SinglesBank(folder, ARRAY)
    clean = replace(TWO, snr_db=(200.0, 200.0))
    audio = np.concatenate([np.load(folder / f"audio-{chunk:05d}.npy") for chunk in range(2)])
    azimuth = np.concatenate([np.load(folder / f"azimuth-{chunk:05d}.npy") for chunk in range(2)])
    rng = np.random.default_rng(2)
    for _ in range(10):
        scene = bank.draw(rng, clean)
        first, second = (int(np.argmin(np.abs(azimuth - each))) for each in scene.azimuth)
        np.testing.assert_allclose(
            scene.audio, audio[first].astype(np.float32) + audio[second], atol=1e-4
        )
        assert circular_error(scene.azimuth[:1], scene.azimuth[1:])[0] >= TWO.min_separation
    with pytest.raises(ValueError, match="far enough apart"):
        bank.draw(rng, replace(TWO, min_separation=4.0))


def test_the_noise_has_the_ratio_to_all_talkers_and_is_louder_in_noisy_scenes(
    folder: Path,
) -> None:
    bank = SinglesBank(folder, ARRAY)

    def noise_power(config: SceneConfig) -> float:
        """Power of the difference between a scene and the same scene without noise."""
        loud = bank.draw(np.random.default_rng(3), config)
        clean = replace(config, snr_db=(200.0, 200.0), noisy_snr_db=(200.0, 200.0))
        return float(
            np.mean(np.square(loud.audio - bank.draw(np.random.default_rng(3), clean).audio))
        )

    assert noise_power(ALONE) == pytest.approx(1e-3, rel=0.05)
    assert noise_power(TWO) == pytest.approx(2e-3, rel=0.05)
    noisy = replace(ALONE, noisy=1.0, noisy_snr_db=(10.0, 10.0))
    assert noise_power(noisy) == pytest.approx(0.1, rel=0.05)

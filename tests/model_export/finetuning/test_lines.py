"""Linear arrays in training: they stay lines, and their targets are directions they can hear."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import soundfile
import torch

from model_export.finetuning.array_calibration import ArrayCalibration
from model_export.finetuning.labelled_recordings import load_recordings
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

pytestmark = pytest.mark.torch

LINE = MicrophoneArray("line", np.array([[0.0, 0.04 * n, 0.0] for n in range(4)]))
PANEL = MicrophoneArray("panel", np.array([[0, y, z] for y in (0, 0.05) for z in (0, 0.05)]))


def calibrated(array: MicrophoneArray) -> MicrophoneArray:
    """Calibration with every microphone 3 mm off in all directions."""
    calibration = ArrayCalibration(array)
    offsets = torch.from_numpy(np.random.default_rng(1).normal(0, 0.003, array.positions.shape))
    with torch.no_grad():
        calibration.offsets += offsets
    moved = calibration.array()
    # The trained positions are those that are written.
    azimuth = torch.linspace(0, 6, 20)
    unit = np.stack([azimuth.cos(), azimuth.sin(), 0 * azimuth])
    centred = moved.positions - moved.positions.mean(axis=0)
    trained = calibration.delays(azimuth).detach().numpy()
    np.testing.assert_allclose(trained, centred @ unit / 343.0, atol=1e-8)
    return moved


def test_calibrated_lines_and_panels_stay_in_line() -> None:
    for array in (LINE, PANEL):
        moved = calibrated(array)
        assert moved.linear
        assert np.ptp(moved.positions - array.positions, axis=0)[1] > 0.001


def test_heights_stay_and_other_arrays_move_in_the_plane(square: MicrophoneArray) -> None:
    moved = calibrated(square).positions - square.positions
    assert (np.ptp(moved, axis=0)[:2] > 0.001).all()
    assert np.abs(moved[:, 2]).max() < 1e-9


def test_talkers_behind_a_line_are_labelled_before_it(
    tmp_path: Path, plane_waves: Callable[..., FloatArray]
) -> None:
    rows = ["file,azimuth_deg"]
    for azimuth in (20.0, 160.0, 300.0):
        name = f"{azimuth:.0f}.wav"
        soundfile.write(tmp_path / name, plane_waves(LINE, [azimuth], seconds=2.0).T, 16000)
        rows.append(f"{name},{azimuth}")
    (tmp_path / "labels.csv").write_text("\n".join(rows) + "\n")
    loaded = load_recordings(tmp_path, LINE)
    found = sorted(float(np.rad2deg(r.windows[0].azimuth[0])) for r in loaded)
    np.testing.assert_allclose(found, [20.0, 20.0, 300.0], atol=1e-6)

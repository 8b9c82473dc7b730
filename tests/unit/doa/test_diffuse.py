"""The array's size in fields that are diffuse by construction."""

from __future__ import annotations

import numpy as np
import pytest

from service.doa.array import MicrophoneArray
from service.doa.diagnostics.diffuse import diffuse_fit, size_findings
from service.doa.presets import preset
from service.doa.types import FloatArray

RATE = 16_000
SQUARE = preset("respeaker-usb-4mic-v2")


def dying_away(positions: FloatArray, seed: int = 0) -> list[FloatArray]:
    """Segments (N, T) of noise that begins anew and dies away, coming from everywhere."""
    random = np.random.default_rng(seed)
    length = RATE // 2
    frequency = np.fft.rfftfreq(length, 1 / RATE)
    envelope = 10 ** (-3 * np.arange(length) / RATE / 0.3)  # 60 dB in 0.3 s
    segments = []
    for _ in range(20):
        towards = random.standard_normal((24, 3))
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        waves = np.fft.rfft(random.standard_normal((len(towards), length)))
        advance = np.exp(2j * np.pi * frequency * (positions @ towards.T)[..., None] / 343.0)
        field = np.fft.irfft((advance * waves).sum(axis=1), length)
        noise = 0.003 * field.std() * random.standard_normal(field.shape)
        segments.append((0.05 * (field * envelope + noise) / field.std()).astype(np.float32))
    return segments


@pytest.mark.parametrize("name", ["respeaker-usb-4mic-v2", "respeaker-6mic-circular"])
@pytest.mark.parametrize("scale", [0.5, 0.7, 1.0, 1.4])
def test_the_size_is_that_of_the_array_that_heard_the_field(name: str, scale: float) -> None:
    array = preset(name)
    found = diffuse_fit(dying_away(array.positions * scale), RATE, array.positions)
    # Cells of unit power make it a little larger: their coherence is flatter than that of power.
    assert found is not None
    assert scale - 0.02 <= found.scale <= scale + 0.11


def test_an_array_that_is_too_large_is_found_and_the_right_one_is_not() -> None:
    segments = dying_away(SQUARE.positions)
    assert size_findings(segments, RATE, SQUARE) == []
    said = MicrophoneArray("said", SQUARE.positions * 64 / 45.7)
    (found,) = size_findings(segments, RATE, said)
    assert found.code == "array_scale"
    assert "about 0.7 times" in found.detail


def test_of_an_upright_panel_nothing_is_said() -> None:
    """Reflections come from the walls: its heights look smaller than they are."""
    upright = SQUARE.positions[:, [2, 0, 1]]
    squeezed = upright * [1, 1, 0.5]
    segments = dying_away(squeezed)
    assert size_findings(segments, RATE, MicrophoneArray("panel", upright)) == []
    level = MicrophoneArray("level", upright[:, [1, 2, 0]])
    assert size_findings(dying_away(squeezed[:, [1, 2, 0]]), RATE, level) != []


def test_nothing_is_said_without_sound_that_dies_away() -> None:
    random = np.random.default_rng(2)
    steady = [(0.05 * random.standard_normal((4, 8000))).astype(np.float32) for _ in range(20)]
    assert diffuse_fit(steady, RATE, SQUARE.positions) is None
    assert diffuse_fit([], RATE, SQUARE.positions) is None


@pytest.mark.parametrize("level_db", [-20.0, -10.0, 0.0])
def test_a_noise_that_is_equal_in_all_channels_is_no_smaller_array(level_db: float) -> None:
    random = np.random.default_rng(3)
    segments = [
        (s + 0.02 * 10 ** (level_db / 20) * random.standard_normal(s.shape[-1])).astype(np.float32)
        for s in dying_away(SQUARE.positions)
    ]
    assert size_findings(segments, RATE, SQUARE) == []

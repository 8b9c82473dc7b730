"""What a recording takes while it is localized: its windows' few numbers, never their spectra."""

from __future__ import annotations

import io
import tracemalloc

import numpy as np
import pytest
import soundfile

from service.audio.recording import Recording
from service.doa.array import MicrophoneArray
from service.doa.diagnostics import Finding
from service.doa.presets import preset
from service.doa.types import FloatArray
from service.inference.registry import BundleRegistry
from service.inference.results import Source, WindowEstimate, nothing_heard
from service.recordings import localize as recording_module
from service.recordings.answer_json import localization_json
from service.recordings.localize import localize_recording
from service.recordings.results import LocalizeOptions

pytestmark = pytest.mark.costs

RATE = 16000
ARRAY = preset("respeaker-usb-4mic-v2")
LENGTHS = (300, 1500)
"""Lengths in windows"""
HOP_S = 0.064
ALLOWED = 400
"""Most bytes a window: two packed sources take a hundred"""
SPECTRUM = 4 * 180
"""Bytes of one spectrum"""


class TwoTalkers:
    """A localizer that takes no time: two sources in every window, and a spectrum."""

    nothing = nothing_heard(180, sphere=False)

    def estimate(
        self, windows: FloatArray, num_sources: int | None, max_sources: int
    ) -> list[WindowEstimate]:
        sources = (Source(0.5, 0.9), Source(2.5, 0.8))
        return [WindowEstimate(sources, np.ones(180, np.float32)) for _ in windows]


class Silent:
    """Diagnostics without a finding."""

    def add(self, block: FloatArray) -> None: ...

    def findings(self, array: MicrophoneArray) -> list[Finding]:
        return []


def peak(windows: int, *, spectra: bool) -> int:
    """The most memory that Python's objects and numpy's arrays ever took, in bytes."""
    file = io.BytesIO()
    samples = round(windows * HOP_S * RATE)
    noise = np.random.default_rng(0).normal(0, 0.1, (samples, ARRAY.num_microphones))
    soundfile.write(file, noise, RATE, format="WAV", subtype="PCM_16")
    file.seek(0)
    options = LocalizeOptions(
        array=ARRAY, method="norm_music", window_s=0.128, hop_s=HOP_S, spectrum=spectra
    )
    del noise
    with Recording.open(file) as recording:
        tracemalloc.start()
        try:
            result = localize_recording(recording, options, BundleRegistry([]))
            answer = localization_json(result)
            most = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
    assert answer.count(b'"t_start"') == len(result.windows) == pytest.approx(windows, abs=2)
    return most


@pytest.fixture(autouse=True)
def nothing_large(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the localizer nor the diagnostics, whose twelve seconds would hide the windows."""
    monkeypatch.setattr(recording_module, "ClassicalLocalizer", lambda *_args: TwoTalkers())
    monkeypatch.setattr(recording_module, "ChannelDiagnostics", lambda *_args: Silent())


def growth(*, spectra: bool) -> float:
    peak(10, spectra=spectra)  # imports
    few, many = (peak(windows, spectra=spectra) for windows in LENGTHS)
    return (many - few) / (LENGTHS[1] - LENGTHS[0])


def test_a_window_takes_its_few_numbers_and_a_spectrum_only_on_request() -> None:
    assert growth(spectra=False) < ALLOWED < SPECTRUM < growth(spectra=True)


@pytest.mark.parametrize(
    ("microphones", "window_s", "most"),
    [(4, 1.024, 12), (16, 1.024, 12), (32, 1.024, 6), (4, 10.0, 4), (32, 10.0, 1)],
)
def test_large_windows_go_few_at_a_time(microphones: int, window_s: float, most: int) -> None:
    """Twelve of ten seconds and 32 microphones would take more than two gigabytes."""
    angles = np.arange(microphones) * (2 * np.pi / microphones)
    ring = 0.1 * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    file = io.BytesIO()
    silence = np.zeros((round((window_s + 12 * 0.5) * RATE), microphones), np.int16)
    soundfile.write(file, silence, RATE, format="WAV", subtype="PCM_16")
    file.seek(0)
    options = LocalizeOptions(
        array=MicrophoneArray("ring", ring), method="norm_music", window_s=window_s, hop_s=0.5
    )
    with Recording.open(file) as recording:
        result = localize_recording(recording, options, BundleRegistry([]))
    assert max(result.stretches) == most

"""Faults that come and go in a stream are reported once, when they come."""

from __future__ import annotations

import threading
import tracemalloc
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from neuralmusic.errors import ChannelMismatch
from service.doa.diagnostics import Finding, RunningDiagnostics
from service.doa.presets import preset
from service.doa.types import FloatArray

RATE = 16_000
SQUARE = preset("respeaker-usb-4mic-v2")


LONGEST_S = 90.0


def speech(seconds: float) -> FloatArray:
    """The first seconds of ``ninety_seconds``, which the test may change."""
    assert seconds <= LONGEST_S
    return ninety_seconds()[:, : round(seconds * RATE)].copy()


@cache
def ninety_seconds() -> FloatArray:
    """(4, T) bursts of noise from a new direction each, delayed exactly, and sensor noise."""
    random = np.random.default_rng(1)
    length = round(0.4 * RATE)
    envelope = np.sin(np.pi * np.arange(length) / length) ** 2 * (np.arange(length) > 800)
    frequency = np.fft.rfftfreq(2 * length, 1 / RATE)
    bursts = []
    for _ in range(round(LONGEST_S / 0.4)):
        azimuth = random.uniform(0, 2 * np.pi)
        towards = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        sound = np.fft.rfft(envelope * random.standard_normal(length), 2 * length)
        advance = np.exp(2j * np.pi * frequency * (SQUARE.positions @ towards)[:, None] / 343.0)
        bursts.append(np.fft.irfft(sound * advance)[:, :length])
    clean = np.concatenate(bursts, axis=-1)
    audio = clean + 0.05 * clean.std() * random.standard_normal(clean.shape)
    return (0.05 * audio / audio.std()).astype(np.float32)


def run(
    diagnostics: RunningDiagnostics, audio: FloatArray, step: int = 1600
) -> list[tuple[float, Finding]]:
    """What is reported, each with the seconds of ``audio`` heard by then."""
    found = []
    for start in range(0, audio.shape[-1], step):
        diagnostics.add(audio[:, start : start + step])
        if diagnostics.due():
            heard = min(start + step, audio.shape[-1]) / RATE
            found += [(heard, finding) for finding in diagnostics.check()]
    return found


def running(channel_map: tuple[int, ...] = (0, 1, 2, 3)) -> RunningDiagnostics:
    return RunningDiagnostics(RATE, channel_map, SQUARE)


def codes(found: list[tuple[float, Finding]]) -> list[str]:
    return [finding.code for _, finding in found]


def test_a_good_stream_has_no_findings() -> None:
    assert run(running(), speech(90.0)) == []


def test_a_stream_is_due_after_two_seconds_and_then_every_five() -> None:
    diagnostics = running()
    audio = 1e-4 * np.ones((4, RATE), dtype=np.float32)  # too little for the checks of the sound
    due = []
    for second in range(1, 20):
        diagnostics.add(audio)
        if diagnostics.due():
            diagnostics.check()
            due.append(second)
    assert due == [2, 7, 12, 17]
    assert not diagnostics.due()


def test_a_channel_that_dies_after_a_minute_is_reported_within_seconds() -> None:
    audio = speech(80.0)
    audio[2, 60 * RATE :] = 0
    ((heard, found),) = run(running((1, 2, 3, 4)), audio)
    assert (found.code, found.channels) == ("channel_dead", (3,))
    assert 60 < heard <= 70


def test_a_fault_that_lasts_is_repeated_after_a_minute() -> None:
    audio = speech(70.0)
    audio[2] = 0
    found = run(running(), np.tile(audio, 2))
    assert set(codes(found)) == {"channel_dead"}
    times = [heard for heard, _ in found]
    assert times[0] == 2
    assert [b - a for a, b in pairwise(times)] == pytest.approx([60, 60], abs=1)


def test_a_channel_that_came_back_and_dies_again_is_reported_again() -> None:
    audio = speech(45.0)
    audio[2, : 10 * RATE] = 0
    audio[2, 25 * RATE :] = 0
    found = run(running(), audio)
    assert codes(found) == ["channel_dead", "channel_dead"]
    assert 25 < found[1][0] <= 35


def test_clipping_on_and_off_is_not_repeated() -> None:
    audio = speech(50.0)
    for start in range(0, 50, 10):
        part = audio[1, start * RATE : (start + 5) * RATE]
        audio[1, start * RATE : (start + 5) * RATE] = np.clip(20 * part, -1, 1)
    found = run(running(), audio)
    assert codes(found).count("clipping") == 1
    assert found[0][1].channels == (1,)


def test_a_fault_that_spreads_is_news() -> None:
    audio = speech(30.0)
    audio[1] = 0
    audio[2, 15 * RATE :] = 0
    found = run(running(), audio)
    assert [finding.channels for _, finding in found] == [(1,), (1, 2)]


def test_samples_that_are_no_numbers_are_reported_and_harm_nothing_else() -> None:
    audio = speech(30.0)
    audio[0, 5 * RATE] = np.nan
    audio[3, 5 * RATE + 1] = np.inf
    (found,) = run(running(), audio)
    assert (found[1].code, found[1].channels) == ("non_finite", (0, 3))


def test_copies_and_silence_are_reported() -> None:
    audio = speech(12.0)
    audio[3] = audio[0]
    ((heard, found),) = run(running(), audio)
    assert (found.code, found.channels, heard) == ("channels_identical", (0, 3), 2.0)
    ((heard, found),) = run(running(), np.zeros((4, 20 * RATE), dtype=np.float32))
    assert found.code == "quiet"
    assert heard >= 10


def test_swapped_channels_are_reported_after_ten_seconds_of_sound() -> None:
    silence = np.zeros((4, 20 * RATE), dtype=np.float32)
    noise = 1e-4 * np.random.default_rng(0).standard_normal(silence.shape)
    audio = np.concatenate([noise.astype(np.float32), speech(25.0)[[0, 2, 1, 3]]], axis=1)
    found = [(heard, f) for heard, f in run(running(), audio) if f.code != "quiet"]
    assert codes(found) == ["channel_order"]
    assert 29 <= found[0][0] <= 34


@pytest.mark.parametrize("step", [1, 160, 20_000])
def test_the_size_of_the_blocks_does_not_matter(step: int) -> None:
    audio = speech(3.0 if step == 1 else 12.0)
    audio[1] = 0
    ((_, found),) = run(running(), audio, step)
    assert (found.code, found.channels) == ("channel_dead", (1,))


def test_memory_does_not_grow_with_the_stream() -> None:
    diagnostics = running()
    audio = speech(10.0)
    run(diagnostics, np.tile(audio, 3))
    tracemalloc.start()
    try:
        run(diagnostics, np.tile(audio, 3), step=16_000)
        first = tracemalloc.get_traced_memory()[0]
        for _ in range(10):
            for start in range(0, audio.shape[1], 16_000):
                diagnostics.add(audio[:, start : start + 16_000])
        grown = tracemalloc.get_traced_memory()[0] - first
    finally:
        tracemalloc.stop()
    assert grown < 2**21  # 100 s of this audio are 26 MB


def test_audio_may_come_while_another_thread_checks() -> None:
    diagnostics = running()
    audio = speech(30.0)
    audio[2] = 0
    done = threading.Event()
    found: list[Finding] = []

    def check() -> None:
        while not done.is_set():
            if diagnostics.due():
                found.extend(diagnostics.check())

    checker = threading.Thread(target=check)
    checker.start()
    for start in range(0, audio.shape[-1], 1600):
        diagnostics.add(audio[:, start : start + 1600])
    done.set()
    checker.join()
    found.extend(diagnostics.check())
    assert [(finding.code, finding.channels) for finding in found] == [("channel_dead", (2,))]


def test_an_array_of_another_size_is_refused() -> None:
    with pytest.raises(ChannelMismatch, match="3 channels cannot be compared with the 4"):
        RunningDiagnostics(RATE, (0, 1, 2), SQUARE)

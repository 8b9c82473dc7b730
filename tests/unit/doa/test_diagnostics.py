"""Known mistakes made to exactly delayed plane waves are found, and good recordings pass."""

from __future__ import annotations

import json
import re
from functools import cache

import numpy as np
import pytest

from neuralmusic.errors import ChannelMismatch
from service.doa.array import MicrophoneArray
from service.doa.diagnostics import ChannelDiagnostics, Finding
from service.doa.diagnostics.excerpt import SLOTS, Excerpt
from service.doa.diagnostics.orders import distinct_orders, equivalent_orders
from service.doa.presets import preset
from service.doa.types import FloatArray

RATE = 16_000
SQUARE = preset("respeaker-usb-4mic-v2")
RING8 = preset("matrix-creator")
CENTRE7 = preset("minidsp-uma8")
ARRAYS = [
    "respeaker-usb-4mic-v2",
    "respeaker-4mic-hat",
    "respeaker-6mic-circular",
    "minidsp-uma8",
    "matrix-creator",
    "av163-circle8",
]


def recording(
    array: MicrophoneArray, *, seconds: float = 4.0, snr_db: float = 25.0, seed: int = 1
) -> FloatArray:
    """What an array hears of ``bursts``, which the test may change."""
    return bursts(tuple(map(tuple, array.positions)), seconds, snr_db, seed).copy()


@cache
def bursts(
    positions: tuple[tuple[float, ...], ...], seconds: float, snr_db: float, seed: int
) -> FloatArray:
    """(N, T) bursts of noise from a new direction each, delayed exactly, and sensor noise."""
    random = np.random.default_rng(seed)
    length = round(0.4 * RATE)
    envelope = np.sin(np.pi * np.arange(length) / length) ** 2 * (np.arange(length) > 800)
    frequency = np.fft.rfftfreq(2 * length, 1 / RATE)
    heard = []
    for _ in range(round(seconds / 0.4)):
        azimuth, elevation = random.uniform(0, 2 * np.pi), random.uniform(0, 0.5)
        towards = np.array(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ]
        )
        sound = np.fft.rfft(envelope * random.standard_normal(length), 2 * length)
        advance = np.exp(2j * np.pi * frequency * (positions @ towards)[:, None] / 343.0)
        heard.append(np.fft.irfft(sound * advance)[:, :length])
    clean = np.concatenate(heard, axis=-1)
    noise = clean.std() * 10 ** (-snr_db / 20) * random.standard_normal(clean.shape)
    audio = clean + noise
    return (0.05 * audio / audio.std()).astype(np.float32)


def findings(
    audio: FloatArray,
    array: MicrophoneArray | None = None,
    *,
    rate: int = RATE,
    channel_map: tuple[int, ...] | None = None,
) -> list[Finding]:
    diagnostics = ChannelDiagnostics(rate, len(audio), channel_map)
    for start in range(0, audio.shape[-1], 5000):
        diagnostics.add(audio[:, start : start + 5000])
    return diagnostics.findings(array)


def codes(found: list[Finding]) -> list[str]:
    return [finding.code for finding in found]


def delayed(audio: FloatArray, channel: int, samples: int) -> FloatArray:
    late = audio.copy()
    late[channel] = np.roll(audio[channel], samples)
    return late


@pytest.mark.parametrize("name", ARRAYS)
@pytest.mark.parametrize("snr_db", [5.0, 30.0])
def test_a_good_recording_has_no_findings(name: str, snr_db: float) -> None:
    array = preset(name)
    assert findings(recording(array, snr_db=snr_db), array) == []


def test_geometry_is_judged_on_a_good_recording_and_not_on_mere_noise() -> None:
    noise = 0.05 * np.random.default_rng(0).standard_normal((4, 4 * RATE)).astype(np.float32)
    for audio, unchecked in (
        (recording(SQUARE), None),
        (noise, "there is too little direct sound"),
    ):
        diagnostics = ChannelDiagnostics(RATE, 4)
        diagnostics.add(audio)
        report = diagnostics.report(SQUARE)
        assert report.findings == ()
        assert report.unchecked == unchecked


@pytest.mark.parametrize("name", ARRAYS)
def test_following_the_advice_on_swapped_channels_puts_them_right(name: str) -> None:
    array = preset(name)
    audio = recording(array)
    swapped = audio[[0, 2, 1, *range(3, len(audio))]]
    (found,) = findings(swapped, array)
    assert found.code == "channel_order"
    advised = json.loads(re.findall(r"\[[\d, ]+\]", found.detail)[0])
    assert findings(swapped[advised], array) == []


def test_channels_are_named_as_in_the_recording() -> None:
    swapped = recording(RING8)[[0, 1, 2, 4, 3, 5, 6, 7]]
    (found,) = findings(swapped, RING8, channel_map=(10, 11, 12, 13, 14, 15, 16, 17))
    assert found.channels == (14, 13)
    assert "[10, 11, 12, 14, 13, 15, 16, 17]" in found.detail


def test_two_swaps_at_once_are_found_one_after_the_other() -> None:
    order = [1, 0, 2, 3, 5, 4, 6]
    (found,) = findings(recording(CENTRE7)[order], CENTRE7)
    assert found.code == "channel_order"
    assert str(order) in found.detail


def test_a_turned_square_cannot_be_told_from_a_right_one() -> None:
    assert findings(recording(SQUARE)[[1, 2, 3, 0]], SQUARE) == []


@pytest.mark.parametrize(("channel", "samples"), [(0, 1), (5, 1), (3, -1), (6, 2)])
def test_a_channel_late_by_a_sample_or_two_is_named(channel: int, samples: int) -> None:
    (found,) = findings(delayed(recording(RING8), channel, samples), RING8)
    assert (found.code, found.channels) == ("channel_late", (channel,))
    assert f"channel {channel} is {abs(samples)} sample" in found.detail
    assert ("late" if samples > 0 else "early") in found.detail


def test_a_late_channel_of_a_square_is_among_those_named() -> None:
    (found,) = findings(delayed(recording(SQUARE), 2, 1), SQUARE)
    assert found.code == "channel_late"
    assert 2 in found.channels


@pytest.mark.parametrize("array", [SQUARE, None])
def test_a_channel_late_by_milliseconds_is_found_without_an_array_too(
    array: MicrophoneArray | None,
) -> None:
    (found,) = findings(delayed(recording(SQUARE), 1, 200), array)
    assert (found.code, found.channels) == ("channel_late", (1,))
    lag_ms = float(re.findall(r"([\d.]+) ms late", found.detail)[0])
    assert lag_ms == pytest.approx(200 / RATE * 1000, abs=0.2)  # a direction adds up to 0.19 ms


@pytest.mark.parametrize(
    ("scale", "code"),
    [(3.0, "sample_rate_wrong"), (44.1 / 16, "sample_rate_wrong"), (2.0, "array_scale")],
)
def test_delays_too_large_for_the_array_are_a_wrong_rate_or_scale(scale: float, code: str) -> None:
    larger = MicrophoneArray("larger", scale * SQUARE.positions)
    (found,) = findings(recording(larger), SQUARE)
    assert found.code == code
    assert f"about {round(scale)} times as large" in found.detail


def suppressed(beam: FloatArray) -> FloatArray:
    """A channel (T,) whose pauses are turned down by 20 dB, as noise suppression does."""
    envelope = np.convolve(np.abs(beam), np.ones(800) / 800, mode="same")
    return np.where(envelope > 0.25 * envelope.max(), beam, 0.1 * beam).astype(np.float32)


@pytest.mark.parametrize("latency", [0, 256])
def test_a_processed_channel_among_the_microphones_is_named(latency: int) -> None:
    audio = recording(SQUARE, seconds=10.0)
    processed = np.roll(suppressed(audio.mean(axis=0)), latency)
    device = np.stack([processed, *audio[:3]])
    (found,) = findings(device, SQUARE, channel_map=(0, 1, 2, 3))
    assert (found.code, found.channels) == ("channel_processed", (0,))
    assert "name the raw ones with channel_map" in found.detail


def test_a_beam_among_the_microphones_is_named() -> None:
    audio = recording(SQUARE, seconds=10.0, snr_db=15.0)
    device = np.stack([*audio[1:], audio.mean(axis=0)])
    (found,) = findings(device, SQUARE, channel_map=(2, 3, 4, 0))
    assert (found.code, found.channels) == ("channel_processed", (0,))


def test_a_playback_channel_among_the_microphones_is_named() -> None:
    audio = recording(SQUARE, seconds=10.0)
    other = recording(SQUARE, seconds=10.0, seed=9)[0]
    device = np.stack([*audio[1:], np.roll(other, 3000)])
    (found,) = findings(device, SQUARE, channel_map=(2, 3, 4, 5))
    assert (found.code, found.channels) == ("channel_processed", (5,))


def test_unlike_microphones_are_microphones_all_the_same() -> None:
    audio = recording(SQUARE, seconds=10.0)
    noise = np.random.default_rng(3).standard_normal(audio.shape).astype(np.float32)
    noisy = audio.copy()
    noisy[1] += 0.01 * noise[1]  # 14 dB more noise than the others
    hot = audio * np.float32([[1.0], [1.0], [1.4], [1.0]]) + 0.003 * noise
    covered = audio.copy()
    covered[2, 1:] = 0.5 * (audio[2, 1:] + audio[2, :-1])
    for unlike in (noisy, hot, covered):
        assert "channel_processed" not in codes(findings(unlike, SQUARE))


@pytest.mark.parametrize("gain", [0.0, 1e-3])
def test_a_silent_or_far_too_quiet_channel_is_dead(gain: float) -> None:
    audio = recording(SQUARE)
    audio[3] *= np.float32(gain)
    (found,) = findings(audio, SQUARE)
    assert (found.code, found.channels) == ("channel_dead", (3,))


def test_gains_of_real_microphones_are_no_dead_channel() -> None:
    gains = 10 ** (np.array([[-6.0], [0.0], [3.0], [6.0]]) / 20)
    assert findings((gains * recording(SQUARE)).astype(np.float32), SQUARE) == []


@pytest.mark.parametrize("gain", [1.0, 0.5])
def test_copied_channels_are_found_up_to_a_gain(gain: float) -> None:
    audio = np.round(recording(SQUARE) * 32768) / 32768
    audio[2] = np.round(gain * audio[0] * 32768) / 32768
    (found,) = findings(audio.astype(np.float32))
    assert (found.code, found.channels) == ("channels_identical", (0, 2))


def test_clipping_is_found_but_not_a_single_peak() -> None:
    audio = recording(SQUARE)
    audio[1, 100] = 1.0
    assert findings(audio, SQUARE) == []
    found = findings(np.clip(8 * audio, -1, 1), SQUARE)
    assert codes(found) == ["clipping"]
    assert found[0].channels == (0, 1, 2, 3)


def test_an_offset_is_found_and_does_not_hide_a_dead_channel() -> None:
    audio = recording(SQUARE)
    audio[0] = 0.1
    assert codes(findings(audio, SQUARE)) == ["channel_dead", "dc_offset"]


@pytest.mark.parametrize("level", [0.0, 1e-3])
def test_silence_and_whispers_are_quiet_and_nothing_else(level: float) -> None:
    assert codes(findings(np.float32(level) * recording(SQUARE), SQUARE)) == ["quiet"]


def test_audio_sent_at_8_khz_is_band_limited() -> None:
    audio = recording(SQUARE)
    spectrum = np.fft.rfft(audio)
    spectrum[:, spectrum.shape[1] // 2 :] = 0
    (found,) = findings(np.fft.irfft(spectrum).astype(np.float32), SQUARE)
    assert found.code == "band_limited"
    edge = float(re.findall(r"above ([\d.]+) kHz", found.detail)[0])
    assert edge == pytest.approx(4.0, abs=0.2)


def test_samples_that_are_no_numbers_are_counted_and_harm_nothing_else() -> None:
    audio = recording(SQUARE)
    audio[2, 1000:1003] = [np.nan, np.inf, -np.inf]
    (found,) = findings(audio, SQUARE)
    assert (found.code, found.channels) == ("non_finite", (2,))
    assert found.detail.startswith("3 samples")


def test_levels_are_those_of_a_known_sine() -> None:
    time = np.arange(RATE) / RATE
    sine = 0.5 * np.sin(2 * np.pi * 1000 * time + np.array([[0.0], [np.pi / 2]]))
    diagnostics = ChannelDiagnostics(RATE, 2)
    diagnostics.add((sine + np.array([[0.25], [0.0]])).astype(np.float32))
    levels = diagnostics.levels()
    np.testing.assert_allclose(levels.rms, 20 * np.log10(0.5 / np.sqrt(2)), atol=1e-3)
    np.testing.assert_allclose(levels.peak, 20 * np.log10([0.75, 0.5]), atol=0.02)
    np.testing.assert_allclose(levels.offset, [0.25, 0.0], atol=1e-6)


def test_the_size_of_the_blocks_does_not_matter() -> None:
    audio = recording(SQUARE)[[0, 2, 1, 3]]
    whole = ChannelDiagnostics(RATE, 4)
    whole.add(audio)
    assert whole.findings(SQUARE) == findings(audio, SQUARE)


@pytest.mark.parametrize("samples", [0, 1, 300, 4000])
def test_the_shortest_recordings_are_taken(samples: int) -> None:
    audio = recording(SQUARE)[:, 2000 : 2000 + samples]
    assert set(codes(findings(audio, SQUARE))) <= {"quiet", "dc_offset"}


def test_two_microphones_are_not_judged_by_geometry() -> None:
    pair = MicrophoneArray("pair", SQUARE.positions[:2])
    diagnostics = ChannelDiagnostics(RATE, 2)
    diagnostics.add(recording(pair)[::-1])
    report = diagnostics.report(pair)
    assert report.findings == ()
    assert report.unchecked is not None
    assert "4 microphones" in report.unchecked


def test_an_array_of_another_size_is_refused() -> None:
    with pytest.raises(ChannelMismatch, match="4 channels cannot be compared with the 8"):
        ChannelDiagnostics(RATE, 4).findings(RING8)


def test_the_excerpt_of_a_long_recording_is_bounded_and_has_its_loud_parts() -> None:
    excerpt = Excerpt(100, 2)
    quiet = 0.01 * np.random.default_rng(0).standard_normal((2, 100_000)).astype(np.float32)
    quiet[:, 70_000:70_050] *= 50
    for block in np.array_split(quiet, 333, axis=-1):
        excerpt.add(block)
    segments = excerpt.segments()
    assert SLOTS / 2 <= len(segments) <= SLOTS
    assert max(segment.std() for segment in segments) == pytest.approx(0.5, rel=0.3)
    assert excerpt.loudest() == pytest.approx(0.25, rel=0.5)


def test_a_square_has_three_orders_that_can_be_told_apart() -> None:
    assert len(distinct_orders(SQUARE.positions)) == 2
    assert equivalent_orders(SQUARE.positions, (1, 0, 2, 3)) == [(1, 0, 2, 3), (0, 1, 3, 2)]


def test_rotations_of_a_ring_are_no_distinct_orders() -> None:
    ring = preset("respeaker-6mic-circular").positions
    assert all(sum(a != b for a, b in enumerate(order)) == 2 for order in distinct_orders(ring))

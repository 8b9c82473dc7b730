"""Good recordings that plane waves in free air do not explain raise nothing; polarity is named."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.special import eval_legendre, spherical_jn, spherical_yn

from service.doa.array import MicrophoneArray
from service.doa.diagnostics import ChannelDiagnostics, RunningDiagnostics
from service.doa.diagnostics.waves import sphere_response, sphere_through
from service.doa.presets import preset
from service.doa.types import ComplexArray, FloatArray

RATE = 16_000
SPEED = 343.0
BURST = 6400
FREQUENCY = np.fft.rfftfreq(2 * BURST, 1 / RATE)
TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
SQUARE = preset("respeaker-usb-4mic-v2")
Transfer = Callable[[FloatArray, float], ComplexArray]
"""From a unit vector and a distance to the responses (N, F) of the microphones"""


def free(positions: FloatArray) -> Transfer:
    def transfer(towards: FloatArray, distance: float) -> ComplexArray:
        path = np.linalg.norm(distance * towards - positions, axis=1)[:, None]
        response: ComplexArray = (distance / path) * np.exp(
            -2j * np.pi * FREQUENCY * (path - distance) / SPEED
        )
        return response

    return transfer


def on_sphere(directions: FloatArray, radius: float) -> Transfer:
    """A plane wave and what a rigid sphere scatters of it, term by term."""
    size = np.maximum(2 * np.pi * FREQUENCY * radius / SPEED, 1e-3)

    def transfer(towards: FloatArray, _: float) -> ComplexArray:
        total = np.zeros((len(directions), size.size), dtype=complex)
        for order in range(30):
            incident = spherical_jn(order, size)
            outgoing = incident - 1j * spherical_yn(order, size)
            slope = spherical_jn(order, size, True)
            with np.errstate(all="ignore"):
                scattered = slope / (slope - 1j * spherical_yn(order, size, True)) * outgoing
            heard = 1j**order * (2 * order + 1) * (incident - np.nan_to_num(scattered))
            total += heard * eval_legendre(order, directions @ towards)[:, None]
        return total

    return transfer


def recording(
    transfer: Transfer,
    places: list[tuple[float, float, float]],
    *,
    reflections: int = 0,
    echo_gain: float = 0.35,
    bursts: int = 14,
    snr_db: float = 30.0,
    seed: int = 2,
) -> FloatArray:
    """(N, T) bursts of noise from places (azimuth, elevation in degrees, metres) in turn."""
    rng = np.random.default_rng(seed)
    echo = np.zeros(1)
    for _ in range(reflections):
        late = np.exp(-2j * np.pi * FREQUENCY * rng.uniform(0.003, 0.02))
        towards = unit(rng.uniform(0, 360), rng.uniform(-40, 40))
        echo = echo + echo_gain * late * transfer(towards, 9.0)
    rooms = [transfer(unit(azimuth, height), metres) + echo for azimuth, height, metres in places]
    envelope = np.sin(np.pi * np.arange(BURST) / BURST) ** 2 * (np.arange(BURST) > 800)
    heard = []
    for index in range(bursts):
        sound = np.fft.rfft(envelope * rng.standard_normal(BURST), 2 * BURST)
        heard.append(np.fft.irfft(sound * rooms[index % len(rooms)])[:, :BURST])
    clean = np.concatenate(heard, axis=1)
    noise = clean.std() * 10 ** (-snr_db / 20) * rng.standard_normal(clean.shape)
    audio = clean + noise
    return (0.05 * audio / audio.std()).astype(np.float32)


def unit(azimuth: float, elevation: float) -> FloatArray:
    a, e = np.deg2rad([azimuth, elevation])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def codes(audio: FloatArray, positions: FloatArray | None) -> list[tuple[str, tuple[int, ...]]]:
    diagnostics = ChannelDiagnostics(RATE, len(audio))
    diagnostics.add(audio)
    array = None if positions is None else MicrophoneArray("array", positions)
    return [(finding.code, finding.channels) for finding in diagnostics.findings(array)]


def late(audio: FloatArray, channel: int, samples: int) -> FloatArray:
    moved = audio.copy()
    moved[channel] = np.roll(audio[channel], samples)
    return moved


def inverted(audio: FloatArray, *channels: int) -> FloatArray:
    signs = np.ones((len(audio), 1), dtype=np.float32)
    signs[list(channels)] = -1
    return audio * signs


@pytest.mark.parametrize("edge_mm", [15, 25])
@pytest.mark.parametrize("seed", [1, 6])
@pytest.mark.parametrize("echo_gain", [0.35, 0.5])
def test_a_small_tetrahedron_among_reflections_raises_nothing(
    edge_mm: int, seed: int, echo_gain: float
) -> None:
    positions = edge_mm / 1000 * np.sqrt(3 / 8) * TETRAHEDRON
    talker = (float(np.random.default_rng(seed).uniform(0, 360)), 10.0, 1.5)
    audio = recording(free(positions), [talker], reflections=6, echo_gain=echo_gain, seed=seed)
    assert codes(audio, positions) == []


def test_a_late_channel_of_a_small_tetrahedron_is_found_where_several_talk() -> None:
    positions = 0.025 * np.sqrt(3 / 8) * TETRAHEDRON
    audio = recording(free(positions), [(a, 10.0, 1.5) for a in range(0, 360, 70)])
    assert codes(late(audio, 2, 2), positions) == [("channel_late", (2,))]


@pytest.mark.parametrize(("count", "length"), [(4, 0.3), (6, 0.45), (8, 0.45)])
@pytest.mark.parametrize("distance", [0.3, 0.6, 1.2])
def test_a_near_talker_before_a_line_raises_nothing(
    count: int, length: float, distance: float
) -> None:
    positions = np.zeros((count, 3))
    positions[:, 1] = np.linspace(-length / 2, length / 2, count)
    audio = recording(free(positions), [(20.0, 5.0, distance)])
    assert codes(audio, positions) == []
    if distance > length:  # a late channel is told from waves curved more than that by luck alone
        assert codes(late(audio, 2, 2), positions) == [("channel_late", (2,))]


@pytest.mark.parametrize("radius", [0.035, 0.0875])
def test_microphones_on_a_rigid_sphere_raise_nothing(radius: float) -> None:
    turns = np.deg2rad(np.arange(0, 360, 30))
    ring = np.column_stack([np.cos(turns), np.sin(turns), np.zeros(12)])
    cube = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3)
    for directions in (TETRAHEDRON, cube, ring):
        heard = on_sphere(directions, radius)
        assert codes(recording(heard, [(35.0, 10.0, 9.0)]), radius * directions) == []


def test_a_late_channel_on_a_rigid_sphere_is_found() -> None:
    cube = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3)
    audio = recording(on_sphere(cube, 0.05), [(a, 10.0, 9.0) for a in range(0, 360, 70)])
    assert codes(late(audio, 3, 2), 0.05 * cube) == [("channel_late", (3,))]


def test_the_sound_on_a_sphere_has_its_known_limits() -> None:
    response = sphere_response(np.array([1e-3, 0.1, 20.0]))
    cosine = np.cos(np.linspace(0, np.pi, response.shape[1]))
    np.testing.assert_allclose(response[0], 1, atol=0.01)
    # A small sphere: the potential flow round it adds half of the wave's own slope.
    np.testing.assert_allclose(np.angle(response[1]), 1.5 * 0.1 * cosine, atol=0.003)
    # A large one is a wall to the wave, which doubles the pressure in front.
    assert abs(response[2, 0]) == pytest.approx(2, rel=0.02)


def test_the_sphere_through_microphones_is_theirs() -> None:
    centre = np.array([0.2, -0.1, 0.4])
    np.testing.assert_allclose(sphere_through(centre + 0.05 * TETRAHEDRON), centre, atol=1e-9)
    np.testing.assert_allclose(
        sphere_through(SQUARE.positions), SQUARE.positions.mean(axis=0), atol=1e-6
    )
    grid = np.array([[x, y, 0.0] for x in (0, 0.05, 0.1) for y in (0, 0.05, 0.1)])
    line = np.array([[0.0, y, 0.0] for y in (0, 0.05, 0.1)])
    assert sphere_through(grid) is None
    assert sphere_through(line) is None


@pytest.mark.parametrize("name", ["respeaker-usb-4mic-v2", "minidsp-uma8", "matrix-creator"])
@pytest.mark.parametrize("known", [True, False])
def test_an_inverted_channel_is_named_as_such(name: str, known: bool) -> None:
    positions = preset(name).positions
    audio = recording(free(positions), [(a, 20.0, 2.0) for a in (10, 200)], reflections=6)
    for channel in range(len(positions)):
        found = codes(inverted(audio, channel), positions if known else None)
        assert found == [("channel_inverted", (channel,))]


def test_of_two_channels_either_may_be_the_inverted_one() -> None:
    audio = inverted(recording(free(SQUARE.positions[:2]), [(40.0, 0.0, 2.0)]), 0)
    diagnostics = ChannelDiagnostics(RATE, 2, (4, 5))
    diagnostics.add(audio)
    (found,) = diagnostics.findings()
    assert found.code == "channel_inverted"
    assert "channel 5 is inverted against channel 4, or they are" in found.detail


def test_a_channel_that_is_both_inverted_and_late_is_both() -> None:
    audio = recording(free(SQUARE.positions), [(a, 10.0, 2.0) for a in (30, 150, 260)])
    found = codes(inverted(late(audio, 1, 40), 1), SQUARE.positions)
    assert found == [("channel_inverted", (1,)), ("channel_late", (1,))]


def test_a_stream_names_an_inverted_channel() -> None:
    audio = recording(free(SQUARE.positions), [(a, 10.0, 2.0) for a in (30, 150)], bursts=30)
    running = RunningDiagnostics(RATE, (1, 2, 3, 4), SQUARE)
    running.add(inverted(audio, 2))
    assert [(f.code, f.channels) for f in running.check()] == [("channel_inverted", (3,))]

"""The presets agree with facts from documents other than the one each was taken from."""

from __future__ import annotations

import re

import numpy as np
import pytest

from neuralmusic.arrays import RAW_CHANNELS
from neuralmusic.errors import UnknownArray
from service.doa.array import MicrophoneArray, validate_channel_map
from service.doa.presets import PRESETS, preset
from service.doa.types import FloatArray

REQUIRED = {
    "respeaker-usb-4mic-v2": 4,
    "respeaker-4mic-hat": 4,
    "respeaker-6mic-circular": 6,
    "respeaker-core-v2": 6,  # Seeed's wiki: six microphones and two loopbacks
    "respeaker-mic-array-v1": 7,
    "xmos-xcore-7mic": 7,
    "xvf3800-4mic": 4,
    "minidsp-uma8": 7,
    "matrix-creator": 8,
    "matrix-voice": 8,
    "av163-circle8": 8,
}


def azimuths_deg(array: MicrophoneArray, first: int = 0) -> FloatArray:
    x, y = array.positions[first:, 0], array.positions[first:, 1]
    azimuths: FloatArray = np.rad2deg(np.arctan2(y, x)) % 360
    return azimuths


def test_the_required_presets_have_the_number_of_microphones_their_makers_give() -> None:
    assert {name: array.num_microphones for name, array in PRESETS.items()} == REQUIRED


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_named_sourced_level_and_centred(name: str) -> None:
    array = preset(name)
    assert array.name == name
    assert re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", name)
    assert len(array.source) > 20
    assert np.ptp(array.positions[:, 2]) == 0
    assert not array.linear
    assert not array.positions[:, 2].any()
    assert np.abs(array.positions.mean(axis=0)).max() < 1e-4
    assert not np.signbit(array.positions[array.positions == 0]).any()


def test_the_respeaker_v2_is_exactly_the_square_of_the_contract() -> None:
    side = 0.02285
    expected = [[side, side, 0], [-side, side, 0], [-side, -side, 0], [side, -side, 0]]
    np.testing.assert_array_equal(preset("respeaker-usb-4mic-v2").positions, expected)


def test_the_respeaker_v2_runs_as_in_the_odas_configuration() -> None:
    # respeaker_usb_4_mic_array.cfg puts raw microphones 1 to 4 on the axes, 135 degrees further.
    odas = np.array([[-32, 0, 0], [0, -32, 0], [32, 0, 0], [0, 32, 0]]) / 1000
    turned = preset("respeaker-usb-4mic-v2").rotated(np.deg2rad(135))
    np.testing.assert_allclose(turned.positions, odas, atol=5e-4)


@pytest.mark.parametrize(
    ("name", "first", "second", "distance_mm", "tolerance_mm"),
    [
        # voice-engine and respeaker/mic_array: between opposite microphones, by channel
        ("respeaker-4mic-hat", 0, 2, 81.27, 0.5),
        ("respeaker-4mic-hat", 1, 3, 81.27, 0.5),
        ("respeaker-6mic-circular", 0, 3, 92.18, 0.5),
        ("respeaker-6mic-circular", 1, 4, 92.18, 0.5),
        ("respeaker-6mic-circular", 2, 5, 92.18, 0.5),
        ("respeaker-core-v2", 0, 3, 92.18, 0.5),
        ("respeaker-mic-array-v1", 1, 4, 64.0, 0.1),
        ("respeaker-mic-array-v1", 2, 5, 64.0, 0.1),
        ("respeaker-mic-array-v1", 3, 6, 64.0, 0.1),
        # the side that the name of XMOS's XVF3800 board, XK-VOICE-SQ66, is read to give
        ("xvf3800-4mic", 0, 1, 66.0, 0.1),
        ("xvf3800-4mic", 1, 2, 66.0, 0.1),
        ("av163-circle8", 0, 4, 200.0, 0.1),
    ],
)
def test_published_distances_between_microphones(
    name: str, first: int, second: int, distance_mm: float, tolerance_mm: float
) -> None:
    positions = preset(name).positions
    distance = 1000 * np.linalg.norm(positions[first] - positions[second])
    assert distance == pytest.approx(distance_mm, abs=tolerance_mm)


@pytest.mark.parametrize(
    ("name", "centre", "radius_mm", "step_deg"),
    [
        ("respeaker-4mic-hat", False, 40.5, -90),
        ("respeaker-6mic-circular", False, 46.3, 60),
        ("respeaker-core-v2", False, 46.3, 60),
        ("respeaker-mic-array-v1", True, 32.0, 60),
        ("xmos-xcore-7mic", True, 43.0, -60),
        ("xvf3800-4mic", False, 33 * np.sqrt(2), 90),
        ("minidsp-uma8", True, 43.0, -60),
        ("matrix-creator", False, 52.5, -45),
        ("matrix-voice", True, 38.3, -360 / 7),
        ("av163-circle8", False, 100.0, 45),
    ],
)
def test_rings_are_evenly_spaced_and_run_in_the_direction_of_their_source(
    name: str, centre: bool, radius_mm: float, step_deg: float
) -> None:
    array = preset(name)
    first = 1 if centre else 0
    assert not array.positions[:first].any()
    radii = 1000 * np.linalg.norm(array.positions[first:], axis=1)
    np.testing.assert_allclose(radii, radius_mm, atol=0.01)
    azimuths = azimuths_deg(array, first)
    steps = (np.roll(azimuths, -1) - azimuths + 180) % 360 - 180
    np.testing.assert_allclose(steps, step_deg, atol=0.05)


def test_the_matrix_creator_is_the_makers_table() -> None:
    a, b = 20.0908795, 48.5036755
    table = [(a, -b), (-a, -b), (-b, -a), (-b, a), (-a, b), (a, b), (b, a), (b, -a)]
    np.testing.assert_allclose(
        1000 * preset("matrix-creator").positions[:, :2], table, rtol=0, atol=1e-3
    )


def test_the_uma8_agrees_with_a_measurement_of_its_drawing() -> None:
    # By a bird-song project off a drawing from above, USB socket at -y: 90 degrees behind ODAS.
    ring = [(42.6, -0.5), (21.5, -37.7), (-21.2, -37.7), (-42.3, -0.8), (-21.2, 35.8), (21.4, 36.2)]
    measured = np.array([(0.0, 0.0), *ring])
    turned = np.stack([-measured[:, 1], measured[:, 0]], axis=1)
    np.testing.assert_allclose(1000 * preset("minidsp-uma8").positions[:, :2], turned, atol=2)


@pytest.mark.parametrize(
    ("name", "microphone", "azimuth_deg"),
    [
        ("respeaker-4mic-hat", 3, 0),
        ("respeaker-6mic-circular", 5, 0),
        ("respeaker-core-v2", 5, 0),
        ("respeaker-mic-array-v1", 6, 0),
        ("xmos-xcore-7mic", 6, 0),
        ("minidsp-uma8", 2, 90),
        ("xvf3800-4mic", 2, 45),
    ],
)
def test_the_microphone_that_odas_or_the_maker_puts_there(
    name: str, microphone: int, azimuth_deg: float
) -> None:
    # Microphones count from 1 here, as in the documents.
    assert azimuths_deg(preset(name))[microphone - 1] == pytest.approx(azimuth_deg, abs=1e-3)


def test_the_av163_circle_is_in_the_order_of_the_data_set() -> None:
    np.testing.assert_allclose(
        azimuths_deg(preset("av163-circle8")), [180, 225, 270, 315, 0, 45, 90, 135], atol=1e-3
    )


def test_the_core_v2_has_the_geometry_of_the_circular_array() -> None:
    assert preset("respeaker-core-v2").matches(preset("respeaker-6mic-circular"))


def test_raw_channels_follow_the_makers_firmware_tables() -> None:
    assert RAW_CHANNELS["respeaker-usb-4mic-v2"] == {6: (1, 2, 3, 4)}
    assert RAW_CHANNELS["xvf3800-4mic"] == {6: (2, 3, 4, 5)}
    assert RAW_CHANNELS["respeaker-6mic-circular"] == {8: (0, 1, 2, 3, 4, 5)}


@pytest.mark.parametrize("name", RAW_CHANNELS)
def test_raw_channels_are_a_channel_map_of_a_longer_recording(name: str) -> None:
    count = preset(name).num_microphones
    for total, channels in RAW_CHANNELS[name].items():
        assert total > count
        assert validate_channel_map(channels, count) == channels
        assert max(channels) < total


def test_presets_cannot_be_changed() -> None:
    with pytest.raises(TypeError):
        PRESETS["mine"] = preset("xvf3800-4mic")  # type: ignore[index]
    with pytest.raises(TypeError):
        RAW_CHANNELS["xvf3800-4mic"][2] = (0, 1)  # type: ignore[index]
    with pytest.raises(ValueError, match="read-only"):
        preset("xvf3800-4mic").positions[0, 0] = 1.0


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("respeaker-usb-4mic", "respeaker-usb-4mic-v2"),
        ("ReSpeaker_USB_4mic_v2", "respeaker-usb-4mic-v2"),
        ("matrix-voise", "matrix-voice"),
        ("uma8", "minidsp-uma8"),
        ("av16.3", "av163-circle8"),
    ],
)
def test_an_unknown_name_is_answered_with_the_closest_and_all_names(name: str, meant: str) -> None:
    with pytest.raises(UnknownArray) as raised:
        preset(name)
    assert repr(name) in raised.value.detail
    assert f"did you mean {meant!r}?" in raised.value.detail
    assert all(known in raised.value.detail for known in PRESETS)


@pytest.mark.parametrize("name", ["", "?", "x" * 100_000])
def test_a_name_like_no_other_gets_the_list_without_a_suggestion(name: str) -> None:
    with pytest.raises(UnknownArray) as raised:
        preset(name)
    assert "did you mean" not in raised.value.detail
    assert all(known in raised.value.detail for known in PRESETS)
    assert len(raised.value.detail) < 500

"""Every classical method of the comparison, against plane waves whose directions are known."""

from __future__ import annotations

import numpy as np
import pytest
from plane_waves import plane_waves

from model_export.baselines.classical import classical_methods
from model_export.baselines.coherent import Cssm, Waves
from model_export.baselines.frida import Frida, distinct_baselines
from model_export.baselines.method import Method
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.scoring import maae
from service.doa.steering import steering_vectors

SQUARE = preset("respeaker-usb-4mic-v2")
LINE = MicrophoneArray("line", np.array([[0.0, y, 0.0] for y in (0.06, 0.02, -0.02, -0.06)]))
METHODS = {method.card.name: method for method in classical_methods()}
ANY_ARRAY = [name for name, method in METHODS.items() if not method.card.linear_only]


def error_deg(method: Method, array: MicrophoneArray, azimuth_deg: list[float]) -> float:
    audio = plane_waves(array, azimuth_deg)
    estimate = method.localize(audio, array, len(azimuth_deg))
    return float(np.rad2deg(maae(estimate.azimuth, np.deg2rad(azimuth_deg))))


def test_the_nine_methods_are_in_the_order_of_the_tables() -> None:
    assert list(METHODS) == [
        *("music", "norm_music", "srp_phat", "gcc_phat"),
        *("tops", "cssm", "waves", "frida", "root_music"),
    ]
    assert not any(method.counts for method in METHODS.values())
    assert {method.card.kind for method in METHODS.values()} == {"classical"}


@pytest.mark.parametrize("name", ANY_ARRAY)
def test_one_plane_wave_is_found(name: str) -> None:
    # A direction across the grid's wrap and between its angles.
    assert error_deg(METHODS[name], SQUARE, [359.6]) < 1


@pytest.mark.parametrize("name", [name for name in ANY_ARRAY if name != "tops"])
def test_two_plane_waves_are_found(name: str) -> None:
    assert error_deg(METHODS[name], SQUARE, [20.0, 150.0]) < 5


def test_tops_tells_two_plane_waves_apart() -> None:
    # Without moving the band, the library's bins disagree and it finds one direction.
    assert error_deg(METHODS["tops"], SQUARE, [60.0, 120.0]) < 0.5


@pytest.mark.parametrize("name", sorted(METHODS))
@pytest.mark.parametrize(
    ("channels", "samples", "count", "words"),
    [
        (3, 8192, 1, "takes"),
        (4, 8192, None, "number of sources"),
        (4, 8192, 0, "number of sources"),
        (4, 100, 1, "shorter than a frame"),
    ],
)
def test_what_does_not_fit_is_refused(
    name: str, channels: int, samples: int, count: int | None, words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        METHODS[name].localize(np.ones((channels, samples), np.float32), LINE, count)


@pytest.mark.parametrize("name", ["music", "gcc_phat", "cssm", "waves"])
def test_a_line_is_searched_on_one_side(name: str) -> None:
    assert error_deg(METHODS[name], LINE, [-35.0]) < 2
    behind = METHODS[name].localize(plane_waves(LINE, [180 + 35.0]), LINE, 1)
    np.testing.assert_allclose(np.rad2deg(behind.azimuth) - 360, -35.0, atol=2)


@pytest.mark.parametrize("name", ANY_ARRAY)
def test_silence_has_no_direction(name: str) -> None:
    assert METHODS[name].localize(np.zeros((4, 2048), np.float32), SQUARE, 2).azimuth.size == 0


def test_a_second_array_takes_the_place_of_the_first() -> None:
    method = METHODS["norm_music"]
    assert error_deg(method, SQUARE, [70.0]) < 1
    assert error_deg(method, SQUARE.rotated(np.deg2rad(40.0)), [70.0]) < 1
    assert error_deg(method, preset("respeaker-6mic-circular"), [70.0]) < 1


def test_frida_repeats_its_answer_and_leaves_the_random_numbers_alone() -> None:
    audio = plane_waves(SQUARE, [40.0, 200.0], snr_db=5)
    np.random.seed(3)  # noqa: NPY002  the global numbers are what is tested
    untouched = np.random.rand(2)  # noqa: NPY002
    np.random.seed(3)  # noqa: NPY002
    first = Frida().localize(audio, SQUARE, 2)
    np.testing.assert_array_equal(np.random.rand(2), untouched)  # noqa: NPY002
    second = METHODS["frida"].localize(audio, SQUARE, 2)
    np.testing.assert_array_equal(first.azimuth, second.azimuth)


def test_frida_has_no_answer_to_a_sound_from_above_and_counts_that() -> None:
    method = Frida()
    above = np.repeat(plane_waves(SQUARE, [0.0], num_samples=2048)[:1], 4, axis=0)
    assert method.localize(above, SQUARE, 1).azimuth.size == 0
    assert method.failures == 1


def test_frida_counts_what_a_square_tells_and_refuses_the_rest() -> None:
    # Two distinct sides and two distinct diagonals.
    assert distinct_baselines(SQUARE) == 4
    with pytest.raises(ValueError, match="at most 3 sources"):
        METHODS["frida"].localize(plane_waves(SQUARE, [0.0]), SQUARE, 4)
    with pytest.raises(ValueError, match="sides apart"):
        METHODS["frida"].localize(plane_waves(LINE, [0.0]), LINE, 1)


@pytest.mark.parametrize("method", [Cssm(), Waves()], ids=["cssm", "waves"])
def test_coherent_methods_answer_where_no_bin_shows_the_sources(method: Cssm | Waves) -> None:
    # A triangle so small that every beamformer has one broad maximum.
    corners = np.deg2rad([90.0, 210.0, 330.0])
    ring = 0.006 * np.stack([np.cos(corners), np.sin(corners), np.zeros(3)], axis=-1)
    tiny = MicrophoneArray("tiny", ring)
    estimate = method.localize(plane_waves(tiny, [20.0, 60.0]), tiny, 2)
    assert estimate.azimuth.size <= 2
    assert method.failures == 1
    method.localize(plane_waves(tiny, [20.0]), tiny, 1)
    assert method.failures == 1


def test_focusing_is_unitary_where_the_library_has_no_matrix() -> None:
    azimuth, bins, reference = np.array([50, 310]), np.array([40, 70]), 60
    frequencies = 31.25 * np.array([*bins, reference])
    steering = steering_vectors(SQUARE.positions, frequencies, np.deg2rad(azimuth))
    # The first two microphones lie along x, so mirrored directions look equal to them.
    assert np.linalg.svd(steering[0, :2], compute_uv=False)[-1] < 1e-6
    finder, _ = Cssm().prepare(SQUARE)
    finder.freq_bins = bins
    matrices = finder.focusing(reference, np.tile(azimuth, (2, 1)))
    unit = np.broadcast_to(np.eye(4), matrices.shape)
    np.testing.assert_allclose(matrices @ matrices.conj().swapaxes(-1, -2), unit, atol=1e-9)
    # One direction is mapped onto the reference bin's; two keep their angle to each other.
    alone = finder.focusing(reference, np.tile(azimuth[:1], (2, 1))) @ steering[:2, :, :1]
    np.testing.assert_allclose(alone, steering[[2, 2], :, :1], atol=0.01)


def test_waves_does_not_depend_on_the_level() -> None:
    audio = plane_waves(SQUARE, [10.0, 140.0], snr_db=10)
    loud, soft = (METHODS["waves"].localize(g * audio, SQUARE, 2) for g in (1.0, 2.0**-12))
    np.testing.assert_allclose(loud.azimuth, soft.azimuth, atol=1e-5)

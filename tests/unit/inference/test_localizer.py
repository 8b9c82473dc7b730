"""The embedded bundle and the classical methods on audio with known directions."""

from __future__ import annotations

import numpy as np
import pytest

from neuralmusic.protocol.methods import METHODS
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.scoring import circular_error, maae
from service.doa.types import FloatArray
from service.inference.classical import ClassicalLocalizer
from service.inference.localizer import Localizer, estimate_stretch, localizer_of
from service.inference.registry import BundleRegistry
from service.inference.source_counter import LEAST_CONFIDENCE, surest
from service.inference.weights import strongest_blocks
from service.inference.windows import stretches, windows


@pytest.fixture(scope="module")
def registry() -> BundleRegistry:
    return BundleRegistry.load()


def localizer(method: str, array: MicrophoneArray, registry: BundleRegistry) -> Localizer:
    if method != "neural":
        return ClassicalLocalizer(method, array)  # type: ignore[arg-type]
    bundle = registry.for_array(array)
    assert bundle is not None
    return localizer_of(bundle, array)


def azimuths(estimates: list) -> list[FloatArray]:
    return [np.array([s.azimuth for s in estimate.sources]) for estimate in estimates]


ARRAYS = {
    "square": preset("respeaker-usb-4mic-v2"),
    "ring": preset("respeaker-6mic-circular"),
    "tetrahedron": MicrophoneArray(
        "custom", 0.03 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    ),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ARRAYS)
def test_one_talker_is_found_on_any_array(
    method: str, name: str, registry: BundleRegistry, plane_waves
) -> None:
    truth = np.array([3.0, 77.7, 181.2, 359.4, 29, 58, 107, 136, 214, 243, 291, 320])
    array = ARRAYS[name]
    windows = np.stack([plane_waves(array, [t], seed=i) for i, t in enumerate(truth)])
    one = localizer(method, array, registry)
    told = azimuths(one.estimate(windows, 1, 3))
    assert [len(found) for found in told] == [1] * len(truth)
    assert np.rad2deg(circular_error(np.concatenate(told), np.deg2rad(truth)).max()) < 2.0
    # Nobody counts without a mistake, but nine windows in ten hold the talker and nothing else.
    counted = azimuths(one.estimate(windows, None, 3))
    right = [
        len(found) == 1 and np.rad2deg(circular_error(found[0], np.deg2rad(azimuth))) < 2.0
        for found, azimuth in zip(counted, truth, strict=True)
    ]
    assert np.mean(right) >= 0.9


def test_two_talkers_are_found_and_counted(registry: BundleRegistry, plane_waves) -> None:
    array = ARRAYS["square"]
    truth = [(20, 100), (350, 170), (60, 240), (130, 300)]
    windows = np.stack([plane_waves(array, t, seed=10 + i) for i, t in enumerate(truth)])
    neural = localizer("neural", array, registry)
    for found, expected in zip(azimuths(neural.estimate(windows, 2, 3)), truth, strict=True):
        assert len(found) == 2
        assert np.rad2deg(maae(found, np.deg2rad(expected))) < 4.0
    counted = [len(f) for f in azimuths(neural.estimate(windows, None, 3))]
    assert np.mean(np.array(counted) == 2) >= 0.75


@pytest.mark.parametrize("method", METHODS)
def test_a_line_reports_one_source_in_front(
    method: str, registry: BundleRegistry, plane_waves
) -> None:
    array = MicrophoneArray("custom", np.array([[0.0, 0.035 * n, 0.0] for n in range(4)]))
    windows = np.stack([plane_waves(array, [t], seed=t) for t in (30, 320, 150)])
    found = azimuths(localizer(method, array, registry).estimate(windows, None, 3))
    assert [len(f) for f in found] == [1, 1, 1]
    np.testing.assert_allclose(np.rad2deg(np.concatenate(found)), [30, 320, 30], atol=3)


@pytest.mark.parametrize("method", METHODS)
def test_noise_without_a_direction_has_no_source(method: str, registry: BundleRegistry) -> None:
    array = ARRAYS["square"]
    noise = np.random.default_rng(5).standard_normal((8, 4, 16640)).astype(np.float32) * 0.01
    found = azimuths(localizer(method, array, registry).estimate(noise, None, 3))
    assert sum(len(f) > 0 for f in found) <= 1


def test_results_do_not_depend_on_the_batch(registry: BundleRegistry, plane_waves) -> None:
    array = ARRAYS["square"]
    windows = np.stack([plane_waves(array, [40 * i, 40 * i + 90], seed=i) for i in range(5)])
    neural = localizer("neural", array, registry)
    together = neural.estimate(windows, None, 3)
    for index, estimate in enumerate(together):
        (alone,) = neural.estimate(windows[index : index + 1], None, 3)
        np.testing.assert_allclose(alone.spectrum, estimate.spectrum, atol=1e-4)
        assert len(alone.sources) == len(estimate.sources)


def test_turning_the_array_turns_the_directions(registry: BundleRegistry, plane_waves) -> None:
    """The network sees no geometry, so the same audio on a turned array gives a turned spectrum."""
    array = ARRAYS["square"]
    window = plane_waves(array, [50.0, 200.0])[None]
    (plain,) = localizer("neural", array, registry).estimate(window, 2, 3)
    turned = localizer("neural", array.rotated(np.deg2rad(30.0)), registry)
    (rotated,) = turned.estimate(window, 2, 3)
    steps = plain.spectrum.size // 12
    np.testing.assert_allclose(rotated.spectrum, np.roll(plain.spectrum, steps), atol=1e-3)


def test_level_does_not_matter(registry: BundleRegistry, plane_waves) -> None:
    window = plane_waves(ARRAYS["square"], [120.0])[None]
    neural = localizer("neural", ARRAYS["square"], registry)
    (loud,) = neural.estimate(window, None, 3)
    (quiet,) = neural.estimate(window * 1e-3, None, 3)
    np.testing.assert_allclose(quiet.spectrum, loud.spectrum, atol=1e-3)


@pytest.mark.parametrize("samples", [2048, 5000, 16640, 40000])
def test_windows_of_any_length(samples: int, registry: BundleRegistry, plane_waves) -> None:
    array = ARRAYS["square"]
    window = plane_waves(array, [260.0], seconds=3.0, seed=4)[None, :, :samples]
    (estimate,) = localizer("neural", array, registry).estimate(window, 1, 3)
    assert np.rad2deg(estimate.sources[0].azimuth) == pytest.approx(260.0, abs=4.0)


@pytest.mark.parametrize(
    ("confidence", "kept"),
    [
        ([0.9, 0.6, 0.1], [0.9, 0.6]),
        ([0.4, 0.9, 0.1], [0.9]),  # the surer one first, a further one only above a half
        ([0.3, 0.1, 0.9], [0.3]),  # the third was not counted
        ([0.1, 0.05, 0.9], []),
    ],
)
def test_the_surest_counted_source_needs_less_than_further_ones(
    confidence: list[float], kept: list[float]
) -> None:
    chances = np.array(confidence)
    assert [confidence[index] for index in surest(chances, 2, LEAST_CONFIDENCE)] == kept
    assert len(surest(chances, 2, 0.0)) == 2  # whoever names the number gets it


@pytest.mark.parametrize("share", [0.25, 0.5])
@pytest.mark.parametrize("blocks", [1, 3, 4, 8, 9, 78])
def test_the_blocks_that_a_bin_keeps_are_its_most_attended(blocks: int, share: float) -> None:
    rng = np.random.default_rng(blocks)
    attention = rng.uniform(0, 1, (blocks, 7)).astype(np.float32)
    kept = strongest_blocks(attention, share)
    assert len(kept) == max(min(round(8 * share), blocks), int(share * blocks))
    for f in range(7):
        assert list(kept[:, f]) == sorted(np.argsort(attention[:, f])[blocks - len(kept) :])


@pytest.mark.parametrize("method", ["neural", "norm_music"])
@pytest.mark.parametrize(("window_s", "hop_s"), [(1.024, 0.512), (1.0, 0.24), (0.5, 0.1)])
def test_a_stretch_gives_what_its_windows_give_alone(
    method: str, window_s: float, hop_s: float, registry: BundleRegistry, plane_waves
) -> None:
    array = ARRAYS["square"]
    audio = plane_waves(array, [50.0, 140.0], seconds=2.5)
    tail = registry.bundles[0].stft.n_fft - registry.bundles[0].stft.hop
    (stretch,) = stretches(windows([audio], 16000, window_s, hop_s, tail), 30)
    assert len(stretch.starts) > 2
    chosen = localizer(method, array, registry)
    together = estimate_stretch(chosen, stretch, 2, 3)
    length = stretch.length - tail
    for found, window, heard in zip(together, stretch.windows, stretch.heard, strict=True):
        ends = heard < length and method == "neural"  # then only what was heard is looked at
        (alone,) = chosen.estimate(window[None, :, :heard] if ends else window[None], 2, 3)
        np.testing.assert_allclose(found.spectrum, alone.spectrum, atol=1e-4)
        assert [s.azimuth for s in found.sources] == pytest.approx(
            [s.azimuth for s in alone.sources], abs=1e-3
        )


def test_a_long_window_hears_who_speaks_in_turn(registry: BundleRegistry, plane_waves) -> None:
    """One source sounds in the first of eight seconds, another in the last: both are found."""
    array = ARRAYS["square"]
    first = plane_waves(array, [50.0], seconds=4.0, seed=1)
    second = plane_waves(array, [200.0], seconds=4.0, seed=2)
    window = np.concatenate([first, second], axis=1)[None]
    (estimate,) = localizer("neural", array, registry).estimate(window, 2, 3)
    found = sorted(np.rad2deg(source.azimuth) for source in estimate.sources)
    assert found == pytest.approx([50.0, 200.0], abs=4.0)


@pytest.mark.parametrize("method", METHODS)
def test_a_line_that_was_measured_with_a_ruler_is_one_source_in_front(
    method: str, registry: BundleRegistry, plane_waves
) -> None:
    """Positions 1 mm off tell nothing of sides: the image before the line, once, not its back."""
    exact = np.array([[0.0, 0.03 * n, 0.0] for n in range(4)])
    rng = np.random.default_rng(4)
    for azimuth in (20, 160, 300, 230):
        window = plane_waves(MicrophoneArray("exact", exact), [azimuth], seed=azimuth)[None]
        off = exact + rng.normal(0, 0.001, exact.shape) * [1, 1, 0]
        (estimate,) = localizer(method, MicrophoneArray("measured", off), registry).estimate(
            window, None, 3
        )
        front = azimuth if np.cos(np.deg2rad(azimuth)) > 0 else 180 - azimuth
        (source,) = estimate.sources
        error = circular_error(np.array(source.azimuth), np.deg2rad(front))
        assert np.rad2deg(error) < 8


def test_an_array_that_is_bent_by_more_tells_its_sides(
    registry: BundleRegistry, plane_waves
) -> None:
    exact = np.array([[0.004 * (-1) ** n, 0.03 * n, 0.0] for n in range(4)])
    rng = np.random.default_rng(5)
    for azimuth in (20, 160, 300, 230):
        window = plane_waves(MicrophoneArray("exact", exact), [azimuth], seed=azimuth)[None]
        measured = MicrophoneArray("measured", exact + rng.normal(0, 0.001, exact.shape))
        (estimate,) = localizer("neural", measured, registry).estimate(window, None, 3)
        error = circular_error(np.array(estimate.sources[0].azimuth), np.deg2rad(azimuth))
        assert np.rad2deg(error) < 8

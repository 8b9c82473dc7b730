"""The picture shows the directions where they are, and nothing covers anything else."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from neuralmusic.errors import ConfigError
from service.cli.plot import (
    LABEL_RADIUS,
    MIN_GAP,
    check_drawable,
    localization_figure,
    mean_spectrum,
    save_figure,
    spread_labels,
)
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.inference.results import Source, WindowEstimate
from service.recordings.results import RecordingResult, SummarySource, WindowResult

GRID = np.deg2rad(np.arange(360))


def window(index: int, *azimuths_deg: float) -> WindowResult:
    azimuths = np.deg2rad(azimuths_deg)
    lobes = [np.exp(8 * (np.cos(GRID - azimuth) - 1)) for azimuth in azimuths]
    sources = tuple(Source(float(azimuth), 0.9) for azimuth in azimuths)
    estimate = WindowEstimate(sources, np.sum([np.zeros(360), *lobes], axis=0))
    return WindowResult(0.5 * index, 0.5 * index + 1.0, estimate)


def result(
    *azimuths_deg: float, windows: int = 4, array: MicrophoneArray | None = None
) -> RecordingResult:
    array = array or preset("minidsp-uma8")
    return RecordingResult(
        method="norm_music",
        model=None,
        sample_rate=16000,
        channels=array.num_microphones,
        duration=0.5 * windows + 0.5,
        array=array,
        channel_map=tuple(range(array.num_microphones)),
        windows=[window(index, *azimuths_deg) for index in range(windows)],
        summary=[SummarySource(math.radians(azimuth), 0.9, 1.0) for azimuth in azimuths_deg],
    )


def test_needles_and_dots_lie_at_the_sources() -> None:
    polar, timeline, _ = localization_figure(result(30.0, 200.0)).axes
    needles = {round(math.degrees(line.get_xdata()[0])) for line in polar.lines[1:3]}
    assert needles == {30, 200}
    (dots,) = (c for c in timeline.collections if len(c.get_offsets()) == 8)
    assert {round(float(azimuth)) for _, azimuth in dots.get_offsets()} == {30, 200}


def test_forward_points_up_and_left_is_left() -> None:
    polar = localization_figure(result(0.0)).axes[0]
    to_pixels = polar.transData.transform
    centre, front, left = (to_pixels((angle, r)) for angle, r in ((0, 0), (0, 1), (np.pi / 2, 1)))
    assert front[1] > centre[1]
    assert front[0] == pytest.approx(centre[0])
    assert left[0] < centre[0]


def test_the_array_is_drawn_to_scale() -> None:
    array = preset("respeaker-usb-4mic-v2")
    polar = localization_figure(result(10.0, array=array)).axes[0]
    (dots,) = (c for c in polar.collections if len(c.get_offsets()) == 4)
    azimuth, radius = np.array(dots.get_offsets()).T
    drawn = radius[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    scale = drawn[0, 0] / array.positions[0, 0]
    np.testing.assert_allclose(drawn, scale * array.positions[:, :2], atol=1e-9)


@pytest.mark.parametrize("azimuths", [(2, 8, 355), (0, 90, 180, 270), (100, 101, 102, 103)])
def test_no_text_covers_another(azimuths: tuple[float, ...]) -> None:
    figure = localization_figure(result(*azimuths))
    figure.canvas.draw()
    labels = [*figure.texts, *(text for axes in figure.axes for text in axes.texts)]
    labels += [label for axes in figure.axes[:1] for label in axes.get_xticklabels()]
    boxes = [label.get_window_extent() for label in labels if label.get_text()]
    assert len(boxes) >= len(azimuths) + 12
    assert not any(first.overlaps(second) for first, second in combinations(boxes, 2))


@pytest.mark.parametrize("azimuths_deg", [[10.0, 12.0, 300.0], [359.0, 1.0], [5.0] * 4])
def test_spread_labels_keep_the_gap_and_the_mean(azimuths_deg: list[float]) -> None:
    spread = spread_labels([math.radians(azimuth) for azimuth in azimuths_deg])
    for first, second in combinations(spread, 2):
        distance = abs((first - second + np.pi) % (2 * np.pi) - np.pi)
        assert distance > 0.99 * MIN_GAP
    before = np.exp(1j * np.deg2rad(azimuths_deg)).mean()
    assert abs(np.angle(np.exp(1j * np.array(spread)).mean() / before)) < 0.05


def test_labels_that_are_far_apart_stay() -> None:
    assert spread_labels([1.0, 4.0]) == [1.0, 4.0]
    assert 0 < LABEL_RADIUS < 1


def test_the_mean_spectrum_is_of_windows_with_sources() -> None:
    heard = result(90.0)
    flat = WindowResult(2.0, 3.0, WindowEstimate((), np.full(360, 9.0)))
    spectrum = mean_spectrum(replace(heard, windows=[*heard.windows, flat]))
    np.testing.assert_allclose(spectrum, mean_spectrum(heard))
    assert spectrum.argmax() == 90
    assert spectrum.max() == pytest.approx(1.0)


@pytest.mark.parametrize("windows", [0, 1])
def test_silence_is_drawn(windows: int, tmp_path: Path) -> None:
    silent = result(windows=windows)
    assert mean_spectrum(silent).max() == 0.0
    save_figure(silent, tmp_path / "silent.png")
    assert (tmp_path / "silent.png").read_bytes().startswith(b"\x89PNG")


def test_a_suffix_that_names_no_format_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"end it in \.png"):
        check_drawable(Path("picture.txt"))


def test_without_matplotlib_a_sentence_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    with pytest.raises(ConfigError, match=r"pip install \./client '\.\[plot\]'"):
        check_drawable(Path("picture.png"))

"""A stream's results, whoever asks for them when."""

from __future__ import annotations

import numpy as np
import pytest

from service.bench.window import bench_window
from service.doa.presets import preset
from service.inference.bundle import Bundle
from service.inference.registry import BundleRegistry
from service.inference.results import WindowEstimate
from service.inference.weights_stream import WeightsStream

PUSHED = (1, 6, 7, 6, 5, 1, 30, 2, 6, 9)
"""Numbers of frames at a time, 73 in all"""


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return BundleRegistry.load().get("any-array")


@pytest.mark.parametrize("name", ["respeaker-usb-4mic-v2", "av163-circle8"])
def test_a_result_is_the_same_whether_others_were_asked_for_before(
    name: str, bundle: Bundle
) -> None:
    """Blocks whose spectra nobody needed yet, one that became final, and many at once."""
    array = preset(name)
    audio = np.concatenate([bench_window(array, seed) for seed in (1, 2)], axis=1)
    spectra = bundle.stft.transform(audio)
    often, once = WeightsStream(bundle, array), WeightsStream(bundle, array)
    place = 0
    for frames in PUSHED:
        for stream in (often, once):
            stream.push(spectra[..., place : place + frames])
        place += frames
        last = often.estimate(None, 3)
    first = once.estimate(None, 3)
    assert _numbers(first) == pytest.approx(_numbers(last), abs=1e-4)
    np.testing.assert_allclose(first.spectrum, last.spectrum, atol=1e-4)
    assert first.sources


def _numbers(estimate: WindowEstimate) -> list[float]:
    return [value for s in estimate.sources for value in (s.azimuth, s.confidence)]

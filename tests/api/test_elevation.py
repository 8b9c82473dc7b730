"""Elevations over HTTP and WebSocket: who tells them, and what is said where nobody does."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import soundfile
from running_service import RunningService

from neuralmusic import LocalizationClient, ServiceProblem, StreamClient
from neuralmusic.protocol.methods import METHODS
from neuralmusic.protocol.server_messages import OdasSst, Ready, Result
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.types import FloatArray
from service.settings import Settings

CORNERS = [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]
TETRAHEDRON = MicrophoneArray("tetrahedron", 0.018 * np.array(CORNERS))
SQUARE = preset("respeaker-usb-4mic-v2")
AZIMUTH, ELEVATION = 130.0, 45.0


@pytest.fixture(scope="module")
def service() -> Iterator[RunningService]:
    running = RunningService(settings=Settings(workers=1, stream_workers=1))
    yield running
    running.stop()


@pytest.fixture
def client(service: RunningService) -> Iterator[LocalizationClient]:
    with LocalizationClient(service.url) as opened:
        yield opened


def heard(plane_waves: Any, array: MicrophoneArray, seconds: float = 1.5) -> FloatArray:
    audio: FloatArray = plane_waves(array, [AZIMUTH], elevation_deg=ELEVATION, seconds=seconds)
    return audio


def wav(audio: FloatArray) -> bytes:
    file = io.BytesIO()
    soundfile.write(file, audio.T, 16000, format="WAV", subtype="PCM_16")
    return file.getvalue()


def expected(elevation: float) -> list[float]:
    level = math.cos(math.radians(elevation))
    azimuth = math.radians(AZIMUTH)
    height = math.sin(math.radians(elevation))
    return [level * math.cos(azimuth), level * math.sin(azimuth), height]


def test_a_recording_of_an_array_with_height_has_elevations(
    client: LocalizationClient, plane_waves: Any
) -> None:
    answer = client.localize(wav(heard(plane_waves, TETRAHEDRON)), array=TETRAHEDRON.positions)
    assert answer["array"]["why_no_elevation"] is None
    (summary,) = answer["summary"]["sources"]
    assert summary["azimuth_deg"] == pytest.approx(AZIMUTH, abs=3)
    assert summary["elevation_deg"] == pytest.approx(ELEVATION, abs=3)
    for window in answer["windows"]:
        (source,) = window["sources"]
        assert source["unit_vector"] == pytest.approx(expected(ELEVATION), abs=0.06)
        assert source["id"] == 1


@pytest.mark.parametrize(
    ("hemisphere", "elevation"), [(None, None), ("upper", ELEVATION), ("lower", -ELEVATION)]
)
def test_a_level_array_has_them_where_the_side_is_known(
    client: LocalizationClient, plane_waves: Any, hemisphere: Any, elevation: float | None
) -> None:
    recording = wav(heard(plane_waves, SQUARE))
    answer = client.localize(recording, array=SQUARE.name, hemisphere=hemisphere)
    (source,) = answer["summary"]["sources"]
    assert source["azimuth_deg"] == pytest.approx(AZIMUTH, abs=3)
    why = answer["array"]["why_no_elevation"]
    if elevation is None:
        assert source["elevation_deg"] is None
        assert "upper or lower" in why
    else:
        assert source["elevation_deg"] == pytest.approx(elevation, abs=4)
        assert why is None


def test_what_has_none_says_why_and_a_wrong_side_is_refused(
    client: LocalizationClient, plane_waves: Any
) -> None:
    recording = wav(heard(plane_waves, TETRAHEDRON))
    line = [[0.0, y, 0.0] for y in (0.0, 0.03, 0.06, 0.09)]
    answer = client.localize(recording, array=line, hemisphere="upper")
    assert answer["summary"]["sources"][0]["elevation_deg"] is None
    assert "one line" in answer["array"]["why_no_elevation"]
    with pytest.raises(ServiceProblem, match="needs an array that tells elevations, but the micro"):
        client.localize(recording, array=SQUARE.name, spectrum="sphere")
    with pytest.raises(ServiceProblem, match="hemisphere must be one of both, upper, lower"):
        client.localize(recording, array=SQUARE.name, hemisphere="left")  # type: ignore[arg-type]


def highest(image: list[list[float]]) -> tuple[float, float]:
    """Azimuth and elevation in degrees of an image's highest value, as documented."""
    values = np.array(image)
    assert values.shape == (36, 72)
    assert 0.3 < values.max() <= 1
    row, column = np.unravel_index(values.argmax(), values.shape)
    return 5.0 * column, 5.0 * row - 87.5


@pytest.mark.parametrize("method", METHODS)
def test_every_method_gives_an_image_of_the_sphere(
    client: LocalizationClient, plane_waves: Any, method: Any
) -> None:
    recording = wav(heard(plane_waves, TETRAHEDRON))
    answer = client.localize(
        recording, array=TETRAHEDRON.positions, method=method, spectrum="sphere", yaw_deg=30
    )
    for window in answer["windows"]:
        assert "spectrum" not in window
        assert highest(window["sphere"]) == pytest.approx((AZIMUTH + 30, ELEVATION), abs=6)
    (source,) = answer["summary"]["sources"]
    assert source["elevation_deg"] == pytest.approx(ELEVATION, abs=3)


@pytest.mark.parametrize("hemisphere", ["upper", "both"])
def test_a_stream_gives_images_where_elevations_are_told(
    service: RunningService, plane_waves: Any, hemisphere: Any
) -> None:
    with StreamClient(
        service.url,
        audio={"encoding": "pcm_f32le", "sample_rate": 16000, "channels": 4},
        array={"name": SQUARE.name},
        method="srp_phat",
        hemisphere=hemisphere,
        output={"include": ["sphere"], "yaw_deg": 20},
        overflow="block",
    ) as stream:
        stream.send(np.ascontiguousarray(heard(plane_waves, SQUARE).T).tobytes())
        stream.stop()
        last = [event for event in stream if isinstance(event, Result)][-1]
    assert last.spectrum is None
    if hemisphere == "both":
        assert last.sphere is None
        return
    assert last.sphere is not None
    assert highest(last.sphere) == pytest.approx((AZIMUTH + 20, ELEVATION), abs=6)
    assert not np.any(last.sphere[:18])  # below the plane nothing is searched


@pytest.mark.parametrize("format", ["doa", "odas"])
def test_a_stream_has_them_in_every_format(
    service: RunningService, plane_waves: Any, format: Any
) -> None:
    audio = heard(plane_waves, SQUARE, seconds=3.0)
    with StreamClient(
        service.url,
        audio={"encoding": "pcm_f32le", "sample_rate": 16000, "channels": 4},
        array={"name": SQUARE.name},
        hemisphere="upper",
        output={"format": format},
        overflow="block",
    ) as stream:
        stream.send(np.ascontiguousarray(audio.T).tobytes())
        stream.stop()
        events = list(stream)
    ready = next(event for event in events if isinstance(event, Ready))
    assert ready.array.why_no_elevation is None
    if format == "doa":
        (source,) = [event for event in events if isinstance(event, Result)][-1].sources
        assert source.elevation_deg == pytest.approx(ELEVATION, abs=6)
        assert source.unit_vector == pytest.approx(expected(ELEVATION), abs=0.1)
    else:
        track = [event for event in events if isinstance(event, OdasSst)][-1].src[0]
        assert [track.x, track.y, track.z] == pytest.approx(expected(ELEVATION), abs=0.1)

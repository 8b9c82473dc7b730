"""``POST /localize``: known directions in, the same directions out, in the promised shape."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from service.api.upload import PIECE_BYTES

ARRAY = "respeaker-usb-4mic-v2"
CLASSICAL = {"method": "norm_music"}


def away(azimuth_deg: float, truth: float) -> float:
    return abs((azimuth_deg - truth + 180) % 360 - 180)


def strongest(answer: dict[str, Any]) -> float:
    return float(answer["summary"]["sources"][0]["azimuth_deg"])


@pytest.mark.parametrize("method", ["norm_music", "music", "srp_phat", "gcc_phat"])
def test_a_plane_wave_comes_from_where_it_came(localize: Any, sounds: Any, method: str) -> None:
    answer = localize.raw(sounds.wav(77.0), method=method).json()
    assert answer["method"] == method
    assert away(strongest(answer), 77.0) <= 2
    for window in answer["windows"]:
        assert away(window["sources"][0]["azimuth_deg"], 77.0) <= 2


def test_the_default_method_finds_a_plane_wave(localize: Any, sounds: Any) -> None:
    answer = localize.raw(sounds.wav(213.0)).json()
    assert away(strongest(answer), 213.0) <= 5
    assert (answer["model"] is not None) == (answer["method"] == "neural")


def test_the_answer_has_the_promised_shape(localize: Any, sounds: Any) -> None:
    answer = localize.raw(sounds.wav(seconds=1.2), **CLASSICAL, spectrum="true").json()
    assert list(answer) == ["model", "method", "audio", "array", "windows", "summary", "warnings"]
    assert answer["model"] is None
    assert answer["audio"] == {"sample_rate": 16000, "channels": 4, "duration_s": 1.2}
    assert answer["array"]["name"] == ARRAY
    assert answer["array"]["positions_m"][0] == [0.02285, 0.02285, 0.0]
    assert answer["array"]["channel_map"] == [0, 1, 2, 3]
    window = answer["windows"][0]
    assert list(window) == ["t_start", "t_end", "num_sources", "sources", "spectrum"]
    assert (window["t_start"], window["t_end"]) == (0.0, 1.024)
    assert window["num_sources"] == len(window["sources"])
    assert list(window["sources"][0]) == [
        "azimuth_deg",
        "confidence",
        "id",
        "elevation_deg",
        "unit_vector",
    ]
    assert len(window["spectrum"]) == 360
    assert away(float(np.argmax(window["spectrum"])), 77.0) <= 2
    assert list(answer["summary"]["sources"][0]) == [
        "azimuth_deg",
        "confidence",
        "share",
        "elevation_deg",
    ]


def test_a_form_and_a_raw_body_give_the_same_answer(localize: Any, sounds: Any) -> None:
    options = {**CLASSICAL, "hop_s": "0.3", "num_sources": "1", "channel_map": "3,2,1,0"}
    raw = localize.raw(sounds.wav(), **options)
    form = localize.form(sounds.wav(), **options)
    assert raw.status_code == form.status_code == 200
    assert raw.json() == form.json()
    assert raw.json()["array"]["channel_map"] == [3, 2, 1, 0]


def test_a_body_may_come_in_many_small_pieces(client: Any, localize: Any, sounds: Any) -> None:
    """More of them than are handed on at a time, and a rest."""
    options = {**CLASSICAL, "hop_s": "2"}
    recording = sounds.wav(seconds=12.0)
    assert PIECE_BYTES < len(recording) < 2 * PIECE_BYTES
    pieces = (recording[at : at + 4999] for at in range(0, len(recording), 4999))
    headers, params = {"Content-Type": "audio/wav"}, {"array": ARRAY, **options}
    raw = client.post("/localize", content=pieces, headers=headers, params=params)
    assert raw.json() == localize.form(recording, **options).json()
    assert raw.json()["audio"]["duration_s"] == 12.0


def test_options_may_be_in_the_query_beside_a_form(client: Any, sounds: Any) -> None:
    response = client.post(
        "/localize",
        params={"array": ARRAY, "method": "music"},
        files={"audio": ("a.wav", sounds.wav())},
        data={"num_sources": "1"},
    )
    assert response.json()["method"] == "music"


@pytest.mark.parametrize("rate", [8_000, 16_000, 44_100, 48_000])
def test_any_sample_rate_will_do(localize: Any, sounds: Any, rate: int) -> None:
    body = sounds.wav(310.0, rate=rate)
    answer = localize.raw(body, **CLASSICAL, num_sources=1).json()
    assert answer["audio"]["sample_rate"] == rate
    assert away(strongest(answer), 310.0) <= 3


@pytest.mark.parametrize(
    ("kind", "subtype", "media_type"),
    [
        ("WAV", "PCM_24", "audio/x-wav"),
        ("WAV", "FLOAT", "audio/wav; codecs=1"),
        ("FLAC", "PCM_16", "audio/flac"),
        ("AIFF", "PCM_16", "application/octet-stream"),
    ],
)
def test_any_format_will_do(
    localize: Any, sounds: Any, kind: str, subtype: str, media_type: str
) -> None:
    body = sounds.file(sounds.plane_wave(120.0), kind=kind, subtype=subtype)
    answer = localize.raw(body, media_type, **CLASSICAL).json()
    assert away(strongest(answer), 120.0) <= 2


def test_a_channel_map_picks_the_microphones(localize: Any, sounds: Any) -> None:
    wave = sounds.plane_wave(200.0)
    processed, playback = np.zeros((2, len(wave), 1), np.float32)
    body = sounds.file(np.concatenate([processed, wave, playback], axis=1))
    answer = localize.raw(body, **CLASSICAL, channel_map="[1, 2, 3, 4]").json()
    assert answer["audio"]["channels"] == 6
    assert away(strongest(answer), 200.0) <= 2


def test_a_geometry_stands_in_for_a_preset(localize: Any, sounds: Any, client: Any) -> None:
    presets = client.get("/arrays").json()["arrays"]
    positions = next(array["positions_m"] for array in presets if array["name"] == ARRAY)
    array = json.dumps({"name": "my robot", "positions_m": positions})
    answer = localize.form(sounds.wav(15.0), array=array, **CLASSICAL).json()
    assert answer["array"]["name"] == "my robot"
    assert away(strongest(answer), 15.0) <= 2


def test_a_geometry_turned_by_ninety_degrees_turns_the_answer(localize: Any, sounds: Any) -> None:
    side = 0.02285
    turned = [[-side, side, 0], [-side, -side, 0], [side, -side, 0], [side, side, 0]]
    array = json.dumps({"positions_m": turned})
    answer = localize.raw(sounds.wav(15.0), array=array, **CLASSICAL).json()
    assert away(strongest(answer), 105.0) <= 2


def test_a_recording_shorter_than_a_window_is_one_window(localize: Any, sounds: Any) -> None:
    answer = localize.raw(sounds.wav(seconds=0.3), **CLASSICAL).json()
    (window,) = answer["windows"]
    assert (window["t_start"], window["t_end"]) == (0.0, 0.3)
    assert away(window["sources"][0]["azimuth_deg"], 77.0) <= 3


def test_digital_silence_has_no_sources(localize: Any, sounds: Any) -> None:
    answer = localize.raw(sounds.file(np.zeros((32_000, 4), np.float32))).json()
    assert answer["windows"]
    assert all(window["sources"] == [] for window in answer["windows"])
    assert answer["summary"]["sources"] == []


def test_windows_and_hops_are_as_asked(localize: Any, sounds: Any) -> None:
    answer = localize.raw(sounds.wav(seconds=2.0), **CLASSICAL, window_s=0.5, hop_s=0.25).json()
    starts = [window["t_start"] for window in answer["windows"]]
    assert starts[:3] == [0.0, 0.25, 0.5]
    assert answer["windows"][0]["t_end"] == 0.5


def test_a_known_number_of_sources_is_kept(localize: Any, sounds: Any) -> None:
    answer = localize.raw(sounds.wav(), **CLASSICAL, num_sources=1, max_sources=3).json()
    assert {window["num_sources"] for window in answer["windows"]} == {1}


@pytest.mark.parametrize("value", ["true", "1", "True"])
def test_a_spectrum_comes_only_on_request(localize: Any, sounds: Any, value: str) -> None:
    with_spectrum = localize.raw(sounds.wav(), **CLASSICAL, spectrum=value).json()
    without = localize.raw(sounds.wav(), **CLASSICAL, spectrum="false").json()
    assert all("spectrum" in window for window in with_spectrum["windows"])
    assert not any("spectrum" in window for window in without["windows"])


def test_azimuths_turn_with_the_yaw_and_sectors_are_left_out(localize: Any, sounds: Any) -> None:
    recording = sounds.wav(77.0)
    turned = localize.raw(recording, method="norm_music", yaw_deg=-90, spectrum=True).json()
    source = turned["windows"][0]["sources"][0]
    assert abs(source["azimuth_deg"] - 347) < 3
    angle = np.deg2rad(source["azimuth_deg"])
    assert source["unit_vector"] == pytest.approx([np.cos(angle), np.sin(angle), 0], abs=1e-4)
    assert source["elevation_deg"] is None
    assert abs(int(np.argmax(turned["windows"][0]["spectrum"])) - 347) < 3
    assert abs(turned["summary"]["sources"][0]["azimuth_deg"] - 347) < 3
    left = localize.raw(recording, method="norm_music", yaw_deg=-90, exclude_deg="340:355").json()
    assert not any(window["sources"] for window in left["windows"])


@pytest.mark.parametrize("sectors", ["5", "5:5", "0:360", "a:b", "1:2:3", "0:999", ""])
def test_sectors_that_are_none_are_refused(sectors: str, localize: Any, sounds: Any) -> None:
    response = localize.raw(sounds.wav(), exclude_deg=sectors)
    assert (response.status_code, response.json()["code"]) == (422, "option_invalid")
    assert "exclude_deg" in response.json()["detail"]


def test_one_talker_has_one_id_in_all_windows(localize: Any, sounds: Any) -> None:
    windows = localize.raw(sounds.wav(77.0, seconds=5.0), method="norm_music").json()["windows"]
    ids = [source["id"] for window in windows for source in window["sources"]]
    assert len(ids) >= 8
    assert set(ids[2:]) == {1}

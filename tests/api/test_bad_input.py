"""Bad input: each its own 4xx problem, with a stable code and a sentence that says what to do."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from typing import Any

import httpx2
import numpy as np
import pytest

Body = Callable[[Any], bytes]


def good(sounds: Any) -> bytes:
    return bytes(sounds.wav(seconds=0.2))


def noise(sounds: Any, channels: int, frames: int = 3200, subtype: str = "PCM_16") -> bytes:
    samples = 0.1 * np.random.default_rng(0).standard_normal((frames, channels))
    return bytes(sounds.file(samples.astype(np.float32), subtype=subtype))


def with_sample(value: float) -> Body:
    def body(sounds: Any) -> bytes:
        samples = sounds.plane_wave(77.0, seconds=0.2)
        samples[1600, 2] = value
        return bytes(sounds.file(samples, subtype="FLOAT"))

    return body


def with_header(place: int, value: int) -> Body:
    def body(sounds: Any) -> bytes:
        content = bytearray(good(sounds))
        struct.pack_into("<I", content, place, value)
        return bytes(content)

    return body


SAMPLE_RATE, DATA_SIZE = 24, 40  # places in a WAV header


def assert_problem(response: httpx2.Response, status: int, code: str, says: str = "") -> None:
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    problem = response.json()
    assert list(problem) == ["type", "title", "status", "detail", "code"]
    assert problem["type"] == f"urn:neuralmusic:problem:{code}"
    assert (problem["status"], problem["code"]) == (status, code)
    assert says in problem["detail"]


@pytest.mark.parametrize(
    ("body", "status", "code", "says"),
    [
        pytest.param(lambda _: b"hello " * 99, 415, "not_audio", "WAV, FLAC", id="text"),
        pytest.param(lambda _: b"", 422, "audio_missing", "curl -F audio=@", id="empty body"),
        pytest.param(
            lambda s: good(s)[:5000], 422, "audio_truncated", "whole file", id="truncated WAV"
        ),
        pytest.param(
            lambda s: s.file(s.plane_wave(7.0), kind="FLAC")[:9000],
            422,
            "audio_truncated",
            "cannot be decoded beyond",
            id="truncated FLAC",
        ),
        pytest.param(lambda s: noise(s, 4, 0), 422, "audio_empty", "no samples", id="zero frames"),
        pytest.param(
            lambda s: noise(s, 1), 422, "channel_mismatch", "1 channel,", id="one channel"
        ),
        pytest.param(lambda s: noise(s, 5), 422, "channel_mismatch", "channel_map", id="five"),
        pytest.param(lambda s: noise(s, 8), 422, "channel_mismatch", "the 4 channels", id="eight"),
        pytest.param(lambda s: noise(s, 65), 422, "too_many_channels", "at most 64", id="65"),
        pytest.param(with_sample(np.nan), 422, "audio_non_finite", "channel 2 is nan", id="NaN"),
        pytest.param(with_sample(np.inf), 422, "audio_non_finite", "channel 2 is inf", id="inf"),
        pytest.param(
            with_header(SAMPLE_RATE, 1), 422, "sample_rate_unsupported", "is 1 Hz", id="1 Hz"
        ),
        pytest.param(
            with_header(SAMPLE_RATE, 10**7),
            422,
            "sample_rate_unsupported",
            "10000000 Hz",
            id="10 MHz",
        ),
        pytest.param(
            with_header(DATA_SIZE, 0xFFFF_FFFF),
            422,
            "audio_truncated",
            "promises 4294967295 bytes",
            id="4 GiB in the header",
        ),
        pytest.param(
            lambda s: noise(s, 2, 21 * 16_000), 413, "audio_too_long", "21 s", id="too long"
        ),
        pytest.param(
            lambda s: noise(s, 4, 17 * 16_000), 413, "upload_too_large", "2097152", id="too large"
        ),
    ],
)
@pytest.mark.parametrize("how", ["raw", "form"])
def test_a_bad_recording(
    localize: Any, sounds: Any, body: Body, status: int, code: str, says: str, how: str
) -> None:
    assert_problem(getattr(localize, how)(body(sounds)), status, code, says)


def positions(*points: tuple[float, ...]) -> str:
    return json.dumps({"positions_m": points})


SQUARE = ((1, 1, 0), (-1, 1, 0), (-1, -1, 0), (1, -1, 0))


@pytest.mark.parametrize(
    ("options", "code", "says"),
    [
        ({"array": "respeaker"}, "array_unknown", "respeaker-usb-4mic-v2"),
        # 64,000 digits and a letter once took two minutes, in which nobody else was answered.
        ({"yaw_deg": "1" * 64_000 + "x"}, "option_invalid", "must be an angle"),
        ({"yaw_deg": "0" * 65}, "option_invalid", "must be an angle"),
        ({"exclude_deg": ",".join(["1:2"] * 17)}, "option_invalid", "at most 16 sectors"),
        ({"array": ""}, "option_invalid", "array is empty"),
        ({"array": '{"positions_m": [[0, 0'}, "option_invalid", "not valid JSON"),
        ({"array": "[[0,0,0],[1,0,0]]"}, "option_invalid", "positions_m"),
        ({"array": "[" * 20_000}, "option_invalid", "JSON"),
        ({"array": '{"positions": []}'}, "option_invalid", "no field 'positions'"),
        ({"array": "{}"}, "option_invalid", "positions_m"),
        ({"array": '{"name": 3}'}, "option_invalid", "name"),
        ({"array": '{"name": "nobody"}'}, "array_unknown", "no array preset"),
        ({"array": '{"name": "\\ud800"}'}, "option_invalid", "printable"),
        (
            {"array": '{"name": "\\ud800", "positions_m": [[0.1, 0, 0], [0, 0, 0]]}'},
            "option_invalid",
            "printable",
        ),
        ({"array": '{"positions_m": 3}'}, "geometry_invalid", "list with one [x, y, z]"),
        ({"array": positions((0.1, 0), (0, 0))}, "geometry_invalid", "z = 0"),
        ({"array": '{"positions_m": [["0", 0, 0], [1, 0, 0]]}'}, "geometry_invalid", "numbers"),
        ({"array": '{"positions_m": [[NaN, 0, 0], [1, 0, 0]]}'}, "geometry_invalid", "finite"),
        ({"array": '{"positions_m": [[1e999, 0, 0], [1, 0, 0]]}'}, "geometry_invalid", "finite"),
        (
            {"array": f'{{"positions_m": [[1{"0" * 400}, 0, 0], [1, 0, 0]]}}'},
            "geometry_invalid",
            "finite",
        ),
        ({"array": positions()}, "geometry_invalid", "2 to 64 microphones"),
        ({"array": positions(*SQUARE * 17)}, "geometry_invalid", "at most 64"),
        (
            {"array": positions(*((23 * x, 23 * y, 0) for x, y, _ in SQUARE))},
            "geometry_invalid",
            "divide them by 1000",
        ),
        ({"array": positions(*SQUARE[:1] * 4)}, "geometry_invalid", "same point"),
        ({"channel_map": "0,1,2"}, "channel_map_invalid", "4 microphones"),
        ({"channel_map": "0,1,2,2"}, "channel_map_invalid", "twice"),
        ({"channel_map": "-1,0,1,2"}, "channel_map_invalid", "from 0"),
        ({"channel_map": "1,2,3,4"}, "channel_mismatch", "0 to 3"),
        ({"channel_map": "[0,1"}, "option_invalid", "1,2,3,4"),
        ({"channel_map": "a,b,c,d"}, "option_invalid", "1,2,3,4"),
        ({"channel_map": "[true,1,2,3]"}, "option_invalid", "1,2,3,4"),
        ({"channel_map": "0.0,1,2,3"}, "option_invalid", "1,2,3,4"),
        ({"model": "nobody"}, "model_unknown", "'nobody'"),
        ({"model": "nobody", "method": "music"}, "model_unknown", "'nobody'"),
        ({"method": "beamforming"}, "method_unknown", "norm_music, music, srp_phat"),
        ({"num_sources": "4"}, "too_many_sources", "at most 3"),
        ({"num_sources": "99"}, "too_many_sources", "at most 3"),
        ({"num_sources": "0"}, "option_invalid", "from 1"),
        ({"num_sources": "two"}, "option_invalid", 'but is "two"'),
        ({"num_sources": "1.0"}, "option_invalid", "whole number"),
        ({"max_sources": "5"}, "option_invalid", "at most 4"),
        ({"max_sources": "-1"}, "option_invalid", "from 1"),
        ({"window_s": "0.1"}, "option_invalid", "from 0.128 to 10"),
        ({"window_s": "nan"}, "option_invalid", "number"),
        ({"hop_s": "0"}, "option_invalid", "from 0.02 to 10"),
        ({"hop_s": "1e9"}, "option_invalid", "from 0.02 to 10"),
        ({"hop_s": "1_0"}, "option_invalid", "number"),
        ({"spectrum": "perhaps"}, "option_invalid", "true, false or sphere"),
        ({"windows_s": "1"}, "option_invalid", "did you mean window_s?"),
        ({"array": ["xvf3800-4mic"] * 2}, "option_invalid", "given twice"),
    ],
)
@pytest.mark.parametrize("how", ["raw", "form"])
def test_a_bad_option(
    localize: Any, sounds: Any, options: dict[str, Any], code: str, says: str, how: str
) -> None:
    assert_problem(getattr(localize, how)(good(sounds), **options), 422, code, says)


def test_an_array_has_no_default(client: Any, sounds: Any) -> None:
    response = client.post("/localize", files={"audio": good(sounds)})
    assert_problem(response, 422, "option_invalid", "respeaker-usb-4mic-v2, respeaker-4mic-hat")


def test_the_same_option_in_query_and_form(client: Any, sounds: Any) -> None:
    array = {"array": "respeaker-usb-4mic-v2"}
    response = client.post("/localize", params=array, data=array, files={"audio": good(sounds)})
    assert_problem(response, 422, "option_invalid", "array was given twice")


@pytest.mark.parametrize(
    ("request_parts", "status", "code", "says"),
    [
        ({"data": {"audio": "@a.wav"}, "files": {"x": b""}}, 422, "audio_missing", "not a file"),
        ({"files": {"file": b"RIFF"}}, 422, "option_invalid", "'file': only 'audio' is a file"),
        ({"files": {"array": (None, "xvf3800-4mic")}}, 422, "audio_missing", "no file field"),
        (
            {"files": [("audio", b"RIFF"), ("audio", b"RIFF")]},
            422,
            "option_invalid",
            "audio was given twice",
        ),
        ({"files": {"audio": b""}}, 422, "audio_missing", "0 bytes"),
        ({"data": {"array": "xvf3800-4mic"}}, 415, "media_type_unsupported", "--data-binary"),
        ({"json": {}}, 415, "media_type_unsupported", "application/json"),
        (
            {"content": b"x", "headers": {"Content-Type": "multipart/form-data"}},
            400,
            "upload_invalid",
            "boundary",
        ),
        (
            {"content": b"x", "headers": {"Content-Type": "multipart/form-data; boundary=y"}},
            400,
            "upload_invalid",
            "multipart",
        ),
        (
            {"files": {"audio": b"RIFF"}, "data": {str(i): "" for i in range(40)}},
            400,
            "upload_invalid",
            "Too many fields",
        ),
        (
            {"files": {"audio": b"RIFF"}, "data": {"array": "x" * 100_000}},
            400,
            "upload_invalid",
            "exceeded maximum size",
        ),
    ],
)
def test_a_bad_body(
    client: Any, request_parts: dict[str, Any], status: int, code: str, says: str
) -> None:
    assert_problem(client.post("/localize", **request_parts), status, code, says)


@pytest.mark.parametrize("charset", ["punycode", "undefined", "unicode_escape", "utf-16", "x" * 99])
def test_a_form_is_utf_8_or_refused(client: Any, charset: str) -> None:
    """Some of Python's codecs raise errors of their own, others give text that is none."""
    form = b'--y\r\nContent-Disposition: form-data; name="array"\r\n\r\n\\ud800\xff\r\n--y--\r\n'
    media_type = f"multipart/form-data; boundary=y; charset={charset}"
    response = client.post("/localize", content=form, headers={"Content-Type": media_type})
    assert_problem(response, 400, "upload_invalid", "send UTF-8")


@pytest.mark.parametrize("charset", ["utf-8", "UTF-8", "us-ascii"])
def test_a_form_may_say_that_it_is_utf_8(localize: Any, sounds: Any, charset: str) -> None:
    request = localize.client.build_request(
        "POST", "/localize", files={"audio": good(sounds)}, data={"array": "xvf3800-4mic"}
    )
    request.headers["Content-Type"] += f"; charset={charset}"
    assert localize.client.send(request).status_code == 200


def test_a_body_without_a_length_is_counted(client: Any) -> None:
    chunks = (bytes(2**20) for _ in range(3))
    headers = {"Content-Type": "audio/wav"}
    response = client.post("/localize", content=chunks, headers=headers)
    assert "content-length" not in response.request.headers
    assert_problem(response, 413, "upload_too_large", "2097152 bytes")


@pytest.mark.parametrize(
    ("method", "path", "status", "code", "says"),
    [
        ("GET", "/nothing", 404, "not_found", "nothing at /nothing"),
        ("GET", "/localize", 405, "method_not_allowed", "takes POST"),
        ("DELETE", "/models", 405, "method_not_allowed", "takes GET, not DELETE"),
        ("POST", "/", 405, "method_not_allowed", "takes GET, HEAD, not POST"),
        ("POST", "/noise/x", 405, "method_not_allowed", "takes GET, PUT, DELETE, not POST"),
    ],
)
def test_a_wrong_path_or_method(
    client: Any, method: str, path: str, status: int, code: str, says: str
) -> None:
    response = client.request(method, path)
    assert_problem(response, status, code, says)
    if status == 405:
        assert response.headers["allow"] in says


def test_a_large_length_is_refused_on_every_path(client: Any) -> None:
    response = client.post("/livez", headers={"Content-Length": str(2**40)})
    assert_problem(response, 413, "upload_too_large", "2097152 bytes")


@pytest.mark.parametrize("method", ["neural", "norm_music", "music", "srp_phat"])
@pytest.mark.parametrize("scale", [1e7, 1e-20, 1e-44])
def test_extreme_but_finite_samples_are_no_server_error(
    localize: Any, sounds: Any, method: str, scale: float
) -> None:
    samples = (scale * sounds.plane_wave(77.0, seconds=0.2)).astype(np.float32)
    response = localize.raw(sounds.file(samples, subtype="FLOAT"), method=method)
    assert response.status_code == (200 if localize.has_model or method != "neural" else 422)

"""Recordings: headers are not believed, blocks add up, delays between channels survive."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pytest
import soundfile
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from neuralmusic import errors
from service.audio.recording import AudioLimits, Recording

RATE = 16_000
RIFF_SIZE, CHANNELS, SAMPLE_RATE, DATA_SIZE = 4, 22, 24, 40  # places in a canonical WAV header


def noise(seconds: float = 1.0, channels: int = 4, rate: int = RATE) -> NDArray[np.float32]:
    samples = np.random.default_rng(0).standard_normal((round(seconds * rate), channels))
    return (0.1 * samples).astype(np.float32)


def encoded(
    samples: NDArray[np.float32], rate: int = RATE, kind: str = "WAV", subtype: str = "PCM_16"
) -> bytes:
    file = io.BytesIO()
    soundfile.write(file, samples, rate, format=kind, subtype=subtype)
    return file.getvalue()


def patched(content: bytes, **places: tuple[int, str, int]) -> bytes:
    changed = bytearray(content)
    for place, form, value in places.values():
        struct.pack_into(form, changed, place, value)
    return bytes(changed)


def opened(content: bytes, limits: AudioLimits | None = None) -> Recording:
    return Recording.open(io.BytesIO(content), limits)


def decoded(content: bytes, channels: tuple[int, ...], rate: int = RATE) -> NDArray[np.float32]:
    with opened(content) as recording:
        return np.concatenate(list(recording.blocks(channels, rate)), axis=1)


@pytest.mark.parametrize(
    ("kind", "subtype", "tolerance"),
    [
        ("WAV", "PCM_16", 1e-4),
        ("WAV", "PCM_24", 1e-6),
        ("WAV", "PCM_32", 1e-6),
        ("WAV", "FLOAT", 0),
        ("WAV", "DOUBLE", 0),
        ("WAVEX", "PCM_16", 1e-4),
        ("RF64", "PCM_16", 1e-4),
        ("AIFF", "PCM_16", 1e-4),
        ("FLAC", "PCM_24", 1e-6),
    ],
)
def test_every_format_gives_the_channels_in_the_order_asked_for(
    kind: str, subtype: str, tolerance: float
) -> None:
    samples = noise()
    audio = decoded(encoded(samples, kind=kind, subtype=subtype), (3, 0, 1))
    assert audio.dtype == np.float32
    np.testing.assert_allclose(audio, samples.T[[3, 0, 1]], atol=tolerance)


def test_the_header_is_known_before_decoding() -> None:
    with opened(encoded(noise(0.5, 6, 48_000), 48_000)) as recording:
        assert (recording.channels, recording.sample_rate) == (6, 48_000)
        assert (recording.num_frames, recording.duration) == (24_000, 0.5)


@pytest.mark.parametrize("rate", [4_000, 8_000, 22_050, 44_100, 48_000, 96_000])
def test_resampled_blocks_add_up_to_the_whole_recording(rate: int) -> None:
    audio = decoded(encoded(noise(5.0, 2, rate), rate), (0, 1))
    assert abs(audio.shape[1] - 5 * RATE) <= 1


@pytest.mark.parametrize("rate", [8_000, 44_100, 48_000])
def test_resampling_keeps_the_delay_between_channels(rate: int) -> None:
    seconds, frequency, delay = 5.0, 440.0, 61e-6
    time = np.arange(round(seconds * rate)) / rate
    pair = np.stack([np.sin(2 * np.pi * frequency * (time - d)) for d in (0, delay)], axis=-1)
    first, second = decoded(encoded(pair.astype(np.float32), rate, subtype="FLOAT"), (0, 1))
    tone = np.exp(-2j * np.pi * frequency * np.arange(first.size) / RATE) * np.hanning(first.size)
    phase = np.angle(np.vdot(second @ tone, first @ tone))
    assert phase / (2 * np.pi * frequency) == pytest.approx(delay, abs=1e-8)


def test_resampling_in_blocks_leaves_no_seams() -> None:
    time = np.arange(5 * 48_000) / 48_000
    tone = np.sin(2 * np.pi * 997 * time).astype(np.float32)
    (audio,) = decoded(encoded(tone[:, None], 48_000, subtype="FLOAT"), (0,))
    expected = np.sin(2 * np.pi * 997 * np.arange(audio.size) / RATE)
    edge = RATE // 10
    np.testing.assert_allclose(audio[edge:-edge], expected[edge:-edge], atol=1e-4)


def test_a_block_can_be_had_without_reading_the_whole_file() -> None:
    class Counting(io.BytesIO):
        taken = 0

        def read(self, size: int | None = -1, /) -> bytes:
            content = super().read(size)
            self.taken += len(content)
            return content

    content = encoded(noise(20.0, 2))
    file = Counting(content)
    with Recording.open(file) as recording:
        assert file.taken < 0.05 * len(content)
        first = next(recording.blocks((0, 1), RATE))
        assert first.shape[1] <= 4 * RATE
        assert file.taken < 0.25 * len(content)


def test_a_recording_can_be_decoded_twice() -> None:
    with opened(encoded(noise(3.0))) as recording:
        first, second = (np.hstack(list(recording.blocks((0,), RATE))) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_a_path_is_opened_and_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "noise.raw"  # a name that soundfile would take for headerless samples
    path.write_bytes(encoded(noise()))
    file = path.open("rb")
    monkeypatch.setattr(Path, "open", lambda self, mode: file)
    with Recording.open(path) as recording:
        assert recording.num_frames == RATE
        assert not file.closed
    assert file.closed


WAV = encoded(noise())
FLAC = encoded(noise(3.0), kind="FLAC")
NAN, INF = noise(), noise()
NAN[12_000, 2], INF[8_000, 3] = np.nan, -np.inf


@pytest.mark.parametrize(
    ("content", "error", "says"),
    [
        pytest.param(b"", errors.NotAudio, "libsndfile", id="nothing"),
        pytest.param(b"hello " * 1000, errors.NotAudio, "libsndfile", id="text"),
        pytest.param(bytes(20_000), errors.NotAudio, "libsndfile", id="zeros"),
        pytest.param(noise().tobytes(), errors.NotAudio, "header", id="headerless samples"),
        pytest.param(
            patched(WAV, c=(CHANNELS, "<H", 0)), errors.NotAudio, "", id="no channel in header"
        ),
        pytest.param(encoded(noise(0)), errors.EmptyAudio, "no samples", id="no frames"),
        pytest.param(
            patched(WAV, d=(DATA_SIZE, "<I", 0)),
            errors.EmptyAudio,
            "did not finish",
            id="never closed",
        ),
        pytest.param(WAV[: len(WAV) // 2], errors.TruncatedAudio, "whole file", id="half a WAV"),
        pytest.param(WAV[:-9], errors.TruncatedAudio, "whole file", id="last frame missing"),
        pytest.param(WAV[:30], errors.TruncatedAudio, "before its audio", id="half a header"),
        pytest.param(
            patched(WAV, d=(DATA_SIZE, "<I", 0xFFFF_FFFF)),
            errors.TruncatedAudio,
            "4294967295 bytes",
            id="4 GiB",
        ),
        pytest.param(
            patched(WAV, d=(DATA_SIZE, "<I", 0x7FFF_FF00)),
            errors.TruncatedAudio,
            "2147483392",
            id="2 GiB, but not by a pipe",
        ),
        *(
            pytest.param(
                encoded(noise(), kind=kind)[:-999],
                errors.TruncatedAudio,
                "promises a file",
                id=f"half a {kind}",
            )
            for kind in ("AIFF", "AU", "W64")
        ),
        pytest.param(
            encoded(noise(), kind="RF64")[:-999], errors.TruncatedAudio, "whole", id="half an RF64"
        ),
        pytest.param(
            patched(WAV, c=(CHANNELS, "<H", 65_535)),
            errors.TooManyChannels,
            "65535 channels",
            id="65535 channels",
        ),
        pytest.param(
            encoded(noise(0.1, 65)), errors.TooManyChannels, "at most 64", id="65 channels"
        ),
        *(
            pytest.param(
                patched(WAV, s=(SAMPLE_RATE, "<I", rate)),
                errors.UnsupportedSampleRate,
                f"{rate} Hz",
                id=f"{rate} Hz",
            )
            for rate in (0, 1, 10_000_000, 0xFFFF_FFFF)
        ),
        pytest.param(
            patched(FLAC, n=(22, ">I", 0xFFFF_FFFF)),
            errors.AudioTooLong,
            "268435 s",
            id="FLAC that promises days",
        ),
    ],
)
def test_a_bad_header_is_refused_when_opened(
    content: bytes, error: type[errors.DoaError], says: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(error) as caught:
        opened(content)
    assert says in caught.value.detail
    assert capfd.readouterr() == ("", "")  # libsndfile's callbacks print what they raise


@pytest.mark.parametrize(
    ("content", "error", "says"),
    [
        pytest.param(
            encoded(NAN, subtype="FLOAT"), errors.NonFiniteAudio, "channel 2 is nan at 0.750 s"
        ),
        pytest.param(
            encoded(INF, subtype="DOUBLE"), errors.NonFiniteAudio, "channel 3 is -inf at 0.500"
        ),
        pytest.param(
            encoded(np.full((9, 4), 3e38, np.float32), subtype="FLOAT"),
            errors.NonFiniteAudio,
            "3e.38",
            id="beyond all powers",
        ),
        pytest.param(FLAC[: len(FLAC) // 2], errors.TruncatedAudio, "3.00 s", id="half a FLAC"),
        pytest.param(
            FLAC[:-3000] + bytes(3000), errors.TruncatedAudio, "3.00 s", id="FLAC with a bad tail"
        ),
    ],
)
def test_a_bad_body_is_refused_while_decoding(
    content: bytes, error: type[errors.DoaError], says: str
) -> None:
    with opened(content) as recording, pytest.raises(error, match=says):
        list(recording.blocks((3, 2), RATE))


def test_bad_samples_of_channels_that_nobody_wants_do_no_harm() -> None:
    assert decoded(encoded(NAN, subtype="FLOAT"), (0, 1, 3)).shape == (3, RATE)


@pytest.mark.parametrize(
    ("riff", "size"),
    [
        (0x7FFF_F000, 0x7FFF_F000),
        (0x7FFF_FF24, 0x7FFF_FF00),  # sox
        (0x8000_0023, 0x7FFF_FFFF),
        (0x8000_0024, 0x8000_0000),  # arecord
        (0xFFFF_FFFF, 0xFFFF_FFFF),  # ffmpeg
        (0, 0),  # GStreamer
        (0, 0xFFFF_FFFF),
    ],
)
def test_a_wav_from_a_pipe_lasts_to_its_end(riff: int, size: int) -> None:
    content = patched(WAV, r=(RIFF_SIZE, "<I", riff), d=(DATA_SIZE, "<I", size))
    for audio in (content, content[:-3]):  # the pipe may end within a frame
        with opened(audio) as recording:
            assert recording.open_ended
            (block,) = recording.blocks((0, 1), RATE)
            assert not recording.open_ended or block.shape[1] >= RATE - 1
            np.testing.assert_array_equal(block, decoded(WAV, (0, 1))[:, : block.shape[1]])


@pytest.mark.parametrize("magic", [b"RF64", b"BW64"])
@pytest.mark.parametrize("length", [None, 0, 2**64 - 1])
def test_long_wavs_are_read_by_their_ds64(magic: bytes, length: int | None) -> None:
    size = len(WAV) - 44
    ds64 = struct.pack("<4sIQQQI", b"ds64", 28, 0, size if length is None else length, 0, 0)
    head = struct.pack("<4sI4s", magic, 0xFFFF_FFFF, b"WAVE")
    content = head + ds64 + WAV[12:40] + struct.pack("<I", 0xFFFF_FFFF) + WAV[44:]
    with opened(content) as recording:
        assert recording.open_ended == (length is not None)
    np.testing.assert_array_equal(decoded(content, (0, 1)), decoded(WAV, (0, 1)))


def test_an_odd_chunk_without_its_padding_is_skipped() -> None:
    note = b"LIST" + struct.pack("<I", 5) + b"hello"
    content = WAV[:36] + note + WAV[36:]
    np.testing.assert_array_equal(decoded(content, (0,)), decoded(WAV, (0,)))


def test_ambisonic_channels_are_refused_as_what_they_are() -> None:
    guid = struct.pack("<I", 1) + bytes.fromhex("2107d3118644c8c1ca000000")
    fmt = struct.pack("<4sI", b"fmt ", 40) + struct.pack("<H", 0xFFFE) + WAV[22:36]
    fmt += struct.pack("<HHI", 22, 16, 0) + guid
    content = WAV[:12] + fmt + WAV[36:]
    with pytest.raises(errors.NotAudio, match="ambisonic"):
        opened(content)


def test_chunks_before_the_audio_are_skipped() -> None:
    note = b"LIST" + struct.pack("<I", 5) + b"hello\0"  # odd, so one byte of padding
    content = WAV[:36] + note + WAV[36:]
    np.testing.assert_array_equal(decoded(content, (0,)), decoded(WAV, (0,)))


@pytest.mark.parametrize(
    ("limits", "error"),
    [
        (AudioLimits(max_seconds=0.9), errors.AudioTooLong),
        (AudioLimits(max_channels=3), errors.TooManyChannels),
        (AudioLimits(min_sample_rate=16_001), errors.UnsupportedSampleRate),
        (AudioLimits(max_sample_rate=15_999), errors.UnsupportedSampleRate),
    ],
)
def test_limits_hold_before_anything_is_decoded(
    limits: AudioLimits, error: type[errors.DoaError]
) -> None:
    with pytest.raises(error):
        opened(WAV, limits)
    exact = AudioLimits(4, 1.0, RATE, RATE)
    assert opened(WAV, exact).num_frames == RATE


def use(content: bytes) -> None:
    try:
        with opened(content) as recording:
            for block in recording.blocks((0,), RATE):
                assert np.isfinite(block).all()
    except errors.DoaError as error:
        assert 400 <= error.status < 500  # noqa: PT017 - most examples raise nothing


@pytest.mark.parametrize("kind", ["WAV", "FLAC", "AIFF"])
def test_damaged_bytes_never_give_another_error(
    kind: str, capfd: pytest.CaptureFixture[str]
) -> None:
    content = encoded(noise(0.1), kind=kind)

    @settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
    @given(st.lists(st.tuples(st.integers(0, 100), st.integers(0, 255)), max_size=4))
    def check(changes: list[tuple[int, int]]) -> None:
        damaged = bytearray(content)
        for place, value in changes:
            damaged[place] = value
        use(bytes(damaged))

    check()
    assert "Traceback" not in capfd.readouterr().err

"""The client's parts: addresses, delays, audio as messages, bounded queues."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scripted_service import ready, result

from neuralmusic import Backoff
from neuralmusic.addresses import service_url, stream_url
from neuralmusic.errors import AudioError, ChannelMismatch, InvalidOption
from neuralmusic.option_text import read_angle
from neuralmusic.protocol import MAX_MESSAGE_BYTES
from neuralmusic.protocol.client_messages import AudioFormat
from neuralmusic.protocol.framing import HEADER, FrameHeader
from neuralmusic.streams.audio import read_frames, split_frames
from neuralmusic.streams.inbox import Inbox
from neuralmusic.streams.send_queue import MAX_CONTROL, SendQueue


@pytest.mark.parametrize(
    ("url", "http", "socket"),
    [
        ("http://robot:8000", "http://robot:8000", "ws://robot:8000/stream"),
        ("robot:8000", "http://robot:8000", "ws://robot:8000/stream"),
        ("ws://robot/stream", "http://robot", "ws://robot/stream"),
        ("wss://a.b/doa/stream/", "https://a.b/doa", "wss://a.b/doa/stream"),
        (" https://a.b/doa/ ", "https://a.b/doa", "wss://a.b/doa/stream"),
        ("http://[::1]:80", "http://[::1]:80", "ws://[::1]:80/stream"),
    ],
)
def test_every_form_of_an_address(url: str, http: str, socket: str) -> None:
    assert (service_url(url), stream_url(url)) == (http, socket)


@pytest.mark.parametrize(
    "url", ["", "ftp://robot", "http://", "http://robot:99999", "http://[::1", "http://r:0"]
)
def test_what_is_no_address_is_refused(url: str) -> None:
    with pytest.raises(InvalidOption, match="not an address"):
        stream_url(url)


@pytest.mark.parametrize("url", ["http://r/stream?token=secret", "http://me:secret@r", "r#secret"])
def test_a_key_in_an_address_is_refused_and_not_repeated(url: str) -> None:
    with pytest.raises(InvalidOption, match="never in an address") as caught:
        stream_url(url)
    assert "secret" not in caught.value.detail


@given(attempt=st.integers(0, 10**6), share=st.floats(0, 1, exclude_max=True))
def test_delays_have_full_jitter_below_the_doubling_bound(attempt: int, share: float) -> None:
    backoff = Backoff(first_s=0.5, longest_s=30.0)
    bound = 0.5 * 2**attempt if attempt < 6 else 30.0
    assert backoff.delay_s(attempt, uniform=lambda: share) == pytest.approx(share * bound)


def test_retry_after_is_waited_for_within_reason() -> None:
    backoff = Backoff(first_s=1.0)
    assert backoff.delay_s(0, 7.0, uniform=lambda: 0.5) == 7.5
    assert backoff.delay_s(0, 10**6, uniform=lambda: 0.0) == 300.0
    assert backoff.delay_s(0, -5.0, uniform=lambda: 0.0) == 0.0


def audio_format(**changes: Any) -> AudioFormat:
    fields = {"encoding": "pcm_s16le", "sample_rate": 16_000, "channels": 4, "header": "none"}
    return AudioFormat(**{**fields, **changes})


@given(
    encoding=st.sampled_from(["pcm_s16le", "pcm_s24le", "pcm_s32le", "pcm_f32le"]),
    channels=st.integers(1, 64),
    rate=st.integers(4_000, 384_000),
    header=st.sampled_from(["none", "seq_time"]),
    frames=st.integers(0, 20_000),
)
def test_pieces_are_whole_frames_fit_a_message_and_lose_nothing(
    encoding: str, channels: int, rate: int, header: str, frames: int
) -> None:
    form = audio_format(encoding=encoding, channels=channels, sample_rate=rate, header=header)
    size = form.frame_bytes
    audio = np.random.default_rng(frames).bytes(frames * size)
    pieces = list(split_frames(read_frames(audio, form), form, 10**18))
    extra = HEADER.size if header == "seq_time" else 0
    assert b"".join(bytes(piece) for piece, _ in pieces) == audio
    assert all(len(piece) % size == 0 and piece for piece, _ in pieces)
    assert all(len(piece) + extra <= MAX_MESSAGE_BYTES for piece, _ in pieces)
    before = 0
    for piece, captured_ns in pieces:
        assert captured_ns - 10**18 == before * 10**9 // rate
        before += len(piece) // size


def test_arrays_are_read_as_their_bytes() -> None:
    channels_first = np.arange(40, dtype=np.int16).reshape(4, 10)
    form = audio_format()
    for audio in (channels_first.T, channels_first.T.copy(), channels_first.T.ravel()):
        assert bytes(read_frames(audio, form)) == channels_first.T.tobytes()
    whole = np.arange(8, dtype="<i4")
    assert read_frames(whole, audio_format(encoding="pcm_s32le")) == whole.tobytes()
    assert read_frames(bytearray(24), audio_format(encoding="pcm_s24le")) == bytes(24)


@pytest.mark.parametrize(
    ("audio", "problem", "sentence"),
    [
        (np.zeros((10, 4)), AudioError, "'d' with 8 bytes.*send int16"),
        (np.zeros((10, 4), np.float32), AudioError, "pcm_s16le was declared"),
        (np.zeros((10, 4), np.uint16), AudioError, "'H'"),
        (np.zeros((10, 4), ">i2"), AudioError, "'>h'"),
        ([1, 2, 3], AudioError, "list is not audio"),
        (np.zeros((4, 10), np.int16), ChannelMismatch, r"\(4, 10\).*transpose"),
        (np.zeros((2, 2, 4), np.int16), ChannelMismatch, "shape"),
        (np.zeros(10, np.int16), ChannelMismatch, "20 bytes are no whole number"),
        (bytes(9), ChannelMismatch, "9 bytes"),
    ],
)
def test_other_audio_than_declared_is_a_sentence(
    audio: Any, problem: type[Exception], sentence: str
) -> None:
    with pytest.raises(problem, match=sentence):
        read_frames(audio, audio_format())


def queue(**changes: Any) -> SendQueue:
    form = audio_format(channels=1, header="seq_time")
    options = {"capacity_s": 0.5, "drop": True, "wake": lambda: None, **changes}
    made = SendQueue(form, options.pop("capacity_s"), **options)
    made.begin()
    return made


@given(chunks=st.lists(st.one_of(st.integers(1, 5000), st.none()), max_size=60))
def test_what_is_not_sent_is_counted_and_leaves_a_gap(chunks: list[int | None]) -> None:
    """``None`` takes one message; numbers are sample frames that come in."""
    waiting, taken, put = queue(), [], 0
    for count in chunks:
        if count is None:
            taken.append(waiting.take())
        else:
            waiting.add_audio(bytes(2 * count))
            put += count
        assert waiting.waiting_s <= 0.5 + 0.1
    while (message := waiting.take()) is not None:
        taken.append(message)
    sent = [message for message in taken if message is not None]
    frames = sum(len(message) - HEADER.size for message in sent) // 2
    assert frames / 16_000 + waiting.dropped_s == pytest.approx(put / 16_000)
    sequences = [FrameHeader.unpack(message).sequence for message in sent]
    assert sequences == sorted(set(sequences))


def test_control_messages_keep_their_place_and_are_bounded() -> None:
    waiting = queue(capacity_s=0.1)
    waiting.add_text("before")
    for _ in range(5):
        waiting.add_audio(bytes(3200))
    waiting.add_text("after")
    messages = [waiting.take() for _ in range(4)]
    assert (messages[0], messages[2], messages[3]) == ("before", "after", None)
    assert FrameHeader.unpack(messages[1]).sequence == 4
    for index in range(MAX_CONTROL + 10):
        waiting.add_text(str(index))
    assert waiting.take() == "10"


def test_a_queue_that_drops_nothing_asks_for_room() -> None:
    waiting = queue(drop=False)
    waiting.add_audio(bytes(16_000))
    assert not waiting.has_room
    assert waiting.dropped_s == 0
    waiting.take()
    assert waiting.has_room
    waiting.end()
    assert waiting.dropped_s == pytest.approx(0.4)
    assert waiting.take() is None


def test_many_threads_fill_one_queue() -> None:
    waiting = queue(capacity_s=100.0)
    threads = [
        threading.Thread(target=lambda: [waiting.add_audio(bytes(2)) for _ in range(500)])
        for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    sequences = [FrameHeader.unpack(waiting.take()).sequence for _ in range(2000)]
    assert sequences == list(range(2000))


def test_a_wait_that_is_given_up_loses_nothing() -> None:
    async def wait_and_give_up() -> object:
        inbox = Inbox(3)
        waiting = asyncio.create_task(inbox.wait())
        await asyncio.sleep(0)
        inbox.put(result(1))
        await waiting  # whoever waited does not take it
        await inbox.wait(timeout_s=0)
        return inbox.take()

    assert asyncio.run(wait_and_give_up()) == result(1)


def test_results_make_room_for_what_is_said_once() -> None:
    inbox = Inbox(3)
    inbox.put(ready())
    for seq in range(5):
        inbox.put(result(seq))
    assert [event.seq for event in (inbox.take(), inbox.take(), inbox.take())] == [0, 3, 4]
    assert (inbox.take(), inbox.results_dropped, inbox.ended) == (None, 3, False)
    inbox.put(result(9))
    inbox.end(ValueError("over"))
    assert not inbox.ended
    assert inbox.take() == result(9)
    with pytest.raises(ValueError, match="over"):
        inbox.take()


@pytest.mark.parametrize(
    ("text", "degrees"), [("450", 450.0), ("-720.5", -720.5), ("1e300", 1e300)]
)
def test_a_yaw_as_text_is_any_finite_angle(text: str, degrees: float) -> None:
    assert read_angle(text) == degrees
    for wrong in ("1e999", "nan", "inf", "a"):
        with pytest.raises(ValueError, match="an angle in degrees"):
            read_angle(wrong)

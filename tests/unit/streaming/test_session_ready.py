"""What a session tells first, how large its messages may be, and its yaw."""

from __future__ import annotations

import numpy as np
import pytest

from .conftest import NewSession, pcm, start

CLASSICAL = start(method="norm_music")
SECOND = pcm(0.01 * np.random.default_rng(0).standard_normal((4, 16_000)))


def test_ready_comes_before_what_the_audio_sent_earlier_caused(new_session: NewSession) -> None:
    driver = new_session(eager=False)
    driver.send(CLASSICAL)
    driver.audio(bytes(8 * 16_000 * 6), 8 * 1600)  # 6 s overflow the buffer, and stats are due
    driver.send({"type": "ping", "id": 3})
    assert driver.messages == []
    driver.work()
    first = [message["type"] for message in driver.messages[:4]]
    assert first == ["ready", "warning", "stats", "pong"]
    assert [message["seq"] for message in driver.messages[:4]] == [0, 1, 2, 3]
    assert driver.all("result")[0]["session"] == driver.messages[0]["session"]


def test_a_start_that_fails_gets_its_error_before_any_warning(new_session: NewSession) -> None:
    driver = new_session(eager=False)
    driver.send(start(array={"name": "nobody"}))
    driver.audio(bytes(8 * 16_000 * 2), 8 * 1600)
    driver.work()
    assert [message["type"] for message in driver.messages] == ["error"]
    assert driver.messages[0]["seq"] == 0


@pytest.mark.parametrize(
    ("channels", "encoding", "size"), [(64, "pcm_s32le", 4), (4, "pcm_s16le", 2)]
)
def test_messages_of_20_ms_fit_at_64_channels_and_48_khz(
    channels: int, encoding: str, size: int, new_session: NewSession
) -> None:
    driver = new_session()
    audio = {
        "channels": channels,
        "encoding": encoding,
        "sample_rate": 48_000,
        "header": "seq_time",
    }
    driver.send(start(method="norm_music", audio=audio, channel_map=[0, 1, 2, 3]))
    driver.audio(bytes(16 + 960 * channels * size), 300_000)
    assert driver.session.state == "running"


@pytest.mark.parametrize("yaw_deg", [450.0, -270.0, 360_090.0])
def test_a_yaw_may_count_turns(yaw_deg: float, new_session: NewSession) -> None:
    told = []
    for yaw in (90.0, yaw_deg):
        driver = new_session()
        driver.send(start(method="norm_music", output={"yaw_deg": yaw, "include": ["spectrum"]}))
        driver.audio(SECOND)
        told.append(driver.all("result")[-1]["spectrum"])
    assert told[0] == told[1]

"""Keys: the file, the hash, roles, limits; time is given, never waited for."""

from __future__ import annotations

import hashlib
import json
import threading
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from neuralmusic.errors import (
    AudioQuota,
    AudioTooLong,
    ConfigError,
    DoaError,
    KeyExpired,
    KeyMissing,
    KeyUnknown,
    RoleMissing,
    TooManySessions,
    TooManyUploads,
)
from service.access.key_file import ROLES, TOKEN, Key, new_token, read_keys, token_sha256
from service.access.keys import ANYONE, Keys, matching
from service.access.usage import Usage

NOON = datetime(2030, 1, 1, 12, tzinfo=UTC)


class Clock:
    """Seconds that a test sets."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def entry(token: str, name: str = "robot-1", **fields: Any) -> dict[str, Any]:
    digest = hashlib.sha256(token.encode()).hexdigest()
    return {"name": name, "sha256": digest, "roles": ["stream"], **fields}


def write(path: Path, *entries: Any) -> Path:
    path.write_text("".join(f"{json.dumps(each)}\n" for each in entries))
    path.chmod(0o600)
    return path


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "keys.jsonl"


def test_tokens_have_256_bits_and_are_never_the_same() -> None:
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100
    assert all(TOKEN.fullmatch(token) for token in tokens)


def test_the_file_holds_what_sha256_gives() -> None:
    assert token_sha256("abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def test_a_token_finds_its_key_and_no_other_does(file: Path) -> None:
    one, two = new_token(), new_token()
    keys = Keys(write(file, entry(one), entry(two, "robot-2", max_sessions=2)))
    assert keys.authenticate(one).name == "robot-1"
    assert keys.authenticate(two).max_sessions == 2
    for wrong in (new_token(), one[:-1], one + "A", one.upper(), " " + one, "\udcff"):
        with pytest.raises(KeyUnknown):
            keys.authenticate(wrong)
    for nothing in (None, ""):
        with pytest.raises(KeyMissing):
            keys.authenticate(nothing)


def test_every_key_is_compared_whichever_is_the_right_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """No early exit: the time must not tell how far down the file a key is."""
    keys = [Key.model_validate(entry(str(number), f"k{number}")) for number in range(5)]
    compared: list[str] = []

    def count(one: str, other: str) -> bool:
        compared.append(one)
        return one == other

    monkeypatch.setattr("service.access.keys.hmac.compare_digest", count)
    for wanted in ("0", "4", "none"):
        compared.clear()
        found = matching(keys, token_sha256(wanted))
        assert (found.name if found else "none") == f"k{wanted}".replace("knone", "none")
        assert compared == [key.sha256 for key in keys]


def test_without_a_file_everybody_may_do_everything() -> None:
    keys = Keys()
    assert not keys.needed
    assert keys.authenticate(None) is ANYONE
    for role in ROLES:
        assert keys.check(ANYONE, role) is ANYONE
    keys.charge(ANYONE, 1e9)
    keys.check_audio(ANYONE)


def test_a_role_opens_its_own_door_and_an_admin_every_one(file: Path) -> None:
    tokens = {role: new_token() for role in ROLES}
    keys = Keys(write(file, *(entry(t, r, roles=[r]) for r, t in tokens.items())))
    for role, token in tokens.items():
        key = keys.authenticate(token)
        for wanted in ROLES:
            if role in (wanted, "admin"):
                assert keys.check(key, wanted) == key
            else:
                with pytest.raises(RoleMissing, match=f"needs the role {wanted}"):
                    keys.check(key, wanted)


def test_a_key_expires_at_its_moment(file: Path) -> None:
    token, today = new_token(), [NOON]
    expires = (NOON + timedelta(hours=1)).isoformat()
    keys = Keys(write(file, entry(token, expires=expires)), today=lambda: today[0])
    key = keys.authenticate(token)
    today[0] = NOON + timedelta(minutes=59, seconds=59)
    assert keys.check(key, "stream") == key
    today[0] = NOON + timedelta(hours=1)
    with pytest.raises(KeyExpired, match="2030-01-01 13:00"):
        keys.check(key, "stream")
    with pytest.raises(KeyExpired):
        keys.authenticate(token)


def test_a_reload_takes_away_adds_and_changes(file: Path) -> None:
    gone, kept, new = new_token(), new_token(), new_token()
    keys = Keys(write(file, entry(gone), entry(kept, "kept", max_sessions=1)))
    first, second = keys.authenticate(gone), keys.authenticate(kept)
    with keys.session(second):
        write(file, entry(kept, "kept", max_sessions=2), entry(new, "new"))
        keys.reload()
        with pytest.raises(KeyUnknown):
            keys.check(first, "stream")
        assert keys.authenticate(new).name == "new"
        current = keys.check(second, "stream")
        with keys.session(current), pytest.raises(TooManySessions), keys.session(current):
            pass  # the place that was held before the reload still counts


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "holds no key"),
        ("# only a comment\n\n", "holds no key"),
        ("nmk_secret\n", "line 1: it is not a JSON object"),
        ("[" * 100_000, "line 1: it is not a JSON object"),
        ('# c\n{"name": "a"}', "line 2: sha256: Field required"),
        (json.dumps(entry("t", roles=["root"])), "line 1: roles.0: Input should be 'localize'"),
        (json.dumps(entry("t", roles=[])), "roles"),
        (json.dumps(entry("t", name="a\nb")), "name"),
        (json.dumps(entry("t", max_session=1)), "max_session: Extra inputs"),
        (json.dumps(entry("t", expires="2030-01-01T00:00:00")), "expires"),
        (json.dumps(entry("t", audio_seconds_per_hour=0)), "audio_seconds_per_hour"),
        (f"{json.dumps(entry('t'))}\n{json.dumps(entry('u'))}", "has the name robot-1 twice"),
        (f"{json.dumps(entry('t'))}\n{json.dumps(entry('t', 'b'))}", "has the sha256"),
    ],
)
def test_a_wrong_file_is_a_sentence_and_leaves_the_old_keys(
    text: str, sentence: str, file: Path
) -> None:
    token = new_token()
    keys = Keys(write(file, entry(token)))
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        keys.reload()
    assert sentence in caught.value.detail
    assert "nmk_secret" not in caught.value.detail
    assert keys.authenticate(token).name == "robot-1"


def test_a_file_that_is_not_there_or_no_text_is_a_sentence(file: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        read_keys(file)
    file.write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="not a text file"):
        read_keys(file)
    with pytest.raises(ConfigError, match="cannot be read"):
        read_keys(file.parent)


def test_a_file_that_others_may_write_is_refused_and_one_they_may_read_is_a_warning(
    file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write(file, entry(new_token()))
    read_keys(file)
    assert not caplog.records
    file.chmod(0o644)
    read_keys(file)
    assert "can be read by everybody" in caplog.text
    file.chmod(0o602)
    with pytest.raises(ConfigError, match="written by everybody"):
        read_keys(file)


@given(
    st.builds(
        Key,
        name=st.from_regex(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}", fullmatch=True),
        sha256=st.from_regex(r"[0-9a-f]{64}", fullmatch=True),
        roles=st.lists(st.sampled_from(ROLES), min_size=1).map(tuple),
        max_sessions=st.none() | st.integers(0, 10**6),
        audio_seconds_per_hour=st.none() | st.floats(1e-3, 1e9),
        origins=st.lists(st.text(st.characters(exclude_categories=["Cs"]))).map(tuple),
        expires=st.none() | st.datetimes(timezones=st.just(UTC)),
    )
)
def test_a_line_reads_as_the_key_that_wrote_it(key: Key) -> None:
    assert Key.model_validate_json(key.line) == key
    assert "\n" not in key.line


@given(st.binary(max_size=200))
def test_no_bytes_in_the_file_raise_anything_but_a_sentence(
    tmp_path_factory: pytest.TempPathFactory, content: bytes
) -> None:
    path = tmp_path_factory.mktemp("keys") / "k"
    path.write_bytes(content)
    with pytest.raises(DoaError):
        read_keys(path)


def test_places_are_given_back_whatever_happens(file: Path) -> None:
    token = new_token()
    keys = Keys(write(file, entry(token, max_uploads=1, max_sessions=0)))
    key = keys.authenticate(token)
    with pytest.raises(TooManySessions), keys.session(key):
        pass
    for _ in range(3):
        with pytest.raises(TooManyUploads), keys.upload(key), keys.upload(key):
            pass


def test_audio_is_refused_once_spent_and_drains_at_its_own_pace(file: Path) -> None:
    token, clock = new_token(), Clock()
    keys = Keys(write(file, entry(token, audio_seconds_per_hour=360)), clock=clock)
    key = keys.authenticate(token)
    keys.charge(key, 359.0)
    keys.check_audio(key)
    keys.charge(key, 11.0)  # 10 s beyond, which drain at 0.1 s a second
    with pytest.raises(AudioQuota) as caught, keys.upload(key):
        pass
    assert caught.value.retry_after_s == pytest.approx(100.0)
    clock.now += 99.0
    with pytest.raises(AudioQuota), keys.session(key):
        pass
    clock.now += 1.1
    with keys.upload(key), keys.session(key):
        pass


@given(
    st.floats(1.0, 10_000.0),
    st.lists(st.tuples(st.floats(0.0, 600.0), st.floats(0.0, 60.0)), max_size=200),
)
def test_no_pattern_of_use_gets_more_than_the_rate_and_one_hour_ahead(
    per_hour: float, asks: list[tuple[float, float]]
) -> None:
    """Whoever asks before every piece gets, over any time, the limit's pace, an hour of it ahead,
    and the last piece."""
    clock = Clock()
    usage = Usage(clock)
    began, used = clock.now, 0.0
    for wait, seconds in asks:
        clock.now += wait
        try:
            usage.check_audio(per_hour)
        except AudioQuota:
            continue
        usage.charge(seconds, per_hour)
        used += seconds
        allowed = per_hour * (1 + (clock.now - began) / 3600) + seconds
        assert used <= allowed * (1 + 1e-9) + 1e-6


@given(st.floats(1.0, 10_000.0), st.lists(st.floats(0.0, 20_000.0), max_size=200))
def test_reservations_never_exceed_the_limit(per_hour: float, asks: list[float]) -> None:
    """However long the pieces are, and whoever comes first: no time passes between them."""
    usage, held = Usage(lambda: 0.0), 0.0
    for seconds in asks:
        with suppress(AudioQuota, AudioTooLong):
            usage.reserve(seconds, per_hour)
            held += seconds
        assert held <= per_hour * (1 + 1e-9)
    usage.reserve(-held, per_hour)
    usage.reserve(per_hour * (1 - 1e-9), per_hour)


def test_a_stream_in_real_time_goes_on_for_ever_with_3600_seconds_an_hour() -> None:
    clock = Clock()
    usage = Usage(clock)
    for _ in range(10 * 3600):
        clock.now += 1.0
        usage.charge(1.0, 3600.0)
        usage.check_audio(3600.0)


def test_threads_lose_no_audio() -> None:
    usage = Usage(lambda: 0.0)

    def charge() -> None:
        for _ in range(2000):
            usage.charge(1.0, 1e9)

    threads = [threading.Thread(target=charge) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    usage.check_audio(8001.0)
    with pytest.raises(AudioQuota):
        usage.check_audio(8000.0)

"""The store of noise profiles: names, folders, room, threads."""

from __future__ import annotations

import logging
import os
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuralmusic.errors import ConfigError, InvalidOption, NoiseStoreFull, UnknownNoise
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.stft import Stft
from service.doa.whitening import NoiseCovariance
from service.inference.noise_profile import noise_bytes
from service.inference.noise_store import NoiseStore

SQUARE = preset("respeaker-usb-4mic-v2")


@pytest.fixture
def profile() -> NoiseCovariance:
    return NoiseCovariance(np.tile(np.eye(4, dtype=np.complex64), (257, 1, 1)), SQUARE, Stft(), 5.0)


def test_the_store_keeps_profiles_by_name_across_restarts(
    profile: NoiseCovariance, tmp_path: Path
) -> None:
    folder = tmp_path / "noise"
    store = NoiseStore(folder)
    assert store.all() == []
    stored = store.put("kitchen_fan-2.1", profile)
    store.put("arms", replace(profile, seconds=7.0))
    assert [each.name for each in NoiseStore(folder).all()] == ["arms", "kitchen_fan-2.1"]
    again = NoiseStore(folder).get("kitchen_fan-2.1")
    np.testing.assert_array_equal(again.noise.covariance, profile.covariance)
    assert abs((again.created - stored.created).total_seconds()) < 60
    store.delete("arms")
    assert [path.name for path in folder.iterdir()] == ["kitchen_fan-2.1.npz"]
    with pytest.raises(UnknownNoise, match=r"stored are kitchen_fan-2\.1"):
        NoiseStore(folder).get("arms")
    with pytest.raises(UnknownNoise):
        store.delete("arms")


def test_a_profile_whose_file_stays_is_not_forgotten(
    profile: NoiseCovariance, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = NoiseStore(tmp_path)
    store.put("fans", profile)

    def refused(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "unlink", refused)
    with pytest.raises(PermissionError):
        store.delete("fans")
    assert store.get("fans").name == "fans"
    monkeypatch.undo()
    store.delete("fans")
    assert NoiseStore(tmp_path).all() == []


@pytest.mark.parametrize(
    "name",
    ["", ".", "..", "../fan", "a/b", "a\\b", ".hidden", "-rf", "a b", "fän", "x" * 65, "a\n"],
)
def test_names_that_leave_the_folder_are_refused(
    name: str, profile: NoiseCovariance, tmp_path: Path
) -> None:
    with pytest.raises(InvalidOption, match="1 to 64 letters"):
        NoiseStore(tmp_path / "noise").put(name, profile)
    assert list(tmp_path.iterdir()) == []


def test_a_full_store_refuses_new_names_only(profile: NoiseCovariance) -> None:
    store = NoiseStore(capacity=2)
    store.put("a", profile)
    store.put("b", profile)
    store.put("a", profile)
    with pytest.raises(NoiseStoreFull, match="2 noise profiles"):
        store.put("c", profile)
    store.delete("a")
    assert store.put("c", profile).name == "c"


def test_a_corrupt_file_is_left_out_with_a_warning(
    profile: NoiseCovariance, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    NoiseStore(tmp_path).put("good", profile)
    nameless = replace(profile, array=MicrophoneArray("\ud800", SQUARE.positions))
    (tmp_path / "bad.npz").write_bytes(b"PK nonsense")
    (tmp_path / "named.npz").write_bytes(noise_bytes(nameless))
    (tmp_path / ".half.part").write_bytes(b"PK")
    os.mkfifo(tmp_path / "pipe.npz")
    with caplog.at_level(logging.WARNING):
        assert [each.name for each in NoiseStore(tmp_path).all()] == ["good"]
    assert "bad.npz left out" in caplog.text
    assert "named.npz left out" in caplog.text
    assert (tmp_path / "bad.npz").exists()


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "noise").write_text("")
    with pytest.raises(ConfigError, match="is not a folder"):
        NoiseStore(tmp_path / "noise")


def test_many_threads_may_store_at_once(profile: NoiseCovariance, tmp_path: Path) -> None:
    store = NoiseStore(tmp_path, capacity=5)
    refused = []

    def put(index: int) -> None:
        try:
            store.put(f"n{index % 8}", profile)
        except NoiseStoreFull:
            refused.append(index)

    threads = [threading.Thread(target=put, args=(index,)) for index in range(24)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(store.all()) == len(list(tmp_path.iterdir())) == 5
    assert len(refused) == 9  # the names without room, three times each


def test_the_profiles_together_have_a_bound_in_bytes(
    profile: NoiseCovariance, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A profile of the most microphones has 500 times the bytes of one of four."""
    room = 2 * profile.covariance.nbytes
    store = NoiseStore(tmp_path, max_bytes=room)
    store.put("a", profile)
    store.put("b", profile)
    store.put("b", profile)  # in place of itself
    with pytest.raises(NoiseStoreFull, match="MB"):
        store.put("c", profile)
    assert [each.name for each in NoiseStore(tmp_path, max_bytes=room).all()] == ["a", "b"]
    assert [each.name for each in NoiseStore(tmp_path, max_bytes=room // 2).all()] == ["a"]
    assert "exceeds the limit of noise profiles" in caplog.text

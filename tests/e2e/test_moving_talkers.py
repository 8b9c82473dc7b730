"""Talkers who walk, streamed in real time: they keep their ids, and the page shows it."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
import soundfile

from model_export import SAMPLE_RATE
from model_export.evaluation.cells import living_room
from model_export.simulation.moving import Arc, MovingScene, Talker, simulate_moving
from model_export.simulation.synthesis import synthetic_voice
from service.doa.array import MicrophoneArray
from service.doa.scoring import circular_error

from .conftest import keep_picture

expect = pytest.importorskip("playwright.sync_api", reason="needs playwright").expect
pytestmark = pytest.mark.page

Visits = Callable[..., Any]
QUIET_S, TALK_S = 0.5, 6.5
PATHS = {
    "one-walks": (Arc(np.deg2rad(300), np.deg2rad(25), 1.2),),
    "two-cross": (
        Arc(np.deg2rad(-20), np.deg2rad(20), 1.2),
        Arc(np.deg2rad(110), np.deg2rad(-20), 1.5),
    ),
}


def simulate(name: str, array: MicrophoneArray) -> MovingScene:
    """Synthetic voices that walk in a living room with an RT60 of 0.3 s."""
    rng = np.random.default_rng([3, 7])
    quiet = np.zeros(round(QUIET_S * SAMPLE_RATE))
    voices = [np.concatenate([quiet, synthetic_voice(rng, TALK_S)]) for _ in range(2)]
    pairs = zip(PATHS[name], voices, strict=False)
    talkers = [Talker(path, voice) for path, voice in pairs]
    return simulate_moving(rng, living_room(0.3), array, talkers, snr_db=25.0)


@pytest.mark.parametrize("name", list(PATHS))
def test_who_walks_keeps_its_id(
    name: str, visit: Visits, square: MicrophoneArray, tmp_path: Path
) -> None:
    scene = simulate(name, square)
    path = tmp_path / f"{name}.wav"
    audio = 0.5 * scene.audio.T / np.abs(scene.audio).max()
    soundfile.write(path, audio, SAMPLE_RATE, subtype="PCM_16")
    here = visit()
    here.page.set_input_files("#file", path)
    here.page.click("#replay")
    here.page.wait_for_function(
        "() => document.querySelector('#live-title').textContent >= 'Now, 6'"
    )
    keep_picture(here, f"page-{name}")
    expect(here.page.locator("#live-state")).to_contain_text("The session has ended")
    owners = owners_of_ids(exported(here.url), scene)
    # Whoever talks has one id from the beginning to the end, and no other has it.
    assert len(owners) == len(scene.talkers)
    assert set(owners.values()) == set(range(len(scene.talkers)))


def exported(url: str) -> list[dict[str, str]]:
    """Rows of the session that ended last."""
    sessions = httpx2.get(f"{url}/sessions").json()["sessions"]
    last = max(sessions, key=lambda each: each["started_at"])
    text = httpx2.get(f"{url}/sessions/{last['id']}/export", params={"format": "csv"}).text
    return list(csv.DictReader(text.splitlines()))


def owners_of_ids(rows: list[dict[str, str]], scene: MovingScene) -> dict[int, int]:
    """The talker whom each id followed, of those ids that were active for a second or more."""
    near: dict[int, Counter[int]] = {}
    for row in rows:
        if row["active"] != "1":
            continue
        truth = scene.azimuths(float(row["t_end"]))
        errors = circular_error(np.deg2rad(float(row["azimuth_deg"])), truth)
        assert np.rad2deg(errors.min()) < 20
        near.setdefault(int(row["id"]), Counter())[int(errors.argmin())] += 1
    lasting = {number: seen for number, seen in near.items() if seen.total() >= 10}
    # While two cross, each is near the other for a moment.
    assert all(seen.most_common(1)[0][1] >= 0.85 * seen.total() for seen in lasting.values())
    return {number: seen.most_common(1)[0][0] for number, seen in lasting.items()}

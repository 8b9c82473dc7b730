"""Mistakes made to one recording of synthetic voices are named."""

from __future__ import annotations

import numpy as np
import pytest

from model_export.evaluation.mistakes import (
    AZIMUTHS,
    MISTAKES,
    Talk,
    beamformed,
    codes,
    row,
    talk_of,
)
from model_export.simulation.synthesis import synthetic_voice

pytestmark = pytest.mark.torch

EXPECTED = {
    "none": set(),
    "channels 1 and 2 swapped": {"channel_order"},
    "channels rotated by one": set(),
    "the same with noise suppression and gain": {"channel_processed"},
    "the same 16 ms late": {"channel_processed"},
    "a dead channel": {"channel_dead"},
    "geometry in centimetres": {"geometry_invalid"},
    "48 kHz declared as 16": {"sample_rate_wrong"},
    "one channel late by a sample": {"channel_late"},
    "one channel inverted": {"channel_inverted"},
}


@pytest.fixture(scope="module")
def talk() -> Talk:
    rng = np.random.default_rng(1)
    voices = [synthetic_voice(rng, 4.0) for _ in range(4)]
    return talk_of(voices, AZIMUTHS[:4], 12.0, (5,))


@pytest.mark.parametrize("name", EXPECTED)
def test_a_mistake_is_named(name: str, talk: Talk) -> None:
    (mistake,) = [mistake for mistake in MISTAKES if mistake.name == name]
    assert codes(mistake, talk) - {"band_limited"} == EXPECTED[name]


def test_a_beam_keeps_the_talker_and_loses_noise(talk: Talk) -> None:
    voice = talk.noisy() - talk.noisy(np.zeros_like(talk.speech))
    quiet = talk.noisy(np.zeros_like(talk.speech))
    assert np.std(beamformed(talk, quiet)) == pytest.approx(0.5 * np.std(quiet[0]), rel=0.02)
    assert np.std(beamformed(talk, voice)) > 0.8 * np.std(voice[0])


def test_a_row_counts_recordings_and_findings() -> None:
    found = [[frozenset({"clipping", "quiet"}), frozenset()], [frozenset({"quiet"})]]
    assert row(MISTAKES[0], found) == "| none | 1 of 2 | 1 of 1 | `quiet` 2, `clipping` 1 |"

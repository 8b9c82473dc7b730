"""Sources that are found one by one, then again together, in fields whose truth is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.scoring import circular_error, match
from service.doa.types import FloatArray
from service.inference.candidates import Candidates, find_candidates
from service.inference.field import Field

SQUARE = preset("respeaker-usb-4mic-v2")
LINE = MicrophoneArray("line", np.array([[-0.06, 0, 0], [-0.02, 0, 0], [0.02, 0, 0], [0.06, 0, 0]]))
BINS, ROWS, GRID = 64, 3, 180
WIDTH = np.deg2rad(8.0)
"""Width of a cell's peak at half its height"""


def spectra_at(azimuth: FloatArray) -> FloatArray:
    """(C, A) what rank-one MUSIC of small arrays gives: 1 / (1 + (distance / width)^2)."""
    grid = np.arange(GRID) * (2 * np.pi / GRID)
    distance = circular_error(grid[None], azimuth[:, None])
    cells: FloatArray = (1 / (1 + (distance / WIDTH) ** 2)).astype(np.float32)
    return cells


def field_of(
    azimuth: FloatArray, attention: FloatArray | None = None, array: MicrophoneArray = SQUARE
) -> Field:
    """Cells (C,) that point where they are told to, all alike unless they are attended to."""
    cells = BINS * ROWS
    attended = np.ones(cells) if attention is None else attention
    return Field(
        spectra_at(azimuth),
        attended.astype(np.float32),
        np.ones(cells, dtype=np.float32),
        np.tile(np.arange(ROWS), BINS),
        BINS,
        ROWS,
        array,
        1.0,
    )


def worst_deg(found: FloatArray, truth: FloatArray) -> float:
    return float(np.rad2deg(max(error for _, _, error in match(found, truth))))


def refined(found: Candidates, chosen: Sequence[int]) -> FloatArray:
    """Azimuths of the chosen candidates, refined together."""
    return np.array([azimuth for azimuth, _ in found.refined(chosen)])


@settings(deadline=None)
@given(first=st.floats(0, 359.99), apart=st.floats(22, 180), share=st.floats(0.3, 0.7))
def test_two_talkers_do_not_draw_each_other_closer(
    first: float, apart: float, share: float
) -> None:
    truth = np.deg2rad([first, first + apart])
    of_first = np.random.default_rng(1).permutation(BINS * ROWS) < share * BINS * ROWS
    found = find_candidates(field_of(np.where(of_first, *truth)))
    # A peak as sharp as this is met within a fiftieth of the grid's step, seam and all.
    assert worst_deg(refined(found, [0, 1]), truth) < 0.04


def test_what_is_found_first_leans_towards_the_other() -> None:
    """The test above is not one of peaks: as found, the first is six times as far off."""
    truth = np.deg2rad([100.0, 125.0])
    found = find_candidates(field_of(np.repeat(truth, BINS * ROWS // 2)))
    assert worst_deg(np.array([azimuth for azimuth, _ in found.directions[:2]]), truth) > 0.24


def test_few_attended_cells_do_not_decide_where_a_source_is() -> None:
    """Cells err independently: the mean over many is closer than that over a few strong ones."""
    rng = np.random.default_rng(2)
    before, after = [], []
    for _ in range(60):
        truth = rng.uniform(0, 2 * np.pi)
        azimuth = truth + rng.normal(0, np.deg2rad(5.0), BINS * ROWS)
        found = find_candidates(field_of(azimuth, rng.lognormal(0, 2.0, BINS * ROWS)))
        before.append(float(circular_error(found.directions[0][0], truth)))
        after.append(float(circular_error(refined(found, [0]), truth)[0]))
    assert np.mean(after) < 0.7 * np.mean(before)


def test_the_order_in_which_sources_are_named_does_not_matter() -> None:
    truth = np.deg2rad([20.0, 80.0, 210.0])
    found = find_candidates(field_of(np.tile(truth, BINS * ROWS // 3)))
    forward, backward = found.refined([0, 1, 2]), found.refined([2, 1, 0])
    assert forward == backward[::-1]
    assert worst_deg(refined(found, [0, 1, 2]), truth) < 0.04


def test_sources_in_the_same_cells_stay_where_they_were_found() -> None:
    """Every cell points to both, so none is left to look again in."""
    truth = np.deg2rad([60.0, 240.0])
    both = np.maximum(*(spectra_at(np.full(BINS * ROWS, each)) for each in truth))
    field = field_of(np.zeros(BINS * ROWS))
    found = find_candidates(replace(field, cells=both))
    first = found.findings[0]
    assert refined(found, [0]) == pytest.approx([first.azimuth], abs=1e-6)
    twin = replace(found, findings=[first, first])
    assert refined(twin, [0, 1]) == pytest.approx([first.azimuth] * 2, abs=1e-6)


@settings(deadline=None)
@given(angle=st.floats(0, 180))
def test_a_line_answers_on_its_searched_side(angle: float) -> None:
    """Its spectra have the image behind it, and at its ends peaks lie on the border."""
    rng = np.random.default_rng(3)
    azimuth = np.deg2rad(angle) + rng.normal(0, np.deg2rad(2.0), BINS * ROWS)
    images = np.maximum(spectra_at(azimuth), spectra_at(-azimuth))
    field = field_of(azimuth, array=LINE)
    found = find_candidates(replace(field, cells=images))
    (direction,) = refined(found, [0])
    assert -1e-6 <= np.angle(np.exp(1j * direction)) <= np.pi + 1e-6
    assert circular_error(np.array(direction), np.deg2rad(angle)) < np.deg2rad(4.0)


def test_nothing_chosen_is_nothing_found() -> None:
    assert find_candidates(field_of(np.zeros(BINS * ROWS))).refined([]) == []

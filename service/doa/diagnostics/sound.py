"""Findings from the sound itself: bandwidth, processed channels, polarity, delays, geometry."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from service.doa.array import SPEED_OF_SOUND, MicrophoneArray, pairwise_distances
from service.doa.diagnostics.bandwidth import bandwidth_findings
from service.doa.diagnostics.cells import MAX_BLOCKS, direct_cells
from service.doa.diagnostics.diffuse import size_findings
from service.doa.diagnostics.finding import Finding
from service.doa.diagnostics.fit import PlaneWaveFit
from service.doa.diagnostics.geometry import MIN_MICROPHONES, geometry_findings
from service.doa.diagnostics.lag import (
    alignment,
    lag_findings,
    polarity_findings,
    unknown_distances,
)
from service.doa.diagnostics.processed import processed_findings
from service.doa.types import FloatArray

MAX_APERTURE = 0.5  # m; over larger arrays a talker's waves are no longer plane


def sound_findings(
    segments: Sequence[FloatArray],
    sample_rate: int,
    names: Sequence[int],
    array: MicrophoneArray | None,
    max_blocks: int = MAX_BLOCKS,
) -> tuple[list[Finding], str | None]:
    """Findings from an excerpt without dead or copied channels, and why geometry was not checked.

    Parameters
    ----------
    segments : list of (N, T) float32
        Segments with sound.
    sample_rate : int
        Hertz.
    names : sequence of int
        Recording channels of the N channels.
    array : MicrophoneArray, optional
        N microphones; without it delays are compared with the largest array.
    max_blocks : int
        Most blocks of direct sound to compare with the array; the time grows with it.
    """
    if not segments:
        return [], "there is no sound"
    findings = bandwidth_findings(segments, sample_rate)
    processed = processed_findings(segments, sample_rate, names)
    if processed:
        return [*findings, *processed], "first leave out the channel that is not a microphone"
    inverted = alignment(segments, sample_rate).inverted
    findings += polarity_findings(inverted, names)
    signs = np.where(inverted, np.float32(-1), np.float32(1))[:, None]
    upright = [segment * signs for segment in segments] if inverted.any() else segments
    delays, unchecked = _delays(upright, sample_rate, names, array, max_blocks)
    return [*findings, *delays], unchecked


def _delays(
    segments: Sequence[FloatArray],
    sample_rate: int,
    names: Sequence[int],
    array: MicrophoneArray | None,
    max_blocks: int,
) -> tuple[list[Finding], str | None]:
    """Findings about delays between channels, and why geometry was not checked."""
    if array is None:
        late = lag_findings(segments, sample_rate, unknown_distances(len(names)), names)
        return late, "no array was named"
    distances = pairwise_distances(array.positions)
    fits, unchecked = _geometry(segments, sample_rate, names, array, max_blocks)
    late = lag_findings(segments, sample_rate, distances, names)
    if not late:
        return fits, unchecked
    # A wrong scale or order makes channels look late; no order explains lags beyond the array.
    beyond = np.full_like(distances, distances.max())
    explained = {"array_scale", "sample_rate_wrong"}
    if not lag_findings(segments, sample_rate, beyond, names):
        explained.add("channel_order")
    if any(finding.code in explained for finding in fits):
        return fits, unchecked
    return late, "first align late channels"


def _geometry(
    segments: Sequence[FloatArray],
    sample_rate: int,
    names: Sequence[int],
    array: MicrophoneArray,
    max_blocks: int,
) -> tuple[list[Finding], str | None]:
    """Findings from the comparison of sound and array, and why there was none."""
    if array.num_microphones < MIN_MICROPHONES:
        return [], f"{MIN_MICROPHONES} microphones are needed to tell a mistake from a direction"
    if array.aperture > MAX_APERTURE:
        return [], f"the array is larger than {MAX_APERTURE:g} m"
    # Above two wavelengths across the array the grid of directions is too coarse.
    limit = 2 * SPEED_OF_SOUND / array.aperture
    cells = direct_cells(segments, sample_rate, limit, max_blocks)
    if not cells.enough:
        return [], "there is too little direct sound"
    fit = PlaneWaveFit(cells, array.positions, sample_rate)
    found = geometry_findings(fit, array.positions, names)
    return found or size_findings(segments, sample_rate, array), None

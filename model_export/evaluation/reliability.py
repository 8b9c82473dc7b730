"""Reliability: are reported sources right as often as their confidences say?

The scenes vary what changes a confidence: one to three talkers, -5 to 30 dB, the paper's room with
image order 0 to 4 or a room with an RT60 of 0.2 to 0.6 s; the number of talkers is unknown.
Sources are matched to talkers one to one; a source is right if its talker is within 10 degrees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from model_export.evaluation.cells import small_room
from model_export.evaluation.workers import Inputs, Workers
from model_export.simulation.protocol import SceneProtocol, SimulatedScene, simulate_scene
from model_export.training.confidences import HIT_DEG, Bin, calibration_error, confidence_bins
from service.doa.scoring import match_directions
from service.doa.steering import unit_vectors
from service.doa.types import FloatArray
from service.inference.results import MAX_SOURCES, Source

Reports = list[tuple[float, bool]]
"""Confidence of every reported source and whether it is right"""


@dataclass(frozen=True, slots=True)
class Reliability:
    """Confidences of one method against the truth."""

    scenes: int
    calibration_error: float
    """Expected calibration error: mean distance of confidence and share right over the sources"""
    bins: list[Bin]
    """Bins that hold a source, least confident first"""

    @classmethod
    def of(cls, fields: dict[str, Any]) -> Reliability:
        """Restore one from the dictionary that ``dataclasses.asdict`` made of it."""
        bins = [Bin(**bin_) for bin_ in fields["bins"]]
        return cls(**{**fields, "bins": bins})

    @property
    def sources(self) -> int:
        """Number of sources reported in all scenes."""
        return sum(bin_.sources for bin_ in self.bins)

    def section(self) -> str:
        """A sentence and a Markdown table with a row per bin."""
        lines = [
            f"{self.sources} sources reported in {self.scenes} scenes of 1 to 3 talkers at -5 to "
            "30 dB, half of them in the",
            "paper's room with order 0 to 4, half with an RT60 of 0.2 to 0.6 s, count unknown. "
            "Expected calibration",
            f"error: {self.calibration_error:.3f}.",
            "",
            "| confidence | reported sources | mean confidence | share within 10° |",
            "|---|---|---|---|",
        ]
        lines += [
            f"| {bin_.low:.1f} to {bin_.high:.1f} | {bin_.sources} | {bin_.mean_confidence:.3f} "
            f"| {bin_.share_right:.3f} |"
            for bin_ in self.bins
        ]
        return "\n".join(lines) + "\n"


def measure_reliability(workers: Workers, scenes: int) -> dict[str, Reliability]:
    """Every bundle's reliability on the ReSpeaker square, by the bundle's name."""
    answered = workers.map(answer_mixed_scene, range(scenes), "reliability")
    return {
        name: reliability([report for scene in answered for report in scene[name]], scenes)
        for name in answered[0]
    }


def answer_mixed_scene(inputs: Inputs, index: int) -> dict[str, Reports]:
    """Every bundle's reports of one scene."""
    scene = mixed_scene(inputs, index)
    reports = {}
    for name, localizer in inputs.methods.localizers(scene.array).items():
        (estimate,) = localizer.estimate(scene.audio[None], None, MAX_SOURCES)
        reports[name] = judged(estimate.sources, unit_vectors(scene.azimuth, scene.elevation))
    return reports


def mixed_scene(inputs: Inputs, index: int) -> SimulatedScene:
    """Simulate the scene of this index."""
    rng = np.random.default_rng([inputs.seed, 5, index])
    rt60 = float(rng.uniform(0.2, 0.6)) if index % 2 else None
    protocol = SceneProtocol(
        num_sources=1 + index % 3,
        room=small_room(rt60) if rt60 else None,
        orders=(0, 4),
        snr_db=float(rng.uniform(-5, 30)),
    )
    return simulate_scene(protocol, inputs.speech, [inputs.seed, 6, index])


def judged(sources: Sequence[Source], truth: FloatArray) -> Reports:
    """Confidence and correctness of every source, with talkers at unit vectors ``truth`` (M, 3).

    Sources without an elevation are taken as level.
    """
    found = [unit_vectors(np.array(s.azimuth), s.elevation or 0.0) for s in sources]
    pairs = match_directions(np.array(found).reshape(-1, 3), truth)
    right = {index for index, _, error in pairs if error <= np.deg2rad(HIT_DEG)}
    return [(source.confidence, index in right) for index, source in enumerate(sources)]


def reliability(reports: Reports, scenes: int) -> Reliability:
    """Ten bins of equal width and the calibration error over them."""
    confidence = np.array([confidence for confidence, _ in reports])
    right = np.array([right for _, right in reports], dtype=bool)
    bins = confidence_bins(confidence, right)
    return Reliability(scenes, calibration_error(bins), bins)

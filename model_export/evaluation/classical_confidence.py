"""Confidence of the classical methods' peaks: the command ``classical-confidence``.

The contrast of a peak is how far it rises above its spectrum's mean. The confidence, the chance
that a source is within 10 degrees, is a logistic curve in the contrast. The curves are fitted here
on simulated windows: one for peaks that stand out, one for peaks reported because that many were
asked for. In a spectrum without a direction, as in a pause, the contrast says nothing and a
constant serves as well. ``service/inference/classical.py`` holds the curves.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.optimize
from rich.progress import track

from model_export.evaluation.cells import small_room
from model_export.evaluation.false_sources import isotropic_noise, sensor_noise
from model_export.evaluation.reliability import Reliability, Reports, judged, reliability
from model_export.simulation.arrays import SPATIAL_ARRAYS, named_array
from model_export.simulation.noise import unit_power
from model_export.simulation.protocol import SceneProtocol, simulate_scene
from model_export.simulation.scenes import WINDOW_SAMPLES
from neuralmusic.protocol.methods import Method
from service.doa.array import MicrophoneArray
from service.doa.steering import unit_vectors
from service.doa.types import BoolArray, FloatArray
from service.inference.classical import (
    CHANCES,
    SPHERE_CHANCES,
    Chances,
    ClassicalLocalizer,
    Curve,
)
from service.inference.results import MAX_SOURCES, WindowEstimate

ARRAYS = ("respeaker-usb-4mic-v2", "respeaker-6mic-circular", "av163-circle8")
ELEVATIONS_DEG = (-40.0, 60.0)
"""Lowest and highest elevation of talkers around arrays with height"""


@dataclass(frozen=True, slots=True)
class Window:
    """Audio and its talkers."""

    array: MicrophoneArray
    audio: FloatArray
    """(N, T)"""
    directions: FloatArray
    """(M, 3) unit vectors"""
    told: int
    """Number of sources asked for: M, or in a pause the talkers around it"""


def windows(
    speech: Sequence[FloatArray], count: int, seed: int, *, sphere: bool = False
) -> Iterator[Window]:
    """Simulate windows of one to three talkers at -5 to 30 dB; every fourth is a pause.

    Two thirds of the talkers' windows are in the paper's room, a third has RT60 0.15 to 0.7 s.
    With ``sphere`` arrays have height, and talkers are above and below them.
    """
    names = tuple(SPATIAL_ARRAYS) if sphere else ARRAYS
    for index in track(range(count), description="windows"):
        rng = np.random.default_rng([seed, 5, index])
        talkers, name = 1 + index % 3, names[index // 3 % len(names)]
        if index % 4 == 3:
            array = named_array(name)
            noise = (sensor_noise, isotropic_noise)[index // 4 % 2]
            audio = 0.02 * unit_power(noise(rng, array.positions, WINDOW_SAMPLES))
            yield Window(array, audio.astype(np.float32), np.zeros((0, 3)), talkers)
            continue
        rt60 = float(rng.uniform(0.15, 0.7)) if index % 2 else None
        protocol = SceneProtocol(
            num_sources=talkers,
            array=name,
            room=small_room(rt60) if rt60 else None,
            orders=(0, 4),
            snr_db=float(rng.uniform(-5, 30)),
            continuous=bool(rng.random() < 0.5),
            elevations_deg=ELEVATIONS_DEG if sphere else (0.0, 0.0),
        )
        scene = simulate_scene(protocol, speech, [seed, 6, index])
        directions = unit_vectors(scene.azimuth, scene.elevation)
        yield Window(scene.array, scene.audio, directions, talkers)


def contrasts(estimate: WindowEstimate, curve: Curve) -> FloatArray:
    """Contrasts (K,) of the reported sources, from the confidences that the curve gave them."""
    chance = np.clip([source.confidence for source in estimate.sources], 1e-6, 1 - 1e-6)
    return curve.middle + np.log(chance / (1 - chance)) / curve.slope


def fitted(contrast: FloatArray, right: BoolArray) -> tuple[float, float]:
    """Likeliest slope and middle of the curve 1 / (1 + exp(-slope (contrast - middle)))."""

    def loss(curve: FloatArray) -> float:
        logits = curve[0] * (contrast - curve[1])
        return float(np.logaddexp(0, np.where(right, -logits, logits)).mean())

    best = scipy.optimize.minimize(loss, (10.0, 0.4), bounds=[(0, 100), (-1, 2)])
    return float(best.x[0]), float(best.x[1])


def fitted_curves(speech: Sequence[FloatArray], count: int, seed: int) -> Iterator[str]:
    """Report every method's fitted curve and the reliability of the service's confidences.

    ``count`` windows are simulated for searches of azimuths, and as many for those of the sphere.
    """
    for where, of_methods in (("azimuths", CHANCES), ("sphere", SPHERE_CHANCES)):
        simulated = windows(speech, count, seed, sphere=where == "sphere")
        for line in _fitted(simulated, of_methods, count):
            yield f"{where}: {line}"


def _fitted(
    simulated: Iterable[Window], of_methods: Mapping[Method, Chances], count: int
) -> Iterator[str]:
    found: dict[tuple[Method, str], list[tuple[FloatArray, Reports]]] = {}
    for window in simulated:
        for method, chances in of_methods.items():
            localizer = ClassicalLocalizer(method, window.array)
            (counted,) = localizer.estimate(window.audio[None], None, MAX_SOURCES)
            (told,) = localizer.estimate(window.audio[None], window.told, MAX_SOURCES)
            undirected = chances.undirected in (each.confidence for each in told.sources)
            directed = "without" if undirected else "with"
            for kind, estimate, curve in (
                ("counted", counted, chances.counted),
                (f"asked for in a spectrum {directed} a direction", told, chances.asked),
            ):
                judgement = judged(estimate.sources, window.directions)
                found.setdefault((method, kind), []).append((contrasts(estimate, curve), judgement))
    for (method, kind), answers in found.items():
        contrast = np.concatenate([each for each, _ in answers])
        reports = [report for _, of_window in answers for report in of_window]
        right = np.array([right for _, right in reports])
        slope, middle = fitted(contrast, right)
        shown = f"slope {slope:.2f}, middle {middle:.3f}; all alike {right.mean():.2f}"
        yield f"{method}, {kind}: {shown}"
        yield _table(reliability(reports, count))


def _table(found: Reliability) -> str:
    """Calibration of the confidences that the service gives, a line per bin."""
    lines = [f"  calibration error {found.calibration_error:.3f}"]
    lines += [
        f"  {bin_.low:.1f} to {bin_.high:.1f}: {bin_.sources:4} sources, "
        f"mean {bin_.mean_confidence:.2f}, right {bin_.share_right:.2f}"
        for bin_ in found.bins
    ]
    return "\n".join(lines)

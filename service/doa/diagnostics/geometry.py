"""Wrong orders, late channels and wrong sizes, found by comparing fits of sound and array.

Every hypothesis undoes one mistake. It is accepted where plane waves fit the recording's direct
sounds much better than with the geometry as given, block for block. Reverberation makes all fits
worse, which costs detections rather than causing false alarms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from service.doa.diagnostics.finding import Finding
from service.doa.diagnostics.fit import Hypothesis, PlaneWaveFit
from service.doa.diagnostics.orders import best_order, equivalent_orders, suspects
from service.doa.types import FloatArray

MISFIT_RATIO = 0.9
"""Largest share of the misfit (1 - fit) that an accepted hypothesis leaves; over 240 good simulated
rooms and three real recordings no wrong hypothesis leaves less than 0.93"""
FINE_MISFIT_RATIO = 0.95
"""The same with finer directions and other waves: good recordings leave at least 1 there, or gain
less than the least below"""
MIN_STATISTIC = 3.5
"""Least mean gain of the blocks over its standard error; the same recordings stay below 2.9"""
MIN_GAIN = 0.005
"""Least fall of the misfit: reflections alone, which fit no hypothesis, cause up to 0.004"""
MIN_GAIN_OF_FEW = 0.02
"""The same where the array has no more delays than directions have dimensions, as a tetrahedron:
another direction then explains most of a late channel, and reflections cause up to 0.014"""
MIN_SPREAD = 0.25
"""Least spread of the directions by which such an array's channel may be late: the delays from a
single talker are those from some other place with a channel shifted, up to the
reflections; one talker has a spread of up to 0.2, three of at least 0.33"""
MAX_LIKELY = 8
"""Most hypotheses of a kind, the best ones, that are judged with finer directions"""
TIE = 1.1  # misfits of late channels that differ by a smaller factor cannot be told apart
PRIOR = 1.03  # an order wins over a slightly better lag: wrong orders are far more common
MAX_LATE = 4  # samples; most larger lags are seen by cross-correlation
SCALE_RATIO = 0.6  # of the misfit, for another scale: a larger array fits any sound a little better
SCALES = (1.5, 2.0, 3.0)  # wrong units are refused; these are 48 kHz read as 32, 24 and 16 kHz
RATE_SCALE = 2.5  # from here on: radius and diameter are confused at 2, sample rates at 2.76 and 3
MIN_MICROPHONES = 4  # with three, any lag within the array's size is some direction


@dataclass(frozen=True, slots=True)
class Verdict:
    """A hypothesis that explains the sound better than the geometry as given."""

    hypothesis: Hypothesis
    misfit: float
    """1 - mean fit of the hypothesis"""
    given: float
    """1 - mean fit of the geometry as given"""

    @property
    def clear(self) -> bool:
        """Whether it is good enough for another scale."""
        return self.misfit < SCALE_RATIO * self.given


def geometry_findings(
    fit: PlaneWaveFit, positions: FloatArray, names: Sequence[int]
) -> list[Finding]:
    """The mistake that explains the sound best, if one explains it much better than no mistake.

    Parameters
    ----------
    fit : PlaneWaveFit
    positions : (N, 3) float
        Metres.
    names : sequence of int
        Recording channels of the microphones.
    """
    given = tuple(range(len(positions)))
    none = Hypothesis(given, (0,) * len(positions))
    order = best_order(fit, positions)
    orders = _confirmed(fit, _likely(fit, [order] if order else [], none), none)
    late = _late_hypotheses(suspects(fit.agreement(given)), given)
    lates = [
        verdict
        for verdict in _confirmed(fit, _likely(fit, late, none), none)
        if fit.redundant or fit.spread(verdict.hypothesis) > MIN_SPREAD
    ]
    sizes = [
        verdict
        for scale in SCALES
        for verdict in _likely(fit, [Hypothesis(given, none.late, scale)], none)
        if verdict.clear
    ]
    # Only the grid chooses the size: finer elevations fit any larger array to the sound.
    size = sorted(sizes, key=_misfit)[:1]
    scales = [verdict for verdict in _confirmed(fit, size, none) if verdict.clear]
    if not (orders or lates or scales):
        return []
    best = min(verdict.misfit for verdict in (*orders, *lates, *scales))
    if orders and orders[0].misfit < PRIOR * best:
        return [_order_finding(orders[0], positions, names)]
    if scales and min(scales, key=_misfit).misfit == best:
        return [_scale_finding(min(scales, key=_misfit))]
    ties = sorted((verdict for verdict in lates if verdict.misfit < TIE * best), key=_misfit)
    return [_late_finding(ties, names)]


def _misfit(verdict: Verdict) -> float:
    return verdict.misfit


def _late_hypotheses(late: Sequence[int], order: tuple[int, ...]) -> list[Hypothesis]:
    shifts = (*range(-MAX_LATE, 0), *range(1, MAX_LATE + 1))
    return [
        Hypothesis(order, tuple(shift if n == index else 0 for n in order))
        for index in late
        for shift in shifts
    ]


def _likely(fit: PlaneWaveFit, hypotheses: Sequence[Hypothesis], none: Hypothesis) -> list[Verdict]:
    """Verdicts on the hypotheses that clearly beat ``none`` by plane waves on the grid."""
    if not hypotheses:
        return []
    scores, reference = fit.scores(hypotheses), fit.scores([none])[0]
    return _judge(hypotheses, scores, reference, MISFIT_RATIO)


def _confirmed(fit: PlaneWaveFit, likely: Sequence[Verdict], none: Hypothesis) -> list[Verdict]:
    """New verdicts on the likely hypotheses that beat ``none`` by waves of any kind, too."""
    if not likely:
        return []
    kept = [verdict.hypothesis for verdict in sorted(likely, key=_misfit)[:MAX_LIKELY]]
    scores, reference = fit.fine_scores(kept), fit.fine_scores([none])[0]
    least = MIN_GAIN if fit.redundant else MIN_GAIN_OF_FEW
    found = _judge(kept, scores, reference, FINE_MISFIT_RATIO)
    return [verdict for verdict in found if verdict.given - verdict.misfit > least]


def _judge(
    hypotheses: Sequence[Hypothesis], scores: FloatArray, reference: FloatArray, ratio: float
) -> list[Verdict]:
    """Verdicts on the hypotheses whose fits (H, B) clearly beat the fits ``reference`` (B,).

    At most the share ``ratio`` of the misfit is left.
    """
    given = max(1.0 - float(reference.mean()), 1e-6)
    verdicts = []
    for hypothesis, score in zip(hypotheses, scores, strict=True):
        gain = score - reference
        error = float(gain.std()) / np.sqrt(gain.size)
        misfit = 1.0 - float(score.mean())
        if misfit < ratio * given and float(gain.mean()) > MIN_STATISTIC * error:
            verdicts.append(Verdict(hypothesis, misfit, given))
    return verdicts


def _order_finding(verdict: Verdict, positions: FloatArray, names: Sequence[int]) -> Finding:
    order = verdict.hypothesis.order
    maps = [
        str([names[channel] for channel in other])
        for other in equivalent_orders(positions, order)[:2]
    ]
    moved = tuple(names[channel] for index, channel in enumerate(order) if index != channel)
    detail = (
        f"the sound fits the array much better with its channels in another order "
        f"({_misfits(verdict)}): try channel_map {' or '.join(maps)}; an order that turns or "
        f"mirrors the whole array fits as well, so check one known direction"
    )
    return Finding("channel_order", detail, moved)


def _late_finding(ties: Sequence[Verdict], names: Sequence[int]) -> Finding:
    channels, phrases = [], []
    for verdict in ties:
        index = int(np.flatnonzero(verdict.hypothesis.late)[0])
        shift = verdict.hypothesis.late[index]
        channels.append(names[index])
        samples = "1 sample" if abs(shift) == 1 else f"{abs(shift)} samples"
        phrases.append(f"channel {names[index]} is {samples} {'late' if shift > 0 else 'early'}")
    detail = (
        f"{', or '.join(phrases)} against the other channels ({_misfits(ties[0])}): align the "
        f"channels, all of them must be captured by one device on one clock"
    )
    return Finding("channel_late", detail, tuple(dict.fromkeys(channels)))


def _scale_finding(verdict: Verdict) -> Finding:
    scale = verdict.hypothesis.scale
    delays = (
        f"the delays between the channels fit an array about {scale:g} times as large as the given "
        f"one ({_misfits(verdict)})"
    )
    if scale >= RATE_SCALE:
        rates = (
            f"{delays}, as when audio of 48 or 44.1 kHz is declared as 16 kHz: check the "
            f"sample rate that the file or the stream names, then the unit of the positions"
        )
        return Finding("sample_rate_wrong", rates)
    size = (
        f"{delays}: check the positions (a radius is half a diameter), and that the file names its "
        f"true sample rate"
    )
    return Finding("array_scale", size)


def _misfits(verdict: Verdict) -> str:
    return f"misfit {verdict.misfit:.3f} instead of {verdict.given:.3f}"

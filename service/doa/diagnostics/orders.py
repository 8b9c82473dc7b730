"""Orders of an array's channels that plane waves can tell apart, and the search among them.

Two orders with the same distances between the microphones are one array turned or mirrored: every
sound fits both, from another direction. So a square has three distinct orders instead of 24, and
its rotation by one channel cannot be seen.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations, permutations

import numpy as np

from service.doa.array import pairwise_distances
from service.doa.diagnostics.fit import Hypothesis, PlaneWaveFit
from service.doa.types import FloatArray

Order = tuple[int, ...]
"""Channel of every microphone"""

ALL_ORDERS = 5  # up to this many microphones every order is tried: 120
SUSPECTS = 6  # with more microphones, only those that agree least with the others are exchanged
CONGRUENT = 0.05  # of the aperture: arrays that differ by less sound alike
STEP = 0.95  # a further exchange must leave at most this share of the misfit


def suspects(agreement: FloatArray) -> tuple[int, ...]:
    """Microphones that may be at fault: all if they are few, else those that agree least."""
    return tuple(sorted(int(index) for index in np.argsort(agreement)[:SUSPECTS]))


def distinct_orders(positions: FloatArray, exchanged: Sequence[int] | None = None) -> list[Order]:
    """Orders that sound different from the given one and from each other.

    The order that moves the fewest channels stands for all that sound alike.

    Parameters
    ----------
    positions : (N, 3) float
    exchanged : sequence of int, optional
        Microphones among which exchanges of two channels are tried for N above ``ALL_ORDERS``,
        beside rotations of all channels.
    """
    count = len(positions)
    candidates = sorted(_orders(count, range(count) if exchanged is None else exchanged), key=moved)
    seen = [_distances(positions, tuple(range(count)))]
    tolerance = CONGRUENT * float(seen[0].max())
    distinct = []
    for order in candidates:
        distances = _distances(positions, order)
        if all(np.abs(distances - other).max() > tolerance for other in seen):
            seen.append(distances)
            distinct.append(order)
    return distinct


def equivalent_orders(positions: FloatArray, order: Order) -> list[Order]:
    """Orders that sound like ``order`` and move as few channels, itself first."""
    distances = _distances(positions, order)
    tolerance = CONGRUENT * float(distances.max())
    same = [
        other
        for other in _orders(len(positions), range(len(positions)))
        if other != order
        and moved(other) == moved(order)
        and np.abs(_distances(positions, other) - distances).max() <= tolerance
    ]
    return [order, *same]


def best_order(fit: PlaneWaveFit, positions: FloatArray) -> Hypothesis | None:
    """The order that fits best; None where every distinct order fits worse than the given one.

    All orders of few microphones are tried. With many, exchanges follow each other while the fit
    gets clearly better.
    """
    count = len(positions)
    late = (0,) * count
    order: Order = tuple(range(count))
    misfit = 1.0 - float(fit.scores([Hypothesis(order, late)])[0].mean())
    found: Hypothesis | None = None
    for step in range(count):
        exchanged = suspects(fit.agreement(order))
        orders = distinct_orders(positions, exchanged) if step == 0 else _next(order, exchanged)
        hypotheses = [Hypothesis(candidate, late) for candidate in orders]
        if not hypotheses:
            return found
        misfits = 1.0 - fit.scores(hypotheses).mean(axis=-1)
        best = int(misfits.argmin())
        if misfits[best] >= STEP * misfit:
            return found
        found, order, misfit = hypotheses[best], orders[best], float(misfits[best])
        if count <= ALL_ORDERS:
            return found
    return found


def moved(order: Order) -> int:
    """Number of channels that are not at their own microphone."""
    return sum(index != channel for index, channel in enumerate(order))


def _orders(count: int, exchanged: Sequence[int]) -> Iterable[Order]:
    if count <= ALL_ORDERS:
        yield from permutations(range(count))
        return
    yield from _next(tuple(range(count)), exchanged)
    for turn in range(1, count):
        yield tuple((index + turn) % count for index in range(count))


def _next(order: Order, exchanged: Sequence[int]) -> list[Order]:
    """Copies of ``order`` with the channels of two microphones of ``exchanged`` swapped."""
    following = []
    for first, second in combinations(exchanged, 2):
        changed = list(order)
        changed[first], changed[second] = changed[second], changed[first]
        following.append(tuple(changed))
    return following


def _distances(positions: FloatArray, order: Order) -> FloatArray:
    """Distances (N, N) between the microphones of channels 0 to N - 1 under ``order``."""
    return pairwise_distances(positions[np.argsort(order)])

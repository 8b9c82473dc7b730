"""The stages of a neural window one by one, each on what the stage before gives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.features import unit_vectors_and_power
from service.doa.peaks import find_peaks
from service.doa.types import FloatArray
from service.inference.bundle import Bundle
from service.inference.candidates import block_fusion, find_findings
from service.inference.descriptors import describe
from service.inference.weights import (
    CandidateSearch,
    analysis_of,
    block_means,
    cell_covariances,
    principal_eigenvectors,
)

Stage = tuple[str, Callable[[Any], object], Sequence[Any]]
"""Name, work and what it is done on"""


def window_stages(
    bundle: Bundle, array: MicrophoneArray, windows: Sequence[FloatArray]
) -> Iterator[Stage]:
    """Every stage of ``CandidateSearch`` and ``SourceCounter`` with its inputs.

    ``fusion`` and ``peaks`` alternate in the search, up to four times; here each is all its rounds.
    """
    search = CandidateSearch(bundle.covariance, analysis_of(bundle), array)
    yield "stft", lambda window: search.spectra(window[None]), windows
    spectra = [search.spectra(window[None]) for window in windows]
    yield "features", lambda each: search.features(*unit_vectors_and_power(each)), spectra
    frames = [unit_vectors_and_power(each) for each in spectra]
    features = [search.features(*each) for each in frames]
    yield "covariance_net", search.weigh, features
    weighed = [search.weigh(each) for each in features]
    pairs = [(unit[0], weights[0]) for (unit, _), (weights, _) in zip(frames, weighed, strict=True)]
    yield "covariance", lambda pair: cell_covariances(*pair), pairs
    covariances = [cell_covariances(*pair) for pair in pairs]
    yield "evd", principal_eigenvectors, covariances
    principals = [principal_eigenvectors(covariance) for covariance in covariances]
    yield "spectrum", lambda principal: search.cell_spectra(principal[0]), principals
    fields = [
        search.field(search.cell_spectra(vectors), block_means(attention[0]), dominance)
        for (vectors, dominance), (_, attention) in zip(principals, weighed, strict=True)
    ]
    found = [(field, find_findings(field)) for field in fields]
    yield (
        "fusion",
        lambda each: [block_fusion(each[0].cells, f.remaining) for f in each[1]],
        found,
    )
    yield (
        "peaks",
        lambda each: ([find_peaks(f.fused, 2) for f in each[1]], describe(*each)),
        found,
    )
    descriptors = [np.pad(describe(*each), [(0, 4 - len(each[1])), (0, 0)])[None] for each in found]
    yield "count_net", lambda each: bundle.source_count.run([each]), descriptors

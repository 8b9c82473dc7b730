"""The stages of a neural window one by one, each on the output of the previous one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.features import coherences, unit_vectors_and_power
from service.doa.fusion import attention_fusion
from service.doa.peaks import find_peaks
from service.doa.types import ComplexArray, FloatArray
from service.inference.bundle import Bundle
from service.inference.candidates import find_findings, refine
from service.inference.descriptors import describe
from service.inference.weights import (
    CandidateSearch,
    analysis_of,
    block_means,
    cell_covariances,
    principal_eigenvectors,
    strongest_blocks,
)

Stage = tuple[str, Callable[[Any], object], Sequence[Any]]
"""Name, function and its inputs"""


def window_stages(
    bundle: Bundle, array: MicrophoneArray, windows: Sequence[FloatArray]
) -> Iterator[Stage]:
    """Every stage of ``CandidateSearch`` and ``SourceCounter`` with its inputs.

    ``fusion`` and ``peaks`` alternate in the search, up to four times. Here each stage is all its
    rounds, and the peaks of two sources are found again.
    """
    analysis = analysis_of(bundle)
    search = CandidateSearch(bundle.covariance, analysis, array)
    yield "stft", lambda window: search.spectra(window[None]), windows
    spectra = [search.spectra(window[None])[0] for window in windows]
    yield "features", lambda each: _features(search, each)[1], spectra
    frames = [_features(search, each) for each in spectra]
    features = [each for _, each in frames]
    yield "covariance_net", search.weigh, features
    weighed = [search.weigh(each) for each in features]
    means = [block_means(attention) for _, attention in weighed]
    chosen = [strongest_blocks(each, analysis.kept_share) for each in means]
    units = [unit for unit, _ in frames]
    weights = [each for each, _ in weighed]
    formed = list(zip(units, weights, chosen, strict=True))
    yield "covariance", lambda each: cell_covariances(*each), formed
    covariances = [cell_covariances(*each) for each in formed]
    yield "evd", principal_eigenvectors, covariances
    principals = [principal_eigenvectors(covariance) for covariance in covariances]
    yield "spectrum", lambda principal: search.cell_spectra(principal[0]), principals
    fields = [
        search.field_of_chosen(vectors, attention, blocks, dominance)
        for (vectors, dominance), attention, blocks in zip(principals, means, chosen, strict=True)
    ]
    found = [(field, find_findings(field)) for field in fields]
    yield (
        "fusion",
        lambda each: [attention_fusion(each[0].cells, f.remaining) for f in each[1]],
        found,
    )
    yield (
        "peaks",
        lambda each: (
            [find_peaks(f.fused, 2) for f in each[1]],
            describe(*each),
            refine(each[0], each[1][:2]),
        ),
        found,
    )
    descriptors = [np.pad(describe(*each), [(0, 4 - len(each[1])), (0, 0)])[None] for each in found]
    yield "count_net", lambda each: bundle.source_count.run([each]), descriptors


def _features(search: CandidateSearch, spectra: ComplexArray) -> tuple[ComplexArray, FloatArray]:
    unit, power = unit_vectors_and_power(spectra)
    return unit, search.features(coherences(unit), power)

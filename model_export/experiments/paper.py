"""Figures that the paper, its notebook and its plots report, for comparison with ours.

Figures are MAAE in degrees unless said otherwise. Missing ones are not in the text, or copy another
cell. Curves are read off plots, to about a tenth of a degree. The classical rows of two sources are
near chance (two random guesses give 71, one right peak counted twice 45): the authors' code looks
for one peak only, so these rows are no bar for a method that is run correctly.
"""

from __future__ import annotations

from collections.abc import Mapping

Row = Mapping[str, float]

MAIN: Mapping[str, Row] = {
    "music": {"M=1": 3.96, "M=2": 47.77, "unknown": 25.87},
    "norm_music": {"M=1": 1.97, "M=2": 55.9, "unknown": 28.9},
    "srp_phat": {"M=1": 2.47, "M=2": 61.5, "unknown": 32.0},
    "tops": {"M=1": 5.14, "M=2": 49.8, "unknown": 27.5},
    "waves": {"M=1": 17.0},
    "frida": {"M=1": 13.0, "M=2": 41.4, "unknown": 27.2},
    "transformer": {"M=1": 1.77},
    "doanet": {"M=1": 1.48},
    "deepdae": {"M=1": 4.05},
    "deepmusic": {"M=1": 2.38},
    "da_music": {"M=1": 4.29},
    "neuralmusic": {"M=1": 1.39, "M=2": 2.25, "unknown": 2.14},
}
"""Google Speech Commands in the simulated room; for classical methods the paper's "unknown" is the
mean of the other two columns"""

RECORDINGS: Mapping[str, Row] = {
    "neuralmusic": {"AV16.3 M=1": 7.56, "AV16.3 M=2": 11.16, "SLoClas": 2.91, "AFPILD": 10.24},
    "norm_music": {"SLoClas": 5.96, "AFPILD": 15.90},
    "music": {"SLoClas": 8.93},
    "da_music": {"SLoClas": 4.87},
    "transformer": {"SLoClas": 3.59},
    "crnn": {"AFPILD": 10.55},
}
"""Data sets of recordings"""

ABLATION: Mapping[str, Row] = {
    "complete": {"M=1": 1.39, "M=2": 2.25, "AFPILD": 10.24},
    "without FAF": {"AFPILD": 10.42},
    "without SSCL": {"M=1": 1.53},
}

SHARES = (20, 40, 60, 80, 100)
"""Percent of the training data"""
SHARE: Mapping[str, tuple[float, ...]] = {
    "neuralmusic": (2.22, 1.75, 1.59, 1.51, 1.41),
    "neuralmusic, without SSCL": (2.61, 2.1, 1.85, 1.62, 1.53),
    "doanet": (3.74, 2.45, 1.91, 1.59, 1.48),
    "deepmusic": (5.17, 3.84, 3.63, 3.07, 2.38),
    "deepdae": (8.4, 5.73, 4.94, 4.36, 4.05),
    "da_music": (6.11, 5.4, 4.83, 4.59, 4.29),
}
"""One source, over ``SHARES``"""

SNRS_DB = (-5, 0, 5, 10, 15, 20)
SNR: Mapping[str, tuple[float | None, ...]] = {
    "neuralmusic": (8.2, 5.29, 3.8, 2.9, 2.2, 1.85),
    "doanet": (7.6, 5.0, 3.6, 2.6, 2.15, 1.8),
    "deepmusic": (10.7, 7.2, 5.3, 4.1, 4.05, 2.9),
    "deepdae": (14.5, 9.9, 7.6, 6.1, 5.2, 4.4),
    "da_music": (13.8, 9.4, 7.1, 5.8, 4.9, 4.6),
    "music": (17.5, 11.3, 8.0, 6.4, 5.3, None),
    "norm_music": (16.3, 9.0, 5.8, 3.8, 3.0, 2.4),
    "srp_phat": (37, 23, 14, 8.9, 5.6, 4.1),
    "tops": (50, 34, 21, 13, 8.9, 6.9),
}
"""One source, over ``SNRS_DB``"""

TRANSFER: Mapping[str, Row] = {
    "neuralmusic": {"room B": 2.20, "room C": 1.71, "array B": 2.42, "array C": 3.07},
    "norm_music": {"array B": 2.41, "array C": 2.91},
}
"""One source, no fine-tuning; the paper does not say what its rooms and arrays B and C are"""

SPARSE: Mapping[str, Row] = {"neuralmusic": {"5°": 1.89, "10°": 2.35}}
"""One source, trained on directions this far apart only"""

"""All methods' spectra side by side: one to three talkers, and one in noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from model_export.evaluation.drawing import save, style
from model_export.experiments.cells import Cell
from model_export.experiments.contenders import (
    classical_contenders,
    matched_contenders,
    shipped_contenders,
    title,
)
from model_export.experiments.outcome import Outcome
from model_export.experiments.study import Contender, Study, heard
from service.doa.types import FloatArray

SHOWN = (Cell("test-1"), Cell("test-2"), Cell("test-3"), Cell("test-1", snr_db=0.0))
SCENE = 0
"""Index of the scene that is shown: the first of every test set, not a chosen one"""


def spectra(study: Study, figures: Path) -> Outcome:
    """A polar spectrum per method and scene, with the talkers' directions."""
    contenders = study.only(
        [*classical_contenders(), *matched_contenders(), *shipped_contenders(any_array=True)]
    )
    study.simulate(cell.scenes for cell in SHOWN)
    study.train(each.training for each in contenders if each.training)
    figure = Figure(figsize=(2.0 * len(SHOWN), 1.9 * len(contenders)), layout="constrained")
    projection = {"projection": "polar"}
    grid = figure.subplots(len(contenders), len(SHOWN), squeeze=False, subplot_kw=projection)
    for row, contender in zip(grid, contenders, strict=True):
        for panel, cell in zip(row, SHOWN, strict=True):
            _draw(panel, study, contender, cell)
        row[0].set_ylabel(title(contender.label), fontsize=7, labelpad=18)
    for panel, heading in zip(grid[0], ("M=1", "M=2", "M=3", "M=1, 0 dB"), strict=True):
        panel.set_title(heading, fontsize=9)
    name = save(figure, figures, "spectra", dpi=90)
    text = (
        "Spectra of the first scene of each test set, scaled to their own range; red lines are the "
        "talkers, dots the method's estimates with the count known. Methods without a spectrum "
        "show their estimates only."
    )
    return Outcome(text, (), (("Spectra of all methods", name),))


def _draw(panel, study: Study, contender: Contender, cell: Cell) -> None:  # type: ignore[no-untyped-def]
    scenes = study.scenes(cell.scenes)
    truth = scenes.sources(SCENE)
    audio = heard(scenes, SCENE, cell.snr_db)
    estimate = study.method(contender).localize(audio, scenes.array, len(truth))
    if estimate.spectrum is not None:
        panel.plot(*_closed(estimate.spectrum), color=style(contender.label)["color"], lw=1)
    panel.vlines(truth, 0, 1.05, color="#d1495b", lw=0.8)
    panel.plot(estimate.azimuth, np.ones(len(estimate.azimuth)), "o", color="#1f2937", ms=2.5)
    panel.set(ylim=(0, 1.1), xticks=np.deg2rad([0, 90, 180, 270]), yticks=[])
    panel.tick_params(labelsize=5, pad=-4)


def _closed(spectrum: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Azimuths and heights from 0 to 1 around the whole circle."""
    low, high = float(spectrum.min()), float(spectrum.max())
    scaled = (spectrum - low) / max(high - low, 1e-12)
    azimuth = np.arange(len(spectrum) + 1) * (2 * np.pi / len(spectrum))
    return azimuth, np.append(scaled, scaled[0])

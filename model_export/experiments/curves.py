"""Experiments shown as curves: error over the share of the training data and over the SNR."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from model_export.evaluation.drawing import axes, save, style
from model_export.experiments import paper
from model_export.experiments.cells import Cell
from model_export.experiments.contenders import (
    NEURALMUSIC,
    classical_contenders,
    matched_contenders,
    shipped_contenders,
    title,
)
from model_export.experiments.outcome import Outcome, Rows, Table
from model_export.experiments.study import Contender, Study

WITHOUT_SSCL = "neuralmusic, without SSCL"


def training_share(study: Study, figures: Path) -> Outcome:
    """Networks trained on a random 20 to 100 percent of the scenes."""
    cell = Cell("test-1")
    curves: dict[str, list[float]] = {}
    for percent in paper.SHARES:
        variant: dict[str, object] = {"share": percent / 100}
        plain = Contender(WITHOUT_SSCL, replace(NEURALMUSIC, pretrained=False, share=percent / 100))
        contenders = study.only([*matched_contenders(**variant), plain])
        for label, found in study.scored(contenders, [cell]).items():
            curves.setdefault(label, []).append(found[cell]["maae_deg"])
    name = draw_curves(figures, "training-share", "percent of the training scenes", paper.SHARES,
                       curves)  # fmt: skip
    text = (
        "One talker, error in degrees over the share of the training scenes, drawn at random and "
        "the same for every method (the paper's code takes the first of a sorted list, which is "
        "biased to some directions). Every share is trained for the same number of epochs."
    )
    tables = _tables(paper.SHARES, curves, paper.SHARE, " %")
    return Outcome(text, tables, (("Error over the training share", name),))


def snr(study: Study, figures: Path) -> Outcome:
    """Methods scored on test scenes with added white noise."""
    scenes = study.scale.sweep_scenes
    cells = [Cell("test-1", snr_db=float(level), first=scenes) for level in paper.SNRS_DB]
    contenders = study.only(
        [*classical_contenders(), *matched_contenders(), *shipped_contenders(any_array=True)]
    )
    scores = study.scored(contenders, cells)
    curves = {label: [found[cell]["maae_deg"] for cell in cells] for label, found in scores.items()}
    name = draw_curves(figures, "snr", "SNR of the added noise in dB", paper.SNRS_DB, curves)
    text = (
        "One talker, error in degrees with white noise, independent at every microphone, added to "
        "the test scenes, which have 30 dB without it. One scene with an error of 90 degrees adds "
        f"{90 / scenes:.1f} degrees to these means."
    )
    tables = _tables(paper.SNRS_DB, curves, paper.SNR, " dB")
    return Outcome(text, tables, (("Error over the SNR", name),))


def draw_curves(
    folder: Path,
    name: str,
    label: str,
    points: Sequence[float],
    curves: Mapping[str, Sequence[float]],
) -> str:
    """Write a figure with one curve a method; returns its file's name."""
    figure, panel = axes(label, "mean absolute angular error in degrees")
    for method, errors in curves.items():
        panel.plot(points, errors, **style(method), label=title(method))
    panel.set_yscale("log")
    panel.set_yticks([1, 3, 10, 30, 90], ["1", "3", "10", "30", "90"])
    figure.legend(loc="outside right center", frameon=False, fontsize=7)
    return save(figure, folder, name)


def _tables(
    points: Sequence[float],
    curves: Mapping[str, Sequence[float]],
    reported: Mapping[str, Sequence[float | None]],
    unit: str,
) -> tuple[Table, Table]:
    columns = tuple(f"{point:g}{unit}" for point in points)
    ours: Rows = tuple((title(method), *errors) for method, errors in curves.items())
    theirs: Rows = tuple((title(method), *errors) for method, errors in reported.items())
    return Table(("method", *columns), ours), Table(("paper", *columns), theirs)

"""Self-supervised learning: its loss curve, its reconstructions, its latent features."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure

from model_export.baselines.matched import MatchedSubspace, matched_features
from model_export.baselines.network import LearnedMethod
from model_export.baselines.neuralmusic import CovarianceTrunk
from model_export.evaluation.drawing import OURS, axes, save
from model_export.experiments.cells import TRAIN
from model_export.experiments.contenders import NEURALMUSIC
from model_export.experiments.outcome import Outcome, Table
from model_export.experiments.scene_set import SceneSet
from model_export.experiments.study import SEED, Contender, Study
from model_export.experiments.training import SSCL, parameters
from model_export.training.masking import draw_mask, masked_features
from model_export.training.sscl import SsclPipeline, SsclTask
from model_export.training.task import STFT
from service.doa.types import BoolArray, ComplexArray, FloatArray

MASKS = ("a span of time", "a band of frequencies", "scattered cells")
PERPLEXITY = 15.0


def sscl_loss(study: Study, figures: Path) -> Outcome:
    """Loss curve of the self-supervised stage."""
    study.train([NEURALMUSIC])
    curve = json.loads((study.pretraining(TRAIN) / "curve.json").read_text())
    steps, losses = ([point[key] for point in curve] for key in ("step", "loss"))
    figure, panel = axes("step", "share of the masked power that is not reconstructed")
    panel.plot(steps, losses, ".-", color=OURS, lw=2)
    name = save(figure, figures, "sscl-loss")
    text = (
        "Self-supervised spatial correlation learning: a random microphone is masked and rebuilt "
        "from the others, without directions. The loss is relative, 1 for an empty "
        "reconstruction (`model_export/training/sscl.py` says how it differs from the paper's)."
    )
    rows = tuple(
        (f"{steps[i]:.0f}", losses[i]) for i in sorted({0, len(steps) // 2, -1 % len(steps)})
    )
    return Outcome(text, (Table(("step", "loss"), rows, 3),), (("SSCL loss", name),))


def reconstructions(study: Study, figures: Path) -> Outcome:
    """Masked, reconstructed and true spectrograms of one scene, one row for each kind of mask."""
    study.train([NEURALMUSIC])
    study.simulate(["test-1"])
    task = SsclTask(SSCL)
    task.model.load_state_dict(parameters(study.pretraining(TRAIN)))
    task.model.eval()
    spectra = STFT.transform(study.scenes("test-1").window(0)[None])
    figure = Figure(figsize=(9, 6.6), layout="constrained")
    grid = figure.subplots(len(MASKS), 3, sharex=True, sharey=True)
    shares = []
    for kind, (row, mask) in enumerate(zip(grid, _masks(spectra.shape[2:]), strict=True)):
        rebuilt = _reconstruction(task.model, spectra, mask)
        true = spectra[0, 0]
        error = np.sum(np.abs((rebuilt - true)[mask]) ** 2) / np.sum(np.abs(true[mask]) ** 2)
        shares.append((MASKS[kind], float(error)))
        for panel, shown in zip(row, (np.where(mask, 0, true), np.where(mask, rebuilt, true), true),
                                strict=True):  # fmt: skip
            level = 20 * np.log10(np.abs(shown) + 1e-6)
            panel.imshow(level, origin="lower", aspect="auto", vmin=-60, vmax=0, cmap="magma")
        row[0].set_ylabel(f"{MASKS[kind]}\nbin", fontsize=8)
    for panel, heading in zip(grid[0], ("masked", "reconstructed", "true"), strict=True):
        panel.set_title(heading, fontsize=9)
    name = save(figure, figures, "sscl-reconstructions", dpi=80)
    text = (
        "Microphone 0 of the first test scene, masked in three ways, and its reconstruction from "
        "the other three microphones; levels in dB. The table has the share of the masked power "
        "that is not reconstructed, noise included."
    )
    table = Table(("mask", "unexplained"), tuple(shares), 3)
    return Outcome(text, (table,), (("SSCL reconstructions", name),))


def latent_features(study: Study, figures: Path) -> Outcome:
    """t-SNE of the latent covariance features, before and after the supervised stage."""
    from sklearn.manifold import TSNE
    from sklearn.neighbors import NearestNeighbors

    study.train([NEURALMUSIC])
    study.simulate(["test-1"])
    scenes = study.scenes("test-1")
    azimuth = np.array([scenes.sources(index)[0] for index in range(len(scenes))])
    figure = Figure(figsize=(9, 4.2), layout="constrained")
    panels = figure.subplots(1, 2)
    rows = []
    for panel, (stage, features) in zip(panels, _latent(study, scenes).items(), strict=True):
        perplexity = min(PERPLEXITY, (len(features) - 1) / 3)
        placed = TSNE(perplexity=perplexity, init="pca", random_state=SEED).fit_transform(features)
        points = panel.scatter(*placed.T, c=np.rad2deg(azimuth), cmap="hsv", vmin=0, vmax=360, s=14)
        panel.set(title=stage, xticks=[], yticks=[])
        nearest = NearestNeighbors(n_neighbors=2).fit(features).kneighbors(features)[1][:, 1]
        gaps = np.abs((azimuth[nearest] - azimuth + np.pi) % (2 * np.pi) - np.pi)
        rows.append((stage, float(np.rad2deg(np.median(gaps)))))
    figure.colorbar(points, ax=panels, label="true azimuth in degrees")
    name = save(figure, figures, "latent")
    text = (
        "t-SNE of the encoder's latent covariance features, one point for each one-talker test "
        "scene, coloured by its direction. The table has the median angle between a scene and its "
        "nearest neighbour among the features themselves (90 by chance)."
    )
    return Outcome(
        text, (Table(("encoder", "degrees"), tuple(rows)),), (("Latent features", name),)
    )


def _masks(shape: tuple[int, ...]) -> list[BoolArray]:
    """One mask of every kind, the first of each that the seed draws."""
    found: dict[str, BoolArray] = {}
    rng = np.random.default_rng(SEED)
    while len(found) < len(MASKS):
        mask = draw_mask(rng, *shape)
        kind = 0 if mask.all(axis=0).any() else 1 if mask.all(axis=1).any() else 2
        found.setdefault(MASKS[kind], mask)
    return [found[kind] for kind in MASKS]


@torch.no_grad()
def _reconstruction(model: SsclPipeline, spectra: ComplexArray, mask: BoolArray) -> ComplexArray:
    """Reconstruction (F, L) of microphone 0 of spectra (1, N, F, L), in their scale."""
    power = np.sqrt(np.maximum((np.abs(spectra) ** 2).sum(axis=1, keepdims=True), 1e-30))
    microphone = np.zeros(1, dtype=np.int64)
    features = torch.from_numpy(masked_features(spectra, microphone, mask[None]))
    unit = torch.from_numpy((spectra / power).astype(np.complex64))
    rebuilt: ComplexArray = model(features, unit, torch.from_numpy(microphone))[0].numpy()
    return rebuilt * power[0, 0]


@torch.no_grad()
def _latent(study: Study, scenes: SceneSet) -> dict[str, FloatArray]:
    """Latent features (S, D) of every scene, after each stage."""
    audio = np.stack([scenes.window(index) for index in range(len(scenes))])
    features = torch.from_numpy(matched_features(audio))
    pretrained = SsclTask(SSCL).model
    pretrained.load_state_dict(parameters(study.pretraining(TRAIN)))
    method = study.method(Contender("neuralmusic", NEURALMUSIC))
    assert isinstance(method, LearnedMethod)
    assert isinstance(method.network, MatchedSubspace)
    trunk = method.network.trunk
    assert isinstance(trunk, CovarianceTrunk)
    encoders = {"self-supervised only": pretrained.encoder.eval(), "after training": trunk.encoder}
    return {
        stage: np.concatenate([encoder(part).flatten(1).numpy() for part in features.split(16)])
        for stage, encoder in encoders.items()
    }

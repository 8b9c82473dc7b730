"""The `weights` variant: networks weigh cells, covariances of any array form outside them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, starmap

import numpy as np

from neuralmusic.protocol.methods import Hemisphere
from service.doa.array import MicrophoneArray
from service.doa.covariance import chosen_and_sum, diagonal_loading, weighted_covariance
from service.doa.evd import principal_eigenvector
from service.doa.features import coherences, unit_vectors_and_power, window_features
from service.doa.hemisphere import searched_directions
from service.doa.orientation import turned
from service.doa.pose import Rotation
from service.doa.rank_one import RankOneMusic, shared_music
from service.doa.sphere import NUM_AZIMUTHS
from service.doa.steering import (
    azimuth_grid,
    resolution,
    sphere_resolution,
    steering_vectors,
)
from service.doa.stft import Stft
from service.doa.types import ComplexArray, FloatArray, IntArray
from service.doa.whitening import NoiseCovariance, Whitening, whitened_steering
from service.inference.bundle import Bundle
from service.inference.candidates import Candidates, find_candidates
from service.inference.engine import Engine
from service.inference.field import Field
from service.inference.results import WindowEstimate, nothing_heard
from service.inference.source_counter import SourceCounter
from service.inference.sphere_field import Sphere, SphereField
from service.inference.windows import Stretch, sliding

BLOCK_FRAMES = 8
SMALL_APERTURE = 0.3
"""Largest aperture in metres for which the bundle's grid of azimuths finds peaks as well as one
twice as fine (docs/performance.md); larger arrays get the fine one"""
TRAINED_BLOCKS = 8
"""Blocks in the windows that networks are trained on"""
HALF = np.float32(0.5)
"""Share of the blocks that are kept where a bundle names none"""
LEAST_DOMINANCE = np.float32(1e-4)
CELL_LOADING = 1e-6
"""Diagonal loading against the frames' unit power: blocks that the network all but drops lose
their dominance"""


@dataclass(frozen=True, slots=True)
class Analysis:
    """A bundle's parameters for the search, besides its covariance network."""

    stft: Stft
    first_bin: int
    num_bins: int
    grid_size: int
    """Number of azimuths in a small array's spectra"""
    floor: float
    """MUSIC's floor for an array that resolves everything; it sets the width of the peaks"""
    dominance_power: float
    """Exponent of the dominance in the attention"""
    window_share: float
    """Attention of a bin's whole window against the sum of its blocks'"""
    kept_share: float
    """Share of a bin's blocks, the most attended, for which spectra are computed"""
    bins_per_cell: int = 1
    """Neighbouring bins that share a covariance; more than one only without whitening"""


class CandidateSearch:
    """From windows of one array's audio to candidate sources, before any count."""

    def __init__(
        self,
        covariance: Engine,
        analysis: Analysis,
        array: MicrophoneArray,
        noise: NoiseCovariance | None = None,
        hemisphere: Hemisphere = "both",
    ) -> None:
        self._covariance = covariance
        self._array = array
        self._analysis = analysis
        self._bins = slice(analysis.first_bin, analysis.first_bin + analysis.num_bins)
        every = analysis.stft.frequencies[self._bins]
        frequencies = every.reshape(-1, analysis.bins_per_cell).mean(axis=-1)
        whitening = None
        if noise is not None:
            whitening = Whitening.fitting(noise, array, analysis.stft).band(self._bins)
        self._whitening = whitening
        positions = array.steered
        directions = searched_directions(array, hemisphere)
        self._sphere: Sphere | None = None
        if directions is None:
            grid_size = analysis.grid_size * (1 if array.aperture <= SMALL_APERTURE else 2)
            # The floor shrinks for small arrays, whose spectra would else be one broad peak.
            self._resolution = resolution(positions, frequencies)
            floor = analysis.floor * self._resolution
            if whitening is None:
                self._music = shared_music(positions, frequencies, grid_size, floor)
            else:
                steering = steering_vectors(positions, frequencies, azimuth_grid(grid_size))
                self._music = RankOneMusic(whitening.steering(steering), floor)
        else:
            grid_size = NUM_AZIMUTHS
            self._resolution = sphere_resolution(positions, frequencies)
            floor = analysis.floor * self._resolution
            steering_of = partial(whitened_steering, whitening, positions, frequencies)
            self._sphere = Sphere(directions, steering_of, floor)
            self._music = RankOneMusic(steering_of(directions.vectors), floor)
        self.nothing = nothing_heard(grid_size, sphere=directions is not None)
        """The estimate of silence"""

    def candidates(self, windows: FloatArray) -> Iterator[Candidates]:
        """Candidate sources of every window (B, N, T), before counting.

        Candidates hold their window's spectra: take them one by one.
        """
        unit, power = unit_vectors_and_power(self.spectra(windows))
        return self._candidates(unit, power, coherences(unit))

    def candidates_of(self, stretch: Stretch) -> Iterator[Candidates]:
        """Candidate sources of every window of a stretch.

        STFT and coherence of frames that windows share are computed once. A window in which the
        recording ends is cut there: sound that breaks off into padding looks like a source.
        """
        stft = self._analysis.stft
        heard = stretch.heard[-1]
        if heard < stretch.length - (stft.n_fft - stft.hop):
            last = self.candidates(stretch.windows[-1:, :, : max(heard, stft.n_fft)])
            if len(stretch.heard) == 1:
                return last
            return chain(self.candidates_of(stretch.without_last()), last)
        frames = whole_blocks(stft.num_frames(stretch.length))
        if stretch.hop % stft.hop or frames > stft.num_frames(stretch.length):
            return self.candidates(stretch.windows)
        unit, power = unit_vectors_and_power(self.band(stft.transform(stretch.audio)))
        hop = stretch.hop // stft.hop
        return self._candidates(
            sliding(unit, frames, hop),
            sliding(power, frames, hop),
            sliding(coherences(unit), frames, hop),
        )

    def _candidates(
        self, unit: ComplexArray, power: FloatArray, coherence: FloatArray
    ) -> Iterator[Candidates]:
        """Candidates from unit vectors (B, N, F, L), powers (B, F, L), coherences (B, 3, F, L)."""
        # One window at a time: a stage's output is in the cache for the next stage.
        return starmap(self._search, zip(unit, power, coherence, strict=True))

    def _search(self, unit: ComplexArray, power: FloatArray, coherence: FloatArray) -> Candidates:
        weights, attention = self.weigh(self.features(coherence, power))
        means = block_means(attention)
        chosen = strongest_blocks(means, self._analysis.kept_share)
        principal, dominance = principal_eigenvectors(cell_covariances(unit, weights, chosen))
        return find_candidates(self.field_of_chosen(principal, means, chosen, dominance))

    def field_of_chosen(
        self,
        principal: ComplexArray,
        attention: FloatArray,
        chosen: IntArray,
        dominance: FloatArray,
    ) -> Field:
        """The ``field`` of the blocks (R, F) chosen in every bin, with all attention (K, F).

        ``principal`` (R + 1, F, N) are their eigenvectors and the whole window's.
        """
        whole = np.full((1, chosen.shape[1]), len(attention))
        total = attention.sum(axis=0, keepdims=True)
        return self.field(
            self.cell_spectra(principal),
            np.concatenate([np.take_along_axis(attention, chosen, axis=0), total]),
            np.concatenate([chosen, whole]).T.ravel(),
            len(attention),
            dominance,
            principal,
        )

    def field(
        self,
        cells: FloatArray,
        attention: FloatArray,
        block: IntArray,
        blocks: int,
        dominance: FloatArray,
        principal: ComplexArray,
        turns: Sequence[Rotation] | None = None,
    ) -> Field:
        """The field in which candidates are found: R blocks of every bin and its whole window.

        Parameters
        ----------
        cells : (F, R + 1, A)
            Spectra.
        attention : (R + 1, F)
            Attention of the blocks and, last, its sum.
        block : (F (R + 1),)
            Block of every cell, bin by bin; the whole window's is ``blocks``.
        blocks : int
            Number of blocks.
        dominance : (R + 1, F)
        principal : (R + 1, F, N)
        turns : (R + 1,), optional
            Rotations into the field's frame, where blocks were heard in others.
        """
        if turns is not None:
            cells = self._turned(cells, turns)
        attended = attention * dominance**self._analysis.dominance_power
        attended[-1] *= np.float32(self._analysis.window_share)
        parts = (
            cells.reshape(-1, cells.shape[-1]),
            attended.T.ravel(),
            dominance.T.ravel(),
            block,
            dominance.shape[1],
            blocks + 1,
            self._array,
            self._resolution,
        )
        if self._sphere is None:
            return Field(*parts)
        return SphereField(*parts, np.swapaxes(principal, 0, 1), self._sphere, turns)

    def _turned(self, cells: FloatArray, turns: Sequence[Rotation]) -> FloatArray:
        """Spectra (F, R + 1, A) of blocks that were heard in other frames."""
        if self._sphere is not None:
            grid, matrices = self._sphere.grid, [turn.matrix for turn in turns]
            rows = [grid.turned(cells[:, row], matrix) for row, matrix in enumerate(matrices)]
        else:
            rows = [turned(cells[:, row], turn.yaw) for row, turn in enumerate(turns)]
        return np.stack(rows, axis=1)

    def spectra(self, windows: FloatArray) -> ComplexArray:
        """STFT of the band in whole blocks of frames: (B, N, F, L) complex64, whitened.

        Up to half a block of frames at the end is left out; more is padded with zeros.
        """
        spectra = self.band(self._analysis.stft.transform(windows))
        frames = spectra.shape[-1]
        wanted = whole_blocks(frames)
        if wanted > frames:
            spectra = np.pad(spectra, [(0, 0)] * (spectra.ndim - 1) + [(0, wanted - frames)])
        return spectra[..., :wanted]

    def band(self, spectra: ComplexArray) -> ComplexArray:
        """The used bins of spectra (..., N, F, L), whitened."""
        band: ComplexArray = spectra[..., self._bins, :]
        return band if self._whitening is None else self._whitening.apply(band)

    def features(self, coherence: FloatArray, power: FloatArray) -> FloatArray:
        """The covariance network's input (5, L, F) of a window's coherences and powers."""
        return np.swapaxes(window_features(coherence, power), -1, -2)

    def weigh(self, features: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A window's weights and attentions (F, L) from the covariance network."""
        weights, attention = self._covariance.run([features[None]])
        return weights[0].T, attention[0].T

    def cell_spectra(self, principal: ComplexArray) -> FloatArray:
        """Rank-one MUSIC of every cell: (R, F, N) to (F, R, A) float32, maximum 1 each."""
        return self._music.spectra(principal)


def whole_blocks(frames: int) -> int:
    """The frames of the nearest number of blocks, at least one."""
    return max(1, round(frames / BLOCK_FRAMES)) * BLOCK_FRAMES


def cell_covariances(unit: ComplexArray, weights: FloatArray, chosen: IntArray) -> ComplexArray:
    """Covariances of a bin's chosen blocks and of its whole window.

    Blocks tell talkers apart; the whole window, their sum, averages most of the noise.
    ``unit`` (N, F, L), ``weights`` (F, L) and ``chosen`` (R, F) give (R + 1, F, N, N) complex64.
    """
    blocks = diagonal_loading(weighted_covariance(unit, weights, BLOCK_FRAMES), CELL_LOADING)
    return chosen_and_sum(blocks, chosen)


def kept_blocks(blocks: int, share: float) -> int:
    """Number of a bin's blocks that get eigenvectors and spectra.

    The others count next to nothing (docs/performance.md). Short windows keep as many as windows of
    the network's training.
    """
    return max(min(round(share * TRAINED_BLOCKS), blocks), int(share * blocks))


def strongest_blocks(attention: FloatArray, share: float) -> IntArray:
    """Ascending indices (R, F) of the most attended of every bin's blocks (K, F)."""
    count = kept_blocks(len(attention), share)
    order = np.argsort(attention, axis=0)[len(attention) - count :]
    return np.sort(order, axis=0)


def block_means(attention: FloatArray) -> FloatArray:
    """Means (K, F) of attentions (F, L) over blocks of frames."""
    blocks = attention.T.reshape(-1, BLOCK_FRAMES, len(attention))
    means: FloatArray = blocks.mean(axis=1)
    return means


def principal_eigenvectors(covariance: ComplexArray) -> tuple[ComplexArray, FloatArray]:
    """The signal subspace of rank one and its dominance.

    Parameters
    ----------
    covariance : (K, F, N, N) complex64

    Returns
    -------
    principal : (K, F, N) complex64
        Unit vectors.
    dominance : (K, F) float32
        Share of the largest eigenvalue: 0 in an isotropic field, 1 for a single plane wave.
    """
    vectors, share = principal_eigenvector(covariance)
    microphones = covariance.shape[-1]
    dominance = (share - np.float32(1 / microphones)) * np.float32(microphones / (microphones - 1))
    return vectors, np.minimum(np.maximum(dominance, LEAST_DOMINANCE), np.float32(1))


class WeightsLocalizer:
    """From windows of one array's audio to directions, with a `weights` bundle."""

    def __init__(
        self,
        bundle: Bundle,
        array: MicrophoneArray,
        noise: NoiseCovariance | None = None,
        hemisphere: Hemisphere = "both",
    ) -> None:
        self._counter = SourceCounter(bundle.source_count)
        self._search = CandidateSearch(
            bundle.covariance, analysis_of(bundle), array, noise, hemisphere
        )
        self.nothing = self._search.nothing

    def estimate(
        self, windows: FloatArray, num_sources: int | None, max_sources: int
    ) -> list[WindowEstimate]:
        """Directions of every window.

        Parameters
        ----------
        windows : (B, N, T) float32
            Audio at the bundle's sample rate.
        num_sources : int, optional
            Known count; None lets the source-count network decide.
        max_sources : int
            Largest estimated count.
        """
        return self._counter.select(self._search.candidates(windows), num_sources, max_sources)

    def estimate_stretch(
        self, stretch: Stretch, num_sources: int | None, max_sources: int
    ) -> list[WindowEstimate]:
        """Directions of every window of a stretch; the other parameters as in ``estimate``."""
        return self._counter.select(self._search.candidates_of(stretch), num_sources, max_sources)


def analysis_of(bundle: Bundle) -> Analysis:
    """The analysis parameters that a `weights` bundle holds."""
    manifest = bundle.manifest
    return Analysis(
        stft=bundle.stft,
        first_bin=manifest.first_bin,
        num_bins=manifest.num_bins,
        grid_size=manifest.grid_size,
        floor=float(bundle.fusion["floor"]),
        dominance_power=float(bundle.fusion["dominance_power"]),
        window_share=float(bundle.fusion["window_share"]),
        kept_share=float(bundle.fusion.get("kept_share", HALF)),
    )

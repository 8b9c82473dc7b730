"""A recording's windows that overlap by whole blocks, without computing anything twice.

The frames of a window pass the network once, with what came before them; its blocks' covariances,
eigenvectors and spectra serve all windows that hold them. At half a window's overlap a result costs
little more than half.
"""

from __future__ import annotations

from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray
from service.doa.whitening import NoiseCovariance
from service.inference.bundle import Bundle
from service.inference.localizer import Localizer, localizer_of
from service.inference.results import WindowEstimate
from service.inference.weights import BLOCK_FRAMES
from service.inference.weights_stream import LEVEL_FRAMES, StreamShape, WeightsStream


class OverlappingWindows:
    """A ``Localizer`` that is given all windows of one recording in their order.

    Parameters
    ----------
    hop_samples : int
        From one window to the next.
    """

    def __init__(self, stream: WeightsStream, bundle: Bundle, hop_samples: int) -> None:
        self._stream = stream
        self._stft = bundle.stft
        self._hop_samples = hop_samples
        self._began = False

    def estimate(
        self, windows: FloatArray, num_sources: int | None, max_sources: int
    ) -> list[WindowEstimate]:
        """Directions of the next windows (B, N, T)."""
        return [self._next(window, num_sources, max_sources) for window in windows]

    def _next(
        self, window: FloatArray, num_sources: int | None, max_sources: int
    ) -> WindowEstimate:
        new = window.shape[-1]
        if self._began:
            new = self._hop_samples + self._stft.n_fft - self._stft.hop
        self._began = True
        self._stream.push(self._stft.transform(window[:, -new:]))
        return self._stream.estimate(num_sources, max_sources)


def recording_localizer(
    bundle: Bundle,
    array: MicrophoneArray,
    noise: NoiseCovariance | None,
    window_samples: int,
    hop_samples: int,
) -> Localizer:
    """The localizer for one recording's windows, given in their order.

    Raises
    ------
    InvalidOption, NoiseMismatch
        As ``localizer_of``.
    """
    block = BLOCK_FRAMES * bundle.stft.hop
    blocks = window_samples // block
    aligned = window_samples % block == 0 and hop_samples % block == 0
    # Levels are relative to the mean of the network's training window.
    known = blocks * BLOCK_FRAMES <= LEVEL_FRAMES
    if (
        bundle.covariance_stream is None
        or not aligned
        or not known
        or hop_samples >= window_samples
    ):
        return localizer_of(bundle, array, noise)
    shape = StreamShape((1.0,) * blocks, pairs_bins=False)
    return OverlappingWindows(WeightsStream(bundle, array, noise, shape), bundle, hop_samples)

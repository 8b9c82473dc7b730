"""Localization in the caller's own process, for notebooks and scripts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Literal

from neuralmusic.errors import ChannelMismatch, InvalidOption, UnsupportedSampleRate
from neuralmusic.protocol.client_messages import MAX_SAMPLE_RATE, MIN_SAMPLE_RATE
from neuralmusic.protocol.methods import Hemisphere, Method
from neuralmusic.recordings.form import Array, Sectors, form_fields
from service.machine.environment import disable_telemetry

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from service.inference.registry import BundleRegistry
    from service.recordings.answers import LocalizationAnswer


def localize(
    recording: str | Path | BinaryIO | ArrayLike,
    sample_rate: int | None = None,
    *,
    array: Array,
    channel_map: Sequence[int] | str | None = None,
    model: str | None = None,
    method: Method | None = None,
    num_sources: int | None = None,
    max_sources: int | None = None,
    window_s: float | None = None,
    hop_s: float | None = None,
    yaw_deg: float | None = None,
    exclude_deg: Sectors | None = None,
    hemisphere: Hemisphere | None = None,
    noise: str | Path | None = None,
    spectrum: bool | Literal["sphere"] | None = None,
) -> LocalizationAnswer:
    """Directions of arrival in a recording, as ``POST /localize`` answers.

    The first call loads the models that ``NEURALMUSIC_MODELS`` names, and the embedded ones. Unless
    onnxruntime is loaded already, it is told not to report to its maker.

    Parameters
    ----------
    recording : path, binary file or (T, N) array
        A file that libsndfile reads, or samples of N channels: int16, int32, or floats of full
        scale 1.
    sample_rate : int
        Hertz, for an array alone.
    array : str, mapping or sequence
        The microphones: a preset's name, ``{"positions_m": [[x, y, z], ...]}``, or the positions
        alone, (N, 3) in metres.
    channel_map : sequence of int, optional
        The recording's channel of every microphone, from 0.
    model : str, optional
        A bundle's name; by default the first that fits the array.
    method : str, optional
        ``neural``, ``norm_music``, ``music``, ``srp_phat`` or ``gcc_phat``; by default
        ``neural`` where a bundle fits the array, else ``norm_music``.
    num_sources, max_sources : int, optional
        The known number of sources, or a bound on the estimated one.
    window_s, hop_s : float, optional
        Seconds of audio per result, and from one result to the next.
    yaw_deg : float, optional
        Degrees by which the array is turned counter-clockwise on the robot.
    exclude_deg : sequence of pairs, optional
        Sectors (from, to) in degrees in which nothing is reported.
    hemisphere : str, optional
        ``upper`` or ``lower``, the side of the horizontal plane on which all sources are: a level
        array then tells elevations.
    noise : path, optional
        A profile of the robot's own noise that ``neuralmusic noise`` wrote.
    spectrum : bool or str, optional
        Whether every window has its spatial spectrum, 360 values; ``"sphere"`` gives an image of
        the sphere instead, 36 elevations of 72 azimuths.

    Raises
    ------
    DoaError
        If the recording or an option cannot be used; ``code`` says why.
    """
    options = {
        "channel_map": channel_map,
        "model": model,
        "method": method,
        "num_sources": num_sources,
        "max_sources": max_sources,
        "window_s": window_s,
        "hop_s": hop_s,
        "yaw_deg": yaw_deg,
        "exclude_deg": exclude_deg,
        "hemisphere": hemisphere,
        "spectrum": spectrum,
    }
    disable_telemetry()
    from service.audio.recording import Recording
    from service.inference.noise_profile import load_noise
    from service.recordings.answers import LocalizationAnswer, WindowAnswer
    from service.recordings.localize import localize_recording
    from service.recordings.options import read_options

    asked = read_options(form_fields(array, options).items()).options
    if noise is not None:
        asked = replace(asked, noise=load_noise(Path(noise)))
    with Recording.open(_file(recording, sample_rate)) as opened:
        result = localize_recording(opened, asked, _registry())
    windows = [WindowAnswer.of(window) for window in result.windows]
    return LocalizationAnswer.of(result).model_copy(update={"windows": windows})


@cache
def _registry() -> BundleRegistry:
    from service.settings import load_settings
    from service.startup import load_registry

    return load_registry(load_settings())


def _file(recording: Any, sample_rate: int | None) -> Path | BinaryIO:
    """The recording as a path or a file; an array becomes a WAV file in memory."""
    is_path = isinstance(recording, str | Path)
    if sample_rate is not None and (is_path or hasattr(recording, "read")):
        raise InvalidOption("a file has its own sample_rate: give one for an array only")
    if is_path:
        return Path(recording)
    if hasattr(recording, "read"):
        file: BinaryIO = recording
        return file
    import numpy as np
    import soundfile

    samples, rate = np.asarray(recording), _rate(sample_rate)
    if samples.ndim == 2 and samples.shape[0] < samples.shape[1]:
        raise ChannelMismatch(
            f"samples have the shape {samples.shape}, but the channels come last, (T, N): "
            "transpose the array"
        )
    if samples.dtype not in (np.int16, np.int32):
        samples = samples.astype(np.float32)
    kind = {"i2": "PCM_16", "i4": "PCM_32", "f4": "FLOAT"}[samples.dtype.str[1:]]
    wav = BytesIO()
    soundfile.write(wav, samples, rate, format="WAV", subtype=kind)
    wav.seek(0)
    return wav


def _rate(sample_rate: int | None) -> int:
    """The sample rate of an array, a whole number of hertz."""
    import numpy as np

    if sample_rate is None:
        raise UnsupportedSampleRate("give the sample_rate of an array, in hertz")
    whole = isinstance(sample_rate, int | float | np.integer) and sample_rate == int(sample_rate)
    if not whole or not MIN_SAMPLE_RATE <= sample_rate <= MAX_SAMPLE_RATE:
        raise UnsupportedSampleRate(
            f"the sample_rate is {MIN_SAMPLE_RATE} to {MAX_SAMPLE_RATE} hertz, a whole number, but "
            f"{sample_rate!r} was given"
        )
    return int(sample_rate)

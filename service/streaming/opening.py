"""From ``start`` to a pipeline: the array, the channels, the method and the model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.stft import Stft
from service.doa.whitening import NoiseCovariance
from service.errors import (
    InvalidChannelMap,
    InvalidGeometry,
    InvalidOption,
    NoiseMismatch,
    UnknownNoise,
)
from service.inference.choice import (
    check_num_sources,
    choose_channels,
    choose_method,
    method_warnings,
)
from service.inference.noise_store import NoiseStore
from service.inference.registry import BundleRegistry
from service.inference.results import AudioWarning
from service.protocol.client_messages import ArrayChoice, Start
from service.protocol.server_messages import NoiseInUse, StreamArray, StreamModel, Timing
from service.streaming.pipeline import StreamPipeline, StreamPlan

DEFAULT_MODEL = "default"
CONVENTION = (
    "azimuth in degrees in [0, 360), counter-clockwise from +x; x forward, y left, z up; "
    "output.yaw_deg is added"
)


@dataclass(frozen=True, slots=True)
class OpenedStream:
    """A pipeline that is ready, and what it will work with."""

    plan: StreamPlan
    pipeline: StreamPipeline
    warnings: tuple[AudioWarning, ...]
    keep_noise: Callable[[NoiseCovariance], object] | None = None
    """Stores a calibration under the client's name; None where it has none"""
    client: str | None = None

    @property
    def array(self) -> StreamArray:
        array = self.plan.array
        return StreamArray(name=array.name, positions_m=array.positions.tolist())

    @property
    def model(self) -> StreamModel | None:
        bundle = self.plan.bundle
        if bundle is None:
            return None
        identity = bundle.identity
        return StreamModel(
            name=identity.name,
            version=identity.version,
            variant=identity.variant,
            sha256=identity.sha256,
        )

    @property
    def noise(self) -> NoiseInUse | None:
        noise = self.plan.noise
        if noise is None or self.client is None:
            return None
        return NoiseInUse(name=self.client, seconds=round(noise.seconds, 3))

    def timing(self, interval_ms: int) -> Timing:
        """When results come at this interval."""
        stft = self.plan.stft
        frame_ms = 1000 * stft.n_fft / stft.sample_rate
        return Timing(
            interval_ms=interval_ms,
            window_ms=round(1000 * self.pipeline.window_s, 1),
            algorithmic_latency_ms=round(frame_ms + interval_ms / 2, 1),
            sample_rate=stft.sample_rate,
        )


def open_stream(start: Start, registry: BundleRegistry, store: NoiseStore) -> OpenedStream:
    """Build what a stream needs; takes tens of milliseconds.

    Raises
    ------
    ArrayError, AudioError, OptionError
        If the start's parts do not fit each other or what is loaded.
    """
    array = read_array(start.array)
    if None not in (start.channel_map, start.array.channel_map):
        raise InvalidChannelMap("channel_map is given twice, in the start and in its array")
    channels = choose_channels(
        start.audio.channels, array, start.channel_map or start.array.channel_map
    )
    check_num_sources(start.output.num_sources, array)
    model = None if start.model == DEFAULT_MODEL else start.model
    method, bundle = choose_method(start.method, model, array, registry)
    stft = bundle.stft if bundle else Stft()
    plan = StreamPlan(start.audio, array, channels, method, bundle, stft)
    warnings = method_warnings(start.method, method, array)
    keep = partial(store.put, start.client) if start.client is not None else None
    noise = kept_noise(start, store)
    try:
        plan = replace(plan, noise=noise)
        pipeline = StreamPipeline(plan)
    except (NoiseMismatch, InvalidOption) as error:
        if noise is None:
            raise
        warnings.append(AudioWarning("noise_mismatch", f"{error.detail}; it is not used"))
        plan = replace(plan, noise=None)
        pipeline = StreamPipeline(plan)
    return OpenedStream(plan, pipeline, tuple(warnings), keep, start.client)


def kept_noise(start: Start, store: NoiseStore) -> NoiseCovariance | None:
    """The calibration kept for the client, unless it wants none or has none."""
    if start.client is None or start.noise == "none":
        return None
    try:
        return store.get(start.client).noise
    except UnknownNoise:
        return None


def read_array(choice: ArrayChoice) -> MicrophoneArray:
    """The preset of a name, or the array of given positions."""
    if choice.positions_m is not None:
        positions = np.array(choice.positions_m, dtype=np.float64)
        return MicrophoneArray(choice.name or "custom", positions, "the request")
    if choice.name is None:
        raise InvalidGeometry(
            'array holds neither a preset\'s name nor {"positions_m": [[x, y, z], ...]} in metres'
        )
    return preset(choice.name)

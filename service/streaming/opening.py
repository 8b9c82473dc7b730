"""From ``start`` to a pipeline: the array, the channels, the method and the model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.stft import Stft
from service.errors import InvalidChannelMap, InvalidGeometry
from service.inference.choice import (
    check_num_sources,
    choose_channels,
    choose_method,
    method_warnings,
)
from service.inference.registry import BundleRegistry
from service.inference.results import AudioWarning
from service.protocol.client_messages import ArrayChoice, Start
from service.protocol.server_messages import StreamArray, StreamModel, Timing
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


def open_stream(start: Start, registry: BundleRegistry) -> OpenedStream:
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
    warnings = tuple(method_warnings(start.method, method, array))
    return OpenedStream(plan, StreamPipeline(plan), warnings)


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

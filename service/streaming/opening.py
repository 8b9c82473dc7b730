"""From ``start`` to a pipeline: the array, the channels, the method and the model."""

from __future__ import annotations

from dataclasses import replace

from neuralmusic.errors import (
    InvalidChannelMap,
    InvalidOption,
    NoiseMismatch,
)
from neuralmusic.protocol.server_messages import StreamArray, StreamModel
from service.doa.stft import Stft
from service.inference.choice import (
    check_num_sources,
    choose_method,
    method_warnings,
    why_no_elevation,
)
from service.inference.geometry import choose_channels, given_array
from service.inference.registry import BundleRegistry
from service.inference.results import AudioWarning
from service.streaming.pipeline import StreamPipeline, StreamPlan
from service.streaming.work import Open, StreamOpened

DEFAULT_MODEL = "default"


def open_stream(work: Open, registry: BundleRegistry) -> tuple[StreamPipeline, StreamOpened]:
    """Build what a stream needs; takes tens of milliseconds.

    Raises
    ------
    ArrayError, AudioError, OptionError
        If the parts of ``start`` do not fit each other or the loaded models.
    """
    start = work.start
    array = given_array(start.array.name, start.array.positions_m)
    if None not in (start.channel_map, start.array.channel_map):
        raise InvalidChannelMap("channel_map is given twice, in the start and in its array")
    channels, assumed = choose_channels(
        start.audio.channels, array, start.channel_map or start.array.channel_map
    )
    check_num_sources(start.output.num_sources, array.num_microphones)
    model = None if start.model == DEFAULT_MODEL else start.model
    method, bundle = choose_method(start.method, model, array, registry)
    stft = bundle.stft if bundle else Stft()
    plan = StreamPlan(
        start.audio, array, channels, method, bundle, stft, work.noise, start.hemisphere
    )
    warnings = assumed + method_warnings(start.method, method, bundle, array)
    try:
        pipeline = StreamPipeline(plan)
    except (NoiseMismatch, InvalidOption) as error:
        if work.noise is None:
            raise
        warnings.append(AudioWarning("noise_mismatch", f"{error.detail}; it is not used"))
        plan = replace(plan, noise=None)
        pipeline = StreamPipeline(plan)
    return pipeline, opened(plan, pipeline, tuple(warnings))


def opened(
    plan: StreamPlan, pipeline: StreamPipeline, warnings: tuple[AudioWarning, ...]
) -> StreamOpened:
    """What the session tells its client about a pipeline."""
    model = None
    if plan.bundle is not None:
        identity = plan.bundle.identity
        model = StreamModel(
            name=identity.name,
            version=identity.version,
            variant=identity.variant,
            sha256=identity.sha256,
        )
    return StreamOpened(
        model=model,
        method=plan.method,
        array=StreamArray(
            name=plan.array.name,
            positions_m=plan.array.positions.tolist(),
            why_no_elevation=why_no_elevation(plan.array, plan.hemisphere, plan.bundle),
        ),
        channel_map=plan.channel_map,
        sample_rate=plan.stft.sample_rate,
        frame_s=plan.stft.n_fft / plan.stft.sample_rate,
        window_s=pipeline.window_s,
        noise_s=plan.noise.seconds if plan.noise else None,
        warnings=warnings,
        clock=pipeline.clock,
    )

"""Gain of a learnt noise profile: the command ``ego-noise``.

A talker in a room is localized beside the robot's own noise, with and without a profile learnt
from five other seconds of that noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np

from model_export import SAMPLE_RATE
from model_export.datasets.speech import Clip, load
from model_export.evaluation.cells import living_room
from model_export.evaluation.false_sources import (
    ARRAY,
    Noise,
    Sound,
    false_source_scores,
    noise_file,
    own_fan,
    own_motor,
)
from model_export.simulation.noise import unit_power
from model_export.simulation.protocol import SceneProtocol, SimulatedScene, simulate_scene
from neuralmusic.protocol.methods import METHODS, Method
from service.audio.recording import Recording
from service.doa.presets import preset
from service.doa.scoring import circular_error
from service.doa.stft import Stft
from service.doa.types import FloatArray
from service.doa.whitening import NoiseCovariance, learn_noise
from service.inference.classical import ClassicalLocalizer
from service.inference.localizer import Localizer, localizer_of
from service.inference.registry import BundleRegistry
from service.recordings.localize import localize_recording
from service.recordings.results import LocalizeOptions

PROTOCOL = SceneProtocol(room=living_room(0.3), snr_db=30.0, continuous=True)
"""Scenes of the talker, to which the robot's noise is added"""
LEARN_SECONDS = 5.0
NOISES: Mapping[str, Sound] = {
    "fan: tones from one place, air at every microphone": partial(own_fan, -45.0),
    "motor: all from one place, behind and below": partial(own_motor, -45.0),
    "motor: all from one place, behind": partial(own_motor, 0.0),
}


@dataclass(frozen=True, slots=True)
class Measurement:
    """Size and level of a measurement."""

    scenes: int
    snr_db: float
    """Level of the talker over the robot's noise, in dB"""
    alone_s: float
    """Length of the noise alone, in which every source is false, in seconds"""
    seed: int


@dataclass(frozen=True, slots=True)
class Score:
    """Scores of one method, with or without a profile."""

    noisy: FloatArray
    """(S,) errors in degrees of a talker beside the robot's noise"""
    quiet: FloatArray
    """(S,) errors in degrees of the talker alone"""
    false_sources: float
    """False sources a minute, in windows and summary, of the robot's noise alone"""


def learnt(sound: Sound, seed: int) -> NoiseCovariance:
    """The profile learnt from ``LEARN_SECONDS`` of a noise with an RMS of 0.02 of full scale."""
    array = preset(ARRAY)
    rng = np.random.default_rng([seed, 0])
    audio = unit_power(sound(rng, array.positions, round(LEARN_SECONDS * SAMPLE_RATE)))
    return learn_noise([0.02 * audio.astype(np.float32)], array, Stft())


def score(
    method: Method,
    sound: Sound,
    noise: NoiseCovariance | None,
    scenes: Sequence[SimulatedScene],
    measurement: Measurement,
    registry: BundleRegistry,
) -> Score:
    """Errors on scenes with and without the noise, and false sources of the noise alone."""
    options = LocalizeOptions(preset(ARRAY), method=method, noise=noise)
    localizer = _localizer(options, registry)
    level, seed = 10 ** (-measurement.snr_db / 20), measurement.seed
    noisy = [
        scene.audio + _beside(sound, scene, level, [seed, 1, index])
        for index, scene in enumerate(scenes)
    ]
    robot = noise_file(Noise("alone", sound, measurement.alone_s), options.array, seed)
    with Recording.open(robot) as recording:
        alone = false_source_scores(localize_recording(recording, options, registry))
    return Score(
        _errors(localizer, noisy, scenes),
        _errors(localizer, [scene.audio for scene in scenes], scenes),
        alone["false_sources_per_minute"],
    )


def _localizer(options: LocalizeOptions, registry: BundleRegistry) -> Localizer:
    if options.method == "neural":
        bundle = registry.for_array(options.array)
        assert bundle is not None
        return localizer_of(bundle, options.array, options.noise)
    assert options.method is not None
    return ClassicalLocalizer(options.method, options.array, noise=options.noise)


def _beside(sound: Sound, scene: SimulatedScene, level: float, seed: Sequence[int]) -> FloatArray:
    rng = np.random.default_rng(list(seed))
    audio = sound(rng, scene.array.positions, scene.audio.shape[1])
    return (level * unit_power(audio)).astype(np.float32)


def _errors(
    localizer: Localizer, audio: Sequence[FloatArray], scenes: Sequence[SimulatedScene]
) -> FloatArray:
    """Errors (S,) in degrees of the one source that is asked for."""
    estimates = localizer.estimate(np.stack(audio), 1, 1)
    found = np.array([estimate.sources[0].azimuth for estimate in estimates])
    truth = np.array([scene.azimuth[0] for scene in scenes])
    errors: FloatArray = np.rad2deg(circular_error(found, truth))
    return errors


def table(rows: Sequence[tuple[Method, str, Score]]) -> str:
    """The Markdown table of one noise."""
    head = (
        "| method | profile | median | mean | within 10° | false sources a minute, noise alone "
        "| noise absent: median | within 10° |\n|---|---|---|---|---|---|---|---|\n"
    )
    return head + "".join(
        f"| `{method}` | {profile} | {np.median(s.noisy):.1f}° | {s.noisy.mean():.1f}° "
        f"| {np.mean(s.noisy <= 10):.0%} | {s.false_sources:.0f} "
        f"| {np.median(s.quiet):.1f}° | {np.mean(s.quiet <= 10):.0%} |\n"
        for method, profile, s in rows
    )


def document(clips: Sequence[Clip], measurement: Measurement) -> str:
    """``docs/ego-noise.md``, measured with talkers drawn from the clips."""
    count, seed = measurement.scenes, measurement.seed
    chosen = np.random.default_rng(seed).permutation(len(clips))[:count]
    speech = load([clips[index] for index in chosen])
    protocol = replace(PROTOCOL, array=ARRAY)
    scenes = [simulate_scene(protocol, speech, [seed, index]) for index in range(count)]
    registry = BundleRegistry.load()
    parts = [HEAD.format(array=ARRAY, **asdict(measurement))]
    for name, sound in NOISES.items():
        profile = learnt(sound, seed)
        rows = [
            (
                method,
                "none" if noise is None else "learnt",
                score(method, sound, noise, scenes, measurement, registry),
            )
            for method in METHODS
            for noise in (None, profile)
        ]
        parts.append(f"## A {name}\n\n{table(rows)}")
    return "\n".join([*parts, FOOT])


HEAD = """# The robot's own noise

A robot learns the noise of its fans and motors once, from a recording in which nothing else sounds:

```sh
neuralmusic noise fans.wav --array respeaker-usb-4mic-v2 -o fans.npz
neuralmusic localize talk.wav --array respeaker-usb-4mic-v2 --noise fans.npz
```

or `PUT /noise/fans` with that file and `POST /localize?noise=fans`. The profile is the noise's
covariance per frequency; spectra and steering vectors are whitened with it, as in HARK's
generalised eigenvalue MUSIC.

Measured in simulation: {scenes} talkers 0.5 to 2 m from `{array}` in a room of 6 x 5 x 3 m with an
RT60 of 0.3 s, windows of 1.04 s, beside a noise 10 cm behind the array's centre at {snr_db:g} dB
SNR. The profile is learnt from 5 s of that noise with other random phases, speeds and air. False
sources, in windows and in the summary, are counted in {alone_s:g} s of the noise alone. In the
columns of errors one source is asked for. The network tells the first noise, the fan, from a talker
without any profile.

`python -m model_export ego-noise --speech-commands SPEECH_COMMANDS` writes this page.
"""

FOOT = """## What it costs

- A talker who stands exactly in the noise's direction is attenuated like the noise, by at most
  46 dB for four microphones.
- While the noise is absent, the network still finds the talker. The classical methods weigh all
  frequencies alike and lose accuracy: name the profile only while the motors run.
- A profile fits one place and one kind of noise. Learn it again when a fan is moved.
"""

"""Mistakes in recordings that the diagnostics name: the command ``mistakes``.

Real speech in a simulated room is recorded by a board of four microphones, each time with one
mistake in the recording or in its description.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import scipy.signal
import soxr

from model_export import SAMPLE_RATE
from model_export.evaluation.cells import living_room
from model_export.simulation.noise import unit_power
from model_export.simulation.rooms import impulse_responses
from model_export.simulation.scenes import convolve
from neuralmusic.errors import InvalidGeometry
from service.cli.inputs import open_recording
from service.doa.array import SPEED_OF_SOUND, MicrophoneArray
from service.doa.diagnostics import ChannelDiagnostics
from service.doa.presets import preset
from service.doa.steering import unit_vectors
from service.doa.types import FloatArray
from service.inference.geometry import choose_channels

ARRAY = "respeaker-usb-4mic-v2"
RT60 = 0.3
SNR_DB = 20.0
DISTANCE = (0.7, 2.0)
"""Range of the talker's distance in metres"""
AZIMUTHS = np.deg2rad(np.arange(8) * 45.0 + 10.0)
LEVEL = 0.05
"""RMS of the microphone signals relative to full scale"""
LATENCY_S = 0.016
"""Latency in seconds of a device's own processing"""


@dataclass(frozen=True, slots=True)
class Talk:
    """A correct recording, to which mistakes are made."""

    speech: FloatArray
    """(N, T) of unit power, without noise"""
    azimuth: FloatArray
    """(P,) radians, the talker's directions one after another, each for an equal time"""
    seed: tuple[int, ...]

    def noisy(self, speech: FloatArray | None = None) -> FloatArray:
        """The speech (N, T) with sensor noise added, scaled by ``LEVEL``, float32."""
        speech = self.speech if speech is None else speech
        rng = np.random.default_rng(self.seed)
        noise = 10 ** (-SNR_DB / 20) * rng.standard_normal(speech.shape, dtype=np.float32)
        return np.float32(LEVEL) * (speech + noise)


@dataclass(frozen=True, slots=True)
class Mistake:
    """A recording that is wrong, or a description of another array than the one that recorded."""

    name: str
    make: Callable[[Talk], FloatArray]
    """Makes the audio (4, T) that is diagnosed"""
    geometry: float = 1.0
    """Size of the described array relative to the one that recorded"""


def correct(talk: Talk) -> FloatArray:
    return talk.noisy()


def ordered(order: Sequence[int], talk: Talk) -> FloatArray:
    return talk.noisy()[list(order)]


def with_dead_channel(talk: Talk) -> FloatArray:
    audio = talk.noisy()
    audio[2] = 0
    return audio


def with_late_channel(talk: Talk) -> FloatArray:
    audio = talk.noisy()
    audio[1, 1:] = audio[1, :-1].copy()
    return audio


def with_inverted_channel(talk: Talk) -> FloatArray:
    audio = talk.noisy()
    audio[2] *= -1
    return audio


def first_of_six(process: Callable[[Talk, FloatArray], FloatArray], talk: Talk) -> FloatArray:
    """Channels 0 to 3 of a device whose channel 0 is processed and not a microphone."""
    raw = talk.noisy()
    return np.concatenate([process(talk, raw)[None], raw[:3]])


def beamformed(talk: Talk, raw: FloatArray) -> FloatArray:
    """Delay-and-sum beam (T,) towards the talker."""
    parts = np.array_split(raw, len(talk.azimuth), axis=1)
    positions = preset(ARRAY).positions
    beams = []
    for part, azimuth in zip(parts, talk.azimuth, strict=True):
        advance = positions @ unit_vectors(np.array(azimuth)) / SPEED_OF_SOUND
        omega = 2 * np.pi * np.fft.rfftfreq(part.shape[1], 1 / SAMPLE_RATE)
        aligned = np.fft.rfft(part) * np.exp(-1j * omega * advance[:, None])
        beams.append(np.fft.irfft(aligned.mean(axis=0), part.shape[1]))
    return np.concatenate(beams).astype(np.float32)


def enhanced(latency_s: float, talk: Talk, raw: FloatArray) -> FloatArray:
    """The beam after noise suppression and automatic gain control, ``latency_s`` late."""
    options = {"fs": SAMPLE_RATE, "nperseg": 512, "noverlap": 384}
    _, _, spectra = scipy.signal.stft(beamformed(talk, raw), **options)
    power = np.abs(spectra) ** 2
    noise = np.quantile(power, 0.1, axis=1, keepdims=True) * 2
    smooth = scipy.signal.lfilter([0.3], [1, -0.7], power, axis=1)
    gain = np.clip(1 - 2 * noise / np.maximum(smooth, 1e-12), 0.1, 1)
    _, audio = scipy.signal.istft(spectra * gain, **options)
    audio = audio[: raw.shape[1]]
    envelope = np.sqrt(scipy.signal.lfilter([1e-4], [1, -(1 - 1e-4)], audio**2) + 1e-8)
    audio = np.clip(audio * np.minimum(2 * LEVEL / envelope, 8), -0.9, 0.9)
    late = round(latency_s * SAMPLE_RATE)
    result = np.zeros(raw.shape[1], dtype=np.float32)
    result[late : len(audio)] = audio[: len(audio) - late]
    return result


def at_another_rate(rate: int, talk: Talk) -> FloatArray:
    """A recording at ``rate`` hertz, read as if it were at 16 kHz; noise fills its whole band."""
    resampled = soxr.resample(talk.speech.T, SAMPLE_RATE, rate).T
    return talk.noisy(resampled)[:, : talk.speech.shape[1]]


MISTAKES = (
    Mistake("none", correct),
    Mistake("channels 1 and 2 swapped", partial(ordered, (0, 2, 1, 3))),
    Mistake("channels rotated by one", partial(ordered, (1, 2, 3, 0))),
    Mistake("channels 0 to 3 of six, 0 a beamformer's", partial(first_of_six, beamformed)),
    Mistake(
        "the same with noise suppression and gain",
        partial(first_of_six, partial(enhanced, 0.0)),
    ),
    Mistake(
        "the same 16 ms late",
        partial(first_of_six, partial(enhanced, LATENCY_S)),
    ),
    Mistake("a dead channel", with_dead_channel),
    Mistake("geometry in centimetres", correct, geometry=100.0),
    Mistake("geometry of 64 mm instead of 45.7", correct, geometry=64 / 45.7),
    Mistake("48 kHz declared as 16", partial(at_another_rate, 48_000)),
    Mistake("44.1 kHz declared as 16", partial(at_another_rate, 44_100)),
    Mistake("32 kHz declared as 16", partial(at_another_rate, 32_000)),
    Mistake("one channel late by a sample", with_late_channel),
    Mistake("one channel inverted", with_inverted_channel),
)


def talk_of(
    speech: Sequence[FloatArray], azimuth: FloatArray, seconds: float, seed: tuple[int, ...]
) -> Talk:
    """A talker who speaks from one place after another."""
    rng = np.random.default_rng(seed)
    array = preset(ARRAY)
    parts = []
    length = round(seconds * SAMPLE_RATE / len(azimuth))
    for place in azimuth:
        source = rng.uniform(*DISTANCE) * unit_vectors(np.array([place]))
        (responses,) = impulse_responses(living_room(RT60), array.positions, source)
        clips = [speech[index] for index in rng.permutation(len(speech))]
        dry = np.concatenate(clips[: 1 + round(seconds / 5)])[:length]
        parts.append(convolve(dry, responses)[:, :length])
    return Talk(unit_power(np.concatenate(parts, axis=1)), azimuth, seed)


def codes(mistake: Mistake, talk: Talk) -> frozenset[str]:
    """Codes of the findings in a recording with a mistake, or of the refusal of its geometry."""
    positions = preset(ARRAY).positions * mistake.geometry
    try:
        array = MicrophoneArray("named", positions)
    except InvalidGeometry as error:
        return frozenset({error.code})
    diagnostics = ChannelDiagnostics(SAMPLE_RATE, array.num_microphones)
    diagnostics.add(mistake.make(talk))
    return frozenset(finding.code for finding in diagnostics.findings(array))


def talks(speech: Sequence[FloatArray], seconds: float, seed: int) -> list[Talk]:
    """One talk from each of ``AZIMUTHS``, and four of a talker who walks round all of them."""
    count = len(AZIMUTHS)
    standing = [talk_of(speech, AZIMUTHS[i : i + 1], seconds, (seed, 0, i)) for i in range(count)]
    orders = [np.random.default_rng((seed, i)).permutation(count) for i in range(4)]
    walking = [
        talk_of(speech, AZIMUTHS[order], seconds, (seed, 1, i)) for i, order in enumerate(orders)
    ]
    return standing + walking


def row(mistake: Mistake, found: Sequence[Sequence[frozenset[str]]]) -> str:
    """A row of the table: how many recordings of each length raised a finding, and the codes."""
    cells = [f"{sum(map(bool, each))} of {len(each)}" for each in found]
    raised = Counter(code for each in found for raised in each for code in raised)
    named = ", ".join(f"`{code}` {count}" for code, count in raised.most_common()) or "nothing"
    return f"| {mistake.name} | {' | '.join(cells)} | {named} |"


def real_findings(folder: Path) -> dict[str, frozenset[str]]:
    """Codes of the findings in real recordings of the array, by file name."""
    array = preset(ARRAY)
    found: dict[str, frozenset[str]] = {}
    for path in sorted((*folder.glob("*.flac"), *folder.glob("*.wav"))):
        with open_recording(path) as recording:
            channels, _ = choose_channels(recording.channels, array, None)
            diagnostics = ChannelDiagnostics(recording.sample_rate, len(channels), channels)
            for block in recording.blocks(channels, recording.sample_rate):
                diagnostics.add(block)
        found[path.stem] = frozenset(finding.code for finding in diagnostics.findings(array))
    return found


def document(
    speech: Sequence[FloatArray], seconds: Sequence[float], seed: int, recordings: Path | None
) -> str:
    """``docs/diagnostics.md``, measured on recordings of these lengths."""
    lengths = {length: talks(speech, length, seed) for length in seconds}
    rows = [
        row(mistake, [[codes(mistake, talk) for talk in each] for each in lengths.values()])
        for mistake in MISTAKES
    ]
    columns = " | ".join(f"{length:g} s" for length in lengths)
    head = f"| mistake | {columns} | findings |\n|---|{'---|' * len(lengths)}---|"
    count = sum(len(each) for each in lengths.values()) // len(lengths)
    parts = [HEAD.format(array=ARRAY, rt60=RT60, snr=SNR_DB, count=count), head, *rows]
    if recordings:
        real = real_findings(recordings)
        false = {name: sorted(found) for name, found in real.items() if found}
        parts.append(
            f"\nOf {len(real)} real recordings of this array "
            f"{f'these raised findings: {false}' if false else 'none raised any finding'}."
        )
    return "\n".join([*parts, FOOT])


HEAD = """# Mistakes in recordings

What `neuralmusic check`, the `warnings` of `POST /localize` and those of streams say when a set-up
is wrong. Measured in simulation: LibriSpeech speakers that no model was trained on, {snr:g} dB
above the microphones' own noise, 0.7 to 2 m from `{array}` in a room of 6 x 5 x 3 m with an RT60 of
{rt60:g} s; {count} recordings of each length. In eight of them the talker stands in one of eight
directions, in the others the talker walks round all of them. One mistake is made at a time.

`python -m model_export mistakes --librispeech LIBRISPEECH` writes this page.
"""

FOOT = """
What cannot be told from sound alone:

- **A square whose channels are rotated by one** is the same square turned by 90 degrees: every
  sound fits it as well. Clap once from a known direction.
- **One beam among the microphones**, without noise suppression or gain, that follows a walking
  talker is nearly a microphone itself, and is named less often than the channels that devices
  deliver.

An array that is smaller than described has shorter delays, and so has an array of the right size
with a talker above it: 64 mm instead of 45.7 mm looks like a talker at 44 degrees of elevation.
Reverberation, which comes from all directions, tells the two apart; without it (outdoors), or
beside a loud fan, there is no finding.
"""

"""The sample recording: two synthetic talkers in a small room, heard by a ReSpeaker.

One speaks at 45 degrees, then the other at 200 degrees, then both. Every sample is synthetic, so
the recording may be committed.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import soundfile

from model_export import SAMPLE_RATE
from model_export.simulation.noise import unit_power
from model_export.simulation.rooms import RoomSpec, diffuse_noise, impulse_responses
from model_export.simulation.scenes import convolve
from model_export.simulation.synthesis import synthetic_voice
from service.doa.presets import preset
from service.doa.steering import unit_vectors

AZIMUTH_DEG = (45.0, 200.0)
TURNS = (((0.3, 3.2), (5.6, 8.0)), ((3.3, 5.8), (6.0, 8.0)))
"""Seconds in which each talker speaks"""
SECONDS = 8.5
ROOM = RoomSpec((5.2, 4.1, 2.7), (2.4, 1.9, 1.0), rt60=0.3)
SNR_DB = 25.0


def write_sample(path: Path, seed: int = 3) -> None:
    """Write the recording as 16-bit FLAC or WAV, by the path's suffix."""
    rng = np.random.default_rng(seed)
    array = preset("respeaker-usb-4mic-v2")
    sources = np.array([1.4, 1.2])[:, None] * unit_vectors(np.deg2rad(AZIMUTH_DEG))
    responses = impulse_responses(ROOM, array.positions, sources)
    samples = int(SECONDS * SAMPLE_RATE)
    audio = np.zeros((array.num_microphones, samples), dtype=np.float32)
    for talker, turns in enumerate(TURNS):
        dry = np.zeros(samples, dtype=np.float32)
        for begin, end in turns:
            voice = synthetic_voice(rng, end - begin)
            start = int(begin * SAMPLE_RATE)
            dry[start : start + voice.size] = voice
        audio += unit_power(convolve(dry, responses[talker]))[:, :samples]
    noise = unit_power(diffuse_noise(rng, array.positions, samples))
    audio += np.float32(10 ** (-SNR_DB / 20)) * noise
    path.parent.mkdir(parents=True, exist_ok=True)
    soundfile.write(path, (0.3 * audio / np.abs(audio).max()).T, SAMPLE_RATE, subtype="PCM_16")

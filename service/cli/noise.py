"""``neuralmusic noise``: learn the robot's own noise from a recording of it alone."""

from __future__ import annotations

import argparse
from pathlib import Path

from service.cli.inputs import add_array, add_recording, choose_channels, open_recording, read_array
from service.cli.terminal import line, output

NAME = "noise"
SUMMARY = "learn the noise of the robot's own fans and motors, for localize --noise"


def configure(parser: argparse.ArgumentParser) -> None:
    add_recording(parser)
    add_array(parser)
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="NPZ", help="the profile to write"
    )


def run(args: argparse.Namespace) -> int:
    from service.doa.stft import Stft
    from service.doa.whitening import learn_noise
    from service.inference.noise_profile import noise_bytes

    array = read_array(args.array)
    stft = Stft()  # that of every embedded model and of the classical methods
    with open_recording(args.file) as recording:
        channels = choose_channels(recording, array, args.channel_map)
        noise = learn_noise(recording.blocks(channels, stft.sample_rate), array, stft)
    args.output.write_bytes(noise_bytes(noise))
    line(output(), f"{args.output}: learnt from {noise.seconds:.1f} s of {array.name}")
    return 0

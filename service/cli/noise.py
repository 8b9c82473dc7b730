"""``neuralmusic noise``: learn the robot's own noise from a recording of it alone."""

from __future__ import annotations

import argparse
from pathlib import Path

from neuralmusic.cli.flags import add_array
from neuralmusic.cli.terminal import line, output, warn
from service.cli.inputs import add_recording, open_recording, read_array, read_channel_map
from service.machine.environment import prepare_process

NAME = "noise"
SUMMARY = "learn the noise of the robot's own fans and motors, for localize --noise"


def configure(parser: argparse.ArgumentParser) -> None:
    add_recording(parser)
    add_array(parser)
    parser.add_argument(
        "-o",
        "--out",
        "--output",
        type=Path,
        required=True,
        metavar="NPZ",
        help="the profile to write",
    )


def run(args: argparse.Namespace) -> int:
    prepare_process()
    from service.doa.stft import Stft
    from service.doa.whitening import learn_noise
    from service.inference.geometry import choose_channels
    from service.inference.noise_profile import noise_bytes

    array = read_array(args.array)
    stft = Stft()  # the same as in every embedded model and the classical methods
    with open_recording(args.file) as recording:
        given = read_channel_map(args.channel_map)
        channels, assumed = choose_channels(recording.channels, array, given)
        noise = learn_noise(recording.blocks(channels, stft.sample_rate), array, stft)
    args.out.write_bytes(noise_bytes(noise))
    for warning in assumed:
        warn(output(), warning.code, warning.detail)
    line(output(), f"{args.out}: learnt from {noise.seconds:.1f} s of {array.name}")
    return 0

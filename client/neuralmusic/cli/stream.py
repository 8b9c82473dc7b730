"""``neuralmusic stream``: live directions of a file or a microphone array, by a running service."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuralmusic.cli.flags import (
    add_array,
    add_channel_map,
    add_choices,
    add_key,
    given_key,
    given_options,
)
from neuralmusic.errors import InvalidOption
from neuralmusic.option_text import (
    read_angle,
    read_channel_map,
    read_integer,
    read_sectors,
    read_text,
)
from neuralmusic.protocol.framing import SAMPLE_BYTES

if TYPE_CHECKING:
    from neuralmusic.cli.stream_outputs import Output, Outputs
    from neuralmusic.sources.source import AudioSource
    from neuralmusic.streams.stream import StreamClient

NAME = "stream"
SUMMARY = "stream a recording or a microphone array to a running service"

URL = "http://127.0.0.1:8000"
OUTPUTS = ("table", "jsonl", "csv", "odas")
PIPE = Path("-")
"""FILE that stands for standard input"""
READERS: dict[str, Callable[[str], Any]] = {
    "channel_map": read_channel_map,
    "model": str,
    "method": str,
    "num_sources": partial(read_integer, low=1, high=4),
    "max_sources": partial(read_integer, low=1, high=4),
    "yaw_deg": read_angle,
    "exclude_deg": read_sectors,
    "hemisphere": str,
}
"""Readers of the flags' texts"""
OF_START = ("channel_map", "hemisphere", "method", "model")
"""Options that are fields of ``start``; the others belong to its ``output``"""


def configure(parser: argparse.ArgumentParser) -> None:
    _add_source(parser)
    _add_session(parser)
    _add_outputs(parser)


def _add_source(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("audio")
    add = group.add_argument
    add(
        "file",
        nargs="?",
        type=Path,
        metavar="FILE",
        help="a multichannel WAV or FLAC file; - for raw samples on standard input",
    )
    add("--realtime", action="store_true", help="send the file as fast as it was recorded")
    add("--device", metavar="NAME", help="record from this device instead of a file")
    add("--list-devices", action="store_true", help="list the devices that record")
    add("--sample-rate", type=int, metavar="HZ", help="rate of standard input, or of the device")
    add("--encoding", choices=tuple(SAMPLE_BYTES), help="samples on standard input")
    add("--channels", type=int, metavar="N", help="channels on standard input")
    add_array(group, required=False)  # --list-devices needs none
    add_channel_map(group)


def _add_session(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("session")
    add = group.add_argument
    add("--url", default=URL, help=f"the service (default: {URL})")
    add("--wait", type=float, default=0.0, metavar="SECONDS", help="wait for the service this long")
    add_key(group)
    add_choices(group)
    add("--interval-ms", type=int, metavar="MS", help="audio between results (default: 100)")
    add("--client", metavar="NAME", help="the robot's name, under which its noise is kept")
    add("--calibrate", type=float, metavar="SECONDS", help="first learn the robot's own noise")


def _add_outputs(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument_group("output").add_argument
    add("--output", choices=OUTPUTS, help="table on a terminal, otherwise jsonl")
    add("--save", type=Path, metavar="FILE", help="write results to a .jsonl or .csv file, too")
    add("--udp", metavar="HOST:PORT", help="send every result's JSON as a datagram, too")
    add("--odas-sst", metavar="HOST:PORT", help="write ODAS' tracks to a program that listens")
    add("--odas-ssl", metavar="HOST:PORT", help="write ODAS' potentials to a program that listens")
    add("--ssl", action="store_true", help="with --output odas: potentials instead of tracks")


def run(args: argparse.Namespace) -> int:
    if args.list_devices:
        print(_devices())
        return 0
    _check(args)
    from contextlib import closing

    with closing(_source(args)) as source:
        stream = _stream(args, source)
        return _follow(args, stream, source)


def _check(args: argparse.Namespace) -> None:
    """Refuse combinations that make no sense, before anything is opened."""
    if (args.file is None) == (args.device is None):
        raise InvalidOption("give a FILE, or record with --device NAME (see --list-devices)")
    if args.array is None:
        raise InvalidOption("give the --array (neuralmusic arrays lists the presets)")
    if args.realtime and (args.device is not None or args.file == PIPE):
        raise InvalidOption("--realtime is for files: other audio is always in real time")
    raw = (args.encoding, args.channels)
    if args.file == PIPE:
        if None in (*raw, args.sample_rate):
            raise InvalidOption("raw samples need --encoding, --sample-rate and --channels")
    elif raw != (None, None):
        raise InvalidOption("--encoding and --channels are for raw samples: give - as the FILE")
    if args.ssl and args.output != "odas":
        raise InvalidOption("--ssl goes with --output odas")
    rows = args.output == "csv" or (args.save is not None and args.save.suffix == ".csv")
    if _odas(args) and rows:
        raise InvalidOption("CSV holds results, which ODAS' objects replace: run the command twice")


def _odas(args: argparse.Namespace) -> bool:
    return args.output == "odas" or args.odas_sst is not None or args.odas_ssl is not None


def _source(args: argparse.Namespace) -> AudioSource:
    if args.device is not None:
        from neuralmusic.sources.microphone import Microphone

        return Microphone(args.device, args.sample_rate)
    if args.file == PIPE:
        from neuralmusic.sources.pcm import StandardInput

        return StandardInput(args.encoding, args.sample_rate, args.channels)
    from neuralmusic.sources.files import FileSource

    return FileSource(args.file, realtime=args.realtime)


def _devices() -> str:
    """The devices that record, for ``--device``."""
    from neuralmusic.cli.words import columns
    from neuralmusic.sources.microphone import recording_devices

    found = [
        (
            str(number),
            str(device["max_input_channels"]),
            f"{device['default_samplerate']:.0f}",
            str(device["name"]),
        )
        for number, device in recording_devices()
    ]
    if not found:
        return "no device records: is the microphone array plugged in?"
    return columns([("number", "channels", "Hz", "name"), *found], right=(0, 1, 2))


def _stream(args: argparse.Namespace, source: AudioSource) -> StreamClient:
    """The requested stream, not yet open; the service chooses channels."""
    from neuralmusic.streams.stream import StreamClient

    given = given_options(args)
    array = _array(given.pop("array"))
    options = {name: read_text(name, text, READERS[name]) for name, text in given.items()}
    start = {name: options.pop(name) for name in OF_START if name in options}
    if args.interval_ms is not None:
        options["interval_ms"] = args.interval_ms
    if _odas(args):
        options["format"] = "odas"
    return StreamClient(
        args.url,
        key=given_key(args.key),
        wait_s=args.wait,
        audio=source.audio,
        array=array,
        output=options,
        overflow="drop_oldest" if source.live else "block",
        client=args.client,
        **start,
    )


def _array(text: str) -> Any:
    """A preset's name, or the geometry of a JSON text; the service checks both."""
    if not text.lstrip().startswith(("{", "[")):
        return text.strip()
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidOption(f"--array is not valid JSON ({error})") from None


def _follow(args: argparse.Namespace, stream: StreamClient, source: AudioSource) -> int:
    from neuralmusic.cli.live import follow
    from neuralmusic.cli.stream_outputs import summary_line

    with stream:
        if args.calibrate is not None:
            stream.calibrate(args.calibrate)
        outputs, drawn = _outputs(args)
        try:
            return follow(stream, source, outputs.show)
        finally:
            outputs.close()
            if drawn and stream.summary is not None:
                print(summary_line(stream.summary))


def _outputs(args: argparse.Namespace) -> tuple[Outputs, bool]:
    """The requested outputs, and whether a table for people is one of them."""
    from neuralmusic.cli import stream_outputs as to
    from neuralmusic.cli.addresses import read_address
    from neuralmusic.cli.odas import OdasConnection
    from neuralmusic.protocol.server_messages import OdasSsl, OdasSst

    outputs = to.Outputs()
    chosen = args.output or ("table" if sys.stdout.isatty() else "jsonl")
    kinds = (("--odas-sst", args.odas_sst, OdasSst), ("--odas-ssl", args.odas_ssl, OdasSsl))
    try:
        for option, address, kind in kinds:
            if address is not None:
                outputs.add(OdasConnection(option, read_address(option, address), kind, _say))
        if args.save is not None:
            outputs.add(to.saved(args.save))
        if args.udp is not None:
            outputs.add(to.Datagrams(read_address("--udp", args.udp)))
        if chosen == "table":
            outputs.add(_table())
            return outputs, True
        if chosen == "jsonl":
            outputs.add(to.JsonLines(sys.stdout))
        elif chosen == "csv":
            outputs.add(to.CsvRows(sys.stdout))
        else:
            outputs.add(to.OdasObjects(sys.stdout, OdasSsl if args.ssl else OdasSst))
        outputs.add(to.Notes(_say))
    except BaseException:
        outputs.close()
        raise
    return outputs, False


def _table() -> Output:
    """The live table, or lines without rich, which the extra ``table`` brings."""
    try:
        from neuralmusic.cli.stream_table import LiveTable
        from neuralmusic.cli.terminal import output
    except ImportError:
        from neuralmusic.cli.stream_lines import PlainLines

        return PlainLines(sys.stdout)
    return LiveTable(output())


def _say(words: str) -> None:
    print(words, file=sys.stderr, flush=True)

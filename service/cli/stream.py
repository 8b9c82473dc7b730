"""``neuralmusic stream``: live directions of a file or a microphone array, by a running service."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.cli.inputs import add_array, add_channel_map, add_key, given_key
from service.cli.options import add_choices, given_options
from service.errors import InvalidOption

if TYPE_CHECKING:
    from service.cli.live import AudioSource
    from service.cli.stream_outputs import Outputs
    from service.cli.stream_table import LiveTable
    from service.client import StreamClient

NAME = "stream"
SUMMARY = "stream a recording or a microphone array to a running service"

URL = "http://127.0.0.1:8000"
OUTPUTS = ("table", "jsonl", "csv", "odas")


def configure(parser: argparse.ArgumentParser) -> None:
    _add_source(parser)
    _add_session(parser)
    _add_outputs(parser)


def _add_source(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("audio")
    add = group.add_argument
    add("file", nargs="?", type=Path, metavar="FILE", help="a multichannel WAV or FLAC file")
    add("--realtime", action="store_true", help="send the file as fast as it was recorded")
    add("--device", metavar="NAME", help="record from this device instead of a file")
    add("--list-devices", action="store_true", help="list the devices that record")
    add("--sample-rate", type=int, metavar="HZ", help="of the device (default: its own)")
    add_array(group, required=False)  # --list-devices needs none
    add_channel_map(group)


def _add_session(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("session")
    add = group.add_argument
    add("--url", default=URL, help=f"the service (default: {URL})")
    add("--wait", type=float, default=0.0, metavar="SECONDS", help="wait for it this long")
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
        from service.cli.microphone import print_devices

        print_devices()
        return 0
    _check(args)
    from contextlib import closing

    with closing(_source(args)) as source:
        stream = _stream(args, source)
        return _follow(args, stream, source)


def _check(args: argparse.Namespace) -> None:
    """Combinations that make no sense, before anything is opened."""
    if (args.file is None) == (args.device is None):
        raise InvalidOption("give a FILE, or record with --device NAME (see --list-devices)")
    if args.array is None:
        raise InvalidOption("give the --array (neuralmusic arrays lists the presets)")
    if args.device is not None and args.realtime:
        raise InvalidOption("--realtime is for files: a device is always in real time")
    if args.ssl and args.output != "odas":
        raise InvalidOption("--ssl goes with --output odas")
    rows = args.output == "csv" or (args.save is not None and args.save.suffix == ".csv")
    if _odas(args) and rows:
        raise InvalidOption("CSV holds results, and ODAS' objects take their place: run it twice")


def _odas(args: argparse.Namespace) -> bool:
    return args.output == "odas" or args.odas_sst is not None or args.odas_ssl is not None


def _source(args: argparse.Namespace) -> AudioSource:
    if args.device is not None:
        from service.cli.microphone import Microphone

        return Microphone(args.device, args.sample_rate)
    from service.cli.live import FileSource

    return FileSource(args.file, realtime=args.realtime)


def _stream(args: argparse.Namespace, source: AudioSource) -> StreamClient:
    """The stream that was asked for, not yet open; channels are the service's to choose."""
    from service.client import StreamClient
    from service.doa.presets import PRESETS
    from service.recordings.options import read_option

    given = {name: read_option(name, text) for name, text in given_options(args).items()}
    array = given.pop("array")
    geometry: dict[str, Any] = {"name": array.name}
    if PRESETS.get(array.name) is not array:
        geometry["positions_m"] = array.positions
    start = {"client": args.client} if args.client is not None else {}
    start |= {name: given.pop(name) for name in ("channel_map", "method", "model") if name in given}
    if args.interval_ms is not None:
        given["interval_ms"] = args.interval_ms
    if _odas(args):
        given["format"] = "odas"
    return StreamClient(
        args.url,
        key=given_key(args.key),
        wait_s=args.wait,
        audio=source.audio,
        array=geometry,
        output=given,
        overflow="drop_oldest" if source.live else "block",
        **start,
    )


def _follow(args: argparse.Namespace, stream: StreamClient, source: AudioSource) -> int:
    from service.cli.live import follow
    from service.cli.stream_outputs import summary_line

    with stream:
        if args.calibrate is not None:
            stream.calibrate(args.calibrate)
        outputs, drawn = _outputs(args)
        try:
            return follow(stream, source, outputs.show)
        finally:
            outputs.close()
            if drawn is not None and stream.summary is not None:
                print(summary_line(stream.summary))


def _outputs(args: argparse.Namespace) -> tuple[Outputs, LiveTable | None]:
    """Everything that was asked for, and the table where there is one."""
    from service.cli import stream_outputs as to
    from service.cli.addresses import read_address
    from service.cli.odas import OdasConnection
    from service.cli.stream_table import LiveTable
    from service.cli.terminal import output
    from service.protocol.server_messages import OdasSsl, OdasSst

    outputs, drawn, say = to.Outputs(), None, _say
    kinds = (("--odas-sst", args.odas_sst, OdasSst), ("--odas-ssl", args.odas_ssl, OdasSsl))
    try:
        for option, address, kind in kinds:
            if address is not None:
                outputs.add(OdasConnection(option, read_address(option, address), kind, say))
        if args.save is not None:
            outputs.add(to.saved(args.save))
        if args.udp is not None:
            outputs.add(to.Datagrams(read_address("--udp", args.udp)))
        match args.output or ("table" if sys.stdout.isatty() else "jsonl"):
            case "table":
                drawn = LiveTable(output())
                outputs.add(drawn)
                return outputs, drawn
            case "jsonl":
                outputs.add(to.JsonLines(sys.stdout))
            case "csv":
                outputs.add(to.CsvRows(sys.stdout))
            case "odas":
                outputs.add(to.OdasObjects(sys.stdout, OdasSsl if args.ssl else OdasSst))
        outputs.add(to.Notes(say))
    except BaseException:
        outputs.close()
        raise
    return outputs, None


def _say(words: str) -> None:
    print(words, file=sys.stderr, flush=True)

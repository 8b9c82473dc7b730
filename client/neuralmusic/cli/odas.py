"""ODAS' text form of directions, and the TCP connection to a program that reads it.

ODAS (github.com/introlab/odas, ``src/sink/snk_tracks.c`` and ``snk_pots.c``) prints one JSON object
per hop over several lines, and connects to its reader: the reader is the server.
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Sequence

from neuralmusic.cli.addresses import Address
from neuralmusic.errors import InvalidOption
from neuralmusic.protocol.server_messages import OdasPotential, OdasSource, OdasSsl, OdasSst
from neuralmusic.streams.inbox import StreamEvent

PLACES = 4
"""Number of sources in every object; unused ones have the id 0"""
SEND_TIMEOUT_S = 1.0

EMPTY_SOURCE = OdasSource(id=0, tag="", x=0.0, y=0.0, z=0.0, activity=0.0)
EMPTY_POTENTIAL = OdasPotential(x=0.0, y=0.0, z=0.0, E=0.0)


def odas_text(message: OdasSst | OdasSsl) -> str:
    """The object as ODAS prints it."""
    if isinstance(message, OdasSst):
        missing = [EMPTY_SOURCE] * (PLACES - len(message.src))
        lines = [_source(source) for source in [*message.src, *missing]]
    else:
        none = [EMPTY_POTENTIAL] * (PLACES - len(message.src))
        lines = [_potential(potential) for potential in [*message.src, *none]]
    return _object(message.timeStamp, lines)


def _source(source: OdasSource) -> str:
    return (
        f'{{ "id": {source.id}, "tag": "{source.tag}", "x": {source.x:1.3f}, '
        f'"y": {source.y:1.3f}, "z": {source.z:1.3f}, "activity": {source.activity:1.3f} }}'
    )


def _potential(found: OdasPotential) -> str:
    return (
        f'{{ "x": {found.x:1.3f}, "y": {found.y:1.3f}, "z": {found.z:1.3f}, "E": {found.E:1.3f} }}'
    )


def _object(time_stamp: int, lines: Sequence[str]) -> str:
    body = ",\n".join(f"        {line}" for line in lines)
    return f'{{\n    "timeStamp": {time_stamp},\n    "src": [\n{body}\n    ]\n}}\n'


class OdasConnection:
    """Sends objects of one kind to a program that listens, as ODAS itself does.

    Parameters
    ----------
    option : str
        The flag, named in errors.
    address : Address
        The address on which the program listens.
    kind : type
        ``OdasSst`` or ``OdasSsl``.
    say : callable
        Called with a line when the program goes away.

    Raises
    ------
    InvalidOption
        If nobody listens there.
    """

    def __init__(
        self,
        option: str,
        address: Address,
        kind: type[OdasSst] | type[OdasSsl],
        say: Callable[[str], None],
    ) -> None:
        self._kind = kind
        self._say = say
        self._lost = False
        self._name = f"{option} {address.text}"
        try:
            self._socket = socket.create_connection((address.host, address.port), SEND_TIMEOUT_S)
        except OSError as error:
            raise InvalidOption(
                f"{self._name}: nobody listens there ({error.strerror or error}): start the "
                "program that reads first; as with ODAS, it is the server"
            ) from None

    def show(self, event: StreamEvent) -> None:
        """Write an object of the kind; nothing more goes to a reader that is gone or stuck."""
        if self._lost or not isinstance(event, self._kind):
            return
        try:
            self._socket.sendall(odas_text(event).encode())
        except OSError as error:  # a timeout, too, after half an object
            self._lost = True
            self._socket.close()
            self._say(f"{self._name}: the reader is gone ({error.strerror or error})")

    def close(self) -> None:
        self._socket.close()

"""Messages of the service as they come, without those that this client does not know."""

from __future__ import annotations

import logging

from neuralmusic.client_errors import InvalidAnswer
from neuralmusic.errors import InvalidMessage
from neuralmusic.protocol.server_messages import AnyServerMessage, read_server_message

logger = logging.getLogger("neuralmusic.client")
MOST_UNKNOWN = 100
"""Messages one after the other that may be unknown, as a newer service has some"""
LOGGED = 3
"""Unknown messages of a connection that the log tells of"""


class Incoming:
    """The messages of one connection."""

    def __init__(self) -> None:
        self._unknown = 0
        """Unknown messages since the last known one"""
        self._logged = 0

    def read(self, text: str | bytes) -> AnyServerMessage | None:
        """A message, or None for one that a newer service sends and this client does not know.

        Raises
        ------
        InvalidAnswer
            If nothing else comes.
        """
        try:
            message = read_server_message(text)
        except InvalidMessage as error:
            self._unknown += 1
            if self._logged < LOGGED:
                self._logged += 1
                logger.warning("a message of the service is skipped: %s", error.detail)
            if self._unknown > MOST_UNKNOWN:
                raise InvalidAnswer(
                    f"{self._unknown} messages one after the other are none of this service's: "
                    "check the address and its version"
                ) from None
            return None
        self._unknown = 0
        return message

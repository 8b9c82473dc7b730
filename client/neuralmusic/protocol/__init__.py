"""The stream's contract: messages, PCM framing, close codes. It imports only pydantic and errors.

``WS /stream`` with the subprotocol ``doa.v1``: the client sends one ``start``, then binary audio;
``update``, ``flush``, ``ping``, ``calibrate`` and ``stop`` may come at any time. The server's
messages all have a ``type`` and a ``seq``. ``docs/protocol.md`` and ``asyncapi.json`` are written
from these classes.
"""

SUBPROTOCOL = "doa.v1"
MAX_MESSAGE_BYTES = 256 * 1024
"""Most bytes of a binary message: 20 ms of 64 channels of 32 bits at 48 kHz, and more"""
MAX_TEXT = 64 * 1024
"""Most characters of a control message"""

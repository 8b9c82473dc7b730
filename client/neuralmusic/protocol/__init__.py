"""The stream's contract: messages, PCM framing, close codes. It imports only pydantic and errors.

``WS /stream`` with the subprotocol ``doa.v1``: the client sends one ``start``, then binary audio;
``update``, ``flush``, ``ping``, ``calibrate`` and ``stop`` may come at any time. The server's
messages all have a ``type`` and a ``seq``. ``docs/protocol.md`` and ``asyncapi.json`` are written
from these classes.
"""

SUBPROTOCOL = "doa.v1"
MAX_MESSAGE_BYTES = 64 * 1024

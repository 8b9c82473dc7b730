"""Whether the service in this container is ready: exit code 0 if so.

For HEALTHCHECK, which runs it every few seconds: so it imports next to nothing.
"""

import os
import socket
import sys

PORT = int(os.environ.get("NEURALMUSIC_PORT") or 8000)
REQUEST = b"GET /readyz HTTP/1.0\r\nHost: localhost\r\n\r\n"

try:
    with socket.create_connection(("127.0.0.1", PORT), timeout=2) as connection:
        connection.sendall(REQUEST)
        status = connection.recv(64).split(b" ")[1:2]
except OSError as error:
    sys.exit(f"not reachable: {error}")
sys.exit(0 if status == [b"200"] else f"not ready: HTTP status {status}")

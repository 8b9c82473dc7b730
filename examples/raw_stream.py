"""Stream a WAV file by nothing but the protocol: websockets and the standard library.

Usage: python examples/raw_stream.py recording.wav respeaker-usb-4mic-v2 [ws://robot:8000/stream]

The conversation is the one at the top of docs/protocol.md, to be written again in any language.
Needs the package websockets.
"""

from __future__ import annotations

import asyncio
import json
import os
import struct
import sys
import time
import wave

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosedError, InvalidStatus

MESSAGE_S = 0.05
ENCODINGS = {2: "pcm_s16le", 3: "pcm_s24le", 4: "pcm_s32le"}
HEADER = struct.Struct("<IIq")  # flags, sequence, capture time in ns: 16 bytes


async def send_audio(socket: ClientConnection, sound: wave.Wave_read) -> None:
    """Send the recording as fast as it was recorded, then ask for the end."""
    rate, began_ns, began = sound.getframerate(), time.time_ns(), time.monotonic()
    frames = round(MESSAGE_S * rate)
    for sequence in range(-(-sound.getnframes() // frames)):
        captured = began_ns + sequence * frames * 1_000_000_000 // rate
        due = began + (sequence + 1) * frames / rate
        await asyncio.sleep(max(due - time.monotonic(), 0.0))
        await socket.send(HEADER.pack(0, sequence, captured) + sound.readframes(frames))
    await socket.send(json.dumps({"type": "stop"}))


def show(message: dict) -> None:
    """Print what a robot would act on."""
    if message["type"] == "result":
        for source in message["sources"]:
            pauses = "" if source["active"] else ", pauses"
            place = f"{source['azimuth_deg']} degrees{pauses}"
            print(f"{message['t_end']} s  id {source['id']}  {place}", flush=True)
    elif message["type"] in ("warning", "error"):
        print(f"{message['code']}: {message['detail']}", file=sys.stderr)
    elif message["type"] == "summary":
        for track in message["sources"]:
            print(f"track {track['id']}: {track['azimuth_deg']} degrees, {track['active_s']} s")


async def stream(path: str, array: str, url: str = "ws://127.0.0.1:8000/stream") -> None:
    """Hold the conversation until the service closes it."""
    key = os.environ.get("NEURALMUSIC_KEY")  # where the service has keys
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    with wave.open(path, "rb") as sound:
        audio = {
            "encoding": ENCODINGS[sound.getsampwidth()],
            "sample_rate": sound.getframerate(),
            "channels": sound.getnchannels(),
            "header": "seq_time",
        }
        start = {"type": "start", "audio": audio, "array": {"name": array}}
        async with connect(url, subprotocols=["doa.v1"], additional_headers=headers) as socket:
            await socket.send(json.dumps(start))
            sending = None
            async for text in socket:  # until the service closes
                message = json.loads(text)
                if message["type"] == "ready":
                    sending = asyncio.create_task(send_audio(socket, sound))
                show(message)
            if sending is not None:
                await sending


if __name__ == "__main__":
    try:
        asyncio.run(stream(*sys.argv[1:]))
    except InvalidStatus as refused:  # with a problem document that says why
        sys.exit((refused.response.body or b"").decode())
    except (OSError, ConnectionClosedError) as error:  # any close code but 1000
        sys.exit(f"the session ended: {error}")

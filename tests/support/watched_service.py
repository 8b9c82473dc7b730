"""Requests to a service whose metrics, logs and traces are checked."""

from __future__ import annotations

import asyncio
import io
import json
from typing import Any

import httpx2
import numpy as np
import soundfile
from prometheus_client.parser import text_string_to_metric_families
from websockets.asyncio.client import connect

ARRAY = "respeaker-usb-4mic-v2"
SECONDS = 2.0
PATIENCE = 30
"""Seconds until a hanging test fails"""


async def stream(
    url: str, *, start: dict[str, Any] | None = None, seconds: float = SECONDS, **options: Any
) -> list[str]:
    """Stream noise in pieces of 100 ms and stop; the types of what was answered."""
    audio = {"encoding": "pcm_s16le", "sample_rate": 16000, "channels": 4}
    basis = {"type": "start", "audio": audio, "array": {"name": ARRAY}, "overflow": "block"}
    noise = np.random.default_rng(0).integers(-300, 300, (round(16000 * seconds), 4))
    arguments: dict[str, Any] = {"subprotocols": ["doa.v1"], "compression": None, **options}
    answered: list[str] = []
    async with asyncio.timeout(PATIENCE), connect(url, **arguments) as socket:
        await socket.send(json.dumps({**basis, **(start or {})}))
        for begin in range(0, len(noise), 1600):
            await socket.send(noise[begin : begin + 1600].astype("<i2").tobytes())
        await socket.send('{"type":"stop"}')
        async for text in socket:
            answered.append(json.loads(text)["type"])
    return answered


def localize(url: str, wav: bytes) -> httpx2.Response:
    headers = {"Content-Type": "audio/wav"}
    params = {"array": ARRAY}
    return httpx2.post(f"{url}/localize", params=params, content=wav, headers=headers, timeout=30)


def recording() -> bytes:
    """1.5 s of noise as a WAV file."""
    noise = np.random.default_rng(0).integers(-300, 300, (24_000, 4)).astype("<i2")
    file = io.BytesIO()
    soundfile.write(file, noise, 16_000, format="WAV")
    return file.getvalue()


def scraped(url: str) -> dict[str, float]:
    """Values by the names as they are written, labels included."""
    text = httpx2.get(f"{url}/metrics").text
    return {
        sample.name + (json.dumps(sample.labels) if sample.labels else ""): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }

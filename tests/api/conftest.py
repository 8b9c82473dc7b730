"""Fixtures of the HTTP tests: plane waves as files, and a running application."""

from __future__ import annotations

import io
import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import httpx2
import numpy as np
import pytest
import soundfile
from fastapi.testclient import TestClient
from numpy.typing import NDArray

from service.app import create_app
from service.doa.array import SPEED_OF_SOUND
from service.doa.presets import preset
from service.observability.logs import JsonFormatter, TextFormatter
from service.settings import Settings

ARRAY = "respeaker-usb-4mic-v2"
Samples = NDArray[np.float32]


@dataclass(frozen=True)
class Sounds:
    """Synthesised recordings of one array."""

    array: str = ARRAY

    def plane_wave(
        self, azimuth_deg: float, seconds: float = 1.5, rate: int = 16_000, seed: int = 0
    ) -> Samples:
        """White noise (T, N) from one direction, delayed exactly, with a little sensor noise."""
        random = np.random.default_rng(seed)
        count = round(seconds * rate)
        spectrum = np.fft.rfft(random.standard_normal(count))
        frequency = np.fft.rfftfreq(count, 1 / rate)
        azimuth = np.deg2rad(azimuth_deg)
        towards = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        advance = preset(self.array).positions @ towards / SPEED_OF_SOUND
        shifted = spectrum * np.exp(2j * np.pi * frequency * advance[:, None])
        channels = np.fft.irfft(shifted, count) + 0.03 * random.standard_normal((4, count))
        return (0.1 * channels.T).astype(np.float32)

    def file(
        self, samples: Samples, rate: int = 16_000, kind: str = "WAV", subtype: str = "PCM_16"
    ) -> bytes:
        file = io.BytesIO()
        soundfile.write(file, samples, rate, format=kind, subtype=subtype)
        return file.getvalue()

    def wav(self, azimuth_deg: float = 77.0, **how: Any) -> bytes:
        return self.file(self.plane_wave(azimuth_deg, **how), how.get("rate", 16_000))


@pytest.fixture(scope="session")
def sounds() -> Sounds:
    return Sounds()


@pytest.fixture(scope="session")
def client() -> Iterator[TestClient]:
    """The application with small limits, so that tests can exceed them."""
    settings = Settings(workers=2, queue=2, max_upload_bytes=2 * 2**20, max_seconds=20.0)
    with TestClient(create_app(settings), raise_server_exceptions=False) as running:
        yield running


@pytest.fixture
def written_log() -> Iterator[io.StringIO]:
    """What is logged meanwhile, every line as text and as JSON; uvicorn's lines, too."""
    written = io.StringIO()
    names = ("service", "uvicorn", "uvicorn.access")
    loggers = [(logger, logger.level) for logger in map(logging.getLogger, names)]
    handlers = [logging.StreamHandler(written) for _ in range(2)]
    for handler, formatter in zip(handlers, (TextFormatter(), JsonFormatter()), strict=True):
        handler.setFormatter(formatter)
        logging.getLogger("service").addHandler(handler)
        logging.getLogger("uvicorn").addHandler(handler)
    for logger, _ in loggers:
        logger.setLevel(logging.INFO)
    yield written
    for logger, level in loggers:
        logger.setLevel(level)
        for handler in handlers:
            logger.removeHandler(handler)


@dataclass(frozen=True)
class Localize:
    """Posts recordings to one application."""

    client: TestClient

    @property
    def has_model(self) -> bool:
        return bool(self.client.get("/models").json()["models"])

    def raw(self, body: bytes, media_type: str = "audio/wav", **options: Any) -> httpx2.Response:
        headers = {"Content-Type": media_type}
        params = {"array": ARRAY, **options}
        return self.client.post("/localize", content=body, headers=headers, params=params)

    def form(self, body: bytes, **options: Any) -> httpx2.Response:
        files = {"audio": ("recording.wav", body, "audio/wav")}
        return self.client.post("/localize", files=files, data={"array": ARRAY, **options})


@pytest.fixture
def localize(client: TestClient) -> Localize:
    return Localize(client)

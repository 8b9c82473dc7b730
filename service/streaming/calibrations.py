"""The stored noise of streams' clients; every call may wait for a disk, so none is for the loop."""

from __future__ import annotations

import logging
from dataclasses import replace

from neuralmusic.errors import NoiseStoreFull, UnknownNoise
from service.inference.noise_store import NoiseStore
from service.streaming.work import Keep, Kept, Open

log = logging.getLogger(__name__)


def with_noise(work: Open, store: NoiseStore) -> Open:
    """The job with the noise stored for its client, unless it has none or wants none."""
    start = work.start
    if start.client is None or start.noise == "none":
        return work
    try:
        return replace(work, noise=store.get(start.client).noise)
    except UnknownNoise:
        return work


def keep(work: Keep, store: NoiseStore) -> Kept:
    """Store a client's noise."""
    try:
        store.put(work.name, work.noise)
    except NoiseStoreFull as error:
        return Kept(error.detail)
    except OSError as error:
        log.warning("the noise calibration of %s cannot be stored: %s", work.name, error)
        return Kept(error.strerror or "an error")  # the folder's path is the operator's alone
    return Kept()

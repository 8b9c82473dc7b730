"""Audio devices through PortAudio (sounddevice), which is imported only on use."""

from __future__ import annotations

import threading
import time
from typing import Any

from neuralmusic.errors import ConfigError, DoaError, InvalidOption
from neuralmusic.protocol.framing import NANOSECONDS
from neuralmusic.sources.source import CHUNK_S, Send


def load_sounddevice() -> Any:
    """The module sounddevice, or ConfigError, which says what to install."""
    try:
        import sounddevice
    except ImportError:
        raise ConfigError(
            "recording needs sounddevice: pip install './client[microphone]' in the project's "
            "folder"
        ) from None
    except OSError:
        raise ConfigError(
            "recording needs the PortAudio library: apt install libportaudio2 (Debian, Ubuntu, "
            "Raspberry Pi OS), or brew install portaudio"
        ) from None
    return sounddevice


class Microphone:
    """A recording device with all its channels, 16 bits, 20 ms at a time.

    Parameters
    ----------
    name : str
        The device's number or a part of its name, as ``--list-devices`` shows them.
    sample_rate : int, optional
        Hertz; by default the device's own.

    Raises
    ------
    ConfigError
        If sounddevice or PortAudio is missing.
    InvalidOption
        If there is no such device.
    """

    live = True

    def __init__(self, name: str, sample_rate: int | None = None) -> None:
        self._sounddevice = load_sounddevice()
        self._device: str | int = int(name) if name.isdigit() else name
        try:
            found = self._sounddevice.query_devices(self._device, "input")
        except (ValueError, self._sounddevice.PortAudioError) as error:
            raise InvalidOption(f"--device {name}: {error} (see --list-devices)") from None
        self.name = str(found["name"])
        self.channels = int(found["max_input_channels"])
        self._rate = sample_rate or int(found["default_samplerate"])
        self.audio: dict[str, Any] = {
            "encoding": "pcm_s16le",
            "sample_rate": self._rate,
            "channels": self.channels,
            "header": "seq_time",
        }

    def feed(self, send: Send, stopping: threading.Event) -> None:
        """Record until ``stopping`` is set or the stream has ended."""
        ended = threading.Event()

        def captured(data: Any, frames: int, moment: Any, status: Any) -> None:
            try:
                send(bytes(data), capture_time_ns(moment))
            except DoaError:  # the stream has ended: its reader learns why
                ended.set()
                raise self._sounddevice.CallbackStop from None

        try:
            with self._sounddevice.RawInputStream(
                samplerate=self._rate,
                blocksize=max(int(CHUNK_S * self._rate), 1),
                device=self._device,
                channels=self.channels,
                dtype="int16",
                callback=captured,
                finished_callback=ended.set,
            ):
                while not (ended.is_set() or stopping.wait(CHUNK_S)):
                    pass
        except self._sounddevice.PortAudioError as error:
            raise InvalidOption(f"{self.name} cannot be recorded from: {error}") from None

    def close(self) -> None:
        return


def capture_time_ns(moment: Any) -> int | None:
    """Capture time of a callback's first sample frame by the system's clock, None where unknown.

    PortAudio's own clock has no relation to the system's: the audio's age is subtracted from now.
    """
    age: float = moment.currentTime - moment.inputBufferAdcTime
    if moment.inputBufferAdcTime <= 0 or not 0 <= age < 10:
        return None
    return time.time_ns() - round(age * NANOSECONDS)


def recording_devices() -> list[tuple[int, dict[str, Any]]]:
    """PortAudio's devices that record, with their numbers for ``Microphone``."""
    found = enumerate(load_sounddevice().query_devices())
    return [(index, device) for index, device in found if device["max_input_channels"] > 0]

"""Noise profiles by the names that clients gave them, in memory and optionally in a folder."""

from __future__ import annotations

import logging
import tempfile
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from neuralmusic.errors import ConfigError, InvalidOption, NoiseError, NoiseStoreFull, UnknownNoise
from neuralmusic.protocol.names import NAME_RULE, is_name
from service.doa.whitening import NoiseCovariance
from service.inference.noise_profile import load_noise, save_noise

logger = logging.getLogger(__name__)

SUFFIX = ".npz"
CAPACITY = 256
MAX_HELD_BYTES = 256 * 2**20
"""Most bytes of all profiles' covariances together; 256 of four microphones take 8 MB"""


@dataclass(frozen=True, slots=True, eq=False)
class StoredNoise:
    """A profile with its name."""

    name: str
    noise: NoiseCovariance
    created: datetime
    """Time at which the profile was stored, UTC"""


class NoiseStore:
    """Profiles by name; safe to use from several threads.

    Parameters
    ----------
    folder : Path, optional
        Keeps profiles across restarts, each as ``NAME.npz``; read when first needed.
    capacity : int
        Most profiles.
    max_bytes : int
        Most bytes of all profiles' covariances together.

    Raises
    ------
    ConfigError
        If the folder is a file.
    """

    def __init__(
        self,
        folder: Path | None = None,
        capacity: int = CAPACITY,
        max_bytes: int = MAX_HELD_BYTES,
    ) -> None:
        if folder is not None and folder.exists() and not folder.is_dir():
            raise ConfigError(f"noise_folder {folder} is not a folder: name one for noise profiles")
        self._folder = folder
        self._capacity = capacity
        self._max_bytes = max_bytes
        self._lock = threading.Lock()
        self._profiles: dict[str, StoredNoise] | None = None

    def all(self) -> list[StoredNoise]:
        """All profiles, sorted by name."""
        with self._lock:
            return [stored for _, stored in sorted(self._loaded().items())]

    def get(self, name: str) -> StoredNoise:
        """The profile of this name, or UnknownNoise."""
        with self._lock:
            return self._found(name)

    def put(self, name: str, noise: NoiseCovariance) -> StoredNoise:
        """Store a profile; it replaces one of the same name.

        Raises
        ------
        InvalidOption
            If the name is none after ``neuralmusic.protocol.names``.
        NoiseStoreFull
            If there is no room for another profile.
        OSError
            If the folder cannot be written.
        """
        if not is_name(name):
            raise InvalidOption(f"a noise profile's name has {NAME_RULE}, but is {name[:64]!r}")
        with self._lock:
            profiles = self._loaded()
            if name not in profiles and len(profiles) >= self._capacity:
                raise NoiseStoreFull(
                    f"the limit of {self._capacity} noise profiles is reached: delete one "
                    "with DELETE /noise/NAME"
                )
            others = _bytes(stored for stored in profiles.values() if stored.name != name)
            if others + noise.covariance.nbytes > self._max_bytes:
                raise NoiseStoreFull(
                    f"the noise profiles would take more than {self._max_bytes / 2**20:g} MB: "
                    "delete one with DELETE /noise/NAME"
                )
            if self._folder is not None:
                _write(self._folder, name, noise)
            profiles[name] = StoredNoise(name, noise, datetime.now(UTC))
            return profiles[name]

    def delete(self, name: str) -> None:
        """Delete a profile, or raise UnknownNoise; an OSError leaves profile and file in place."""
        with self._lock:
            self._found(name)
            if self._folder is not None:
                (self._folder / f"{name}{SUFFIX}").unlink(missing_ok=True)
            self._loaded().pop(name)

    def _found(self, name: str) -> StoredNoise:
        """The profile of this name, or UnknownNoise; the lock is held."""
        profiles = self._loaded()
        if name not in profiles:
            raise UnknownNoise(
                f"no noise profile is called {name[:64]!r}: send it with PUT /noise/NAME; stored "
                f"are {', '.join(sorted(profiles)[:20]) or 'none'}"
            )
        return profiles[name]

    def _loaded(self) -> dict[str, StoredNoise]:
        """The profiles, read from the folder the first time; the lock is held."""
        if self._profiles is None:
            self._profiles = {}
            if self._folder is not None:
                self._profiles = _read(self._folder, self._capacity, self._max_bytes)
        return self._profiles


def _bytes(profiles: Iterable[StoredNoise]) -> int:
    return sum(stored.noise.covariance.nbytes for stored in profiles)


def _read(folder: Path, capacity: int, max_bytes: int) -> dict[str, StoredNoise]:
    """The profiles of a folder; other files are ignored."""
    profiles: dict[str, StoredNoise] = {}
    for path in sorted(path for path in folder.glob(f"*{SUFFIX}") if is_name(path.stem)):
        if len(profiles) >= capacity or _bytes(profiles.values()) >= max_bytes:
            logger.warning("%s exceeds the limit of noise profiles: the rest is left out", folder)
            break
        try:
            if not path.is_file():  # a pipe would be read for ever
                continue
            created = datetime.fromtimestamp(path.stat().st_mtime, UTC)
            profiles[path.stem] = StoredNoise(path.stem, load_noise(path), created)
        except NoiseError as error:
            logger.warning("noise profile %s left out: %s", path, error.detail)
        except OSError as error:
            logger.warning("noise profile %s left out: %s", path, error)
    return profiles


def _write(folder: Path, name: str, noise: NoiseCovariance) -> None:
    """Write to a temporary file and rename it: a reader never sees half a profile."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=folder, prefix=".", suffix=".part", delete=False) as file:
        path = Path(file.name)
        try:
            save_noise(noise, file)  # type: ignore[arg-type]
        except BaseException:
            path.unlink(missing_ok=True)
            raise
    path.replace(folder / f"{name}{SUFFIX}")

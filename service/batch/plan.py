"""What every recording of a run is localized with, settled before the first one is opened."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from neuralmusic.errors import InvalidOption
from neuralmusic.protocol.methods import Method
from service.audio.recording import AudioLimits
from service.inference.choice import choose_method
from service.inference.results import ModelIdentity
from service.recordings.answers import ModelAnswer
from service.recordings.job import RecordingJob
from service.recordings.options import LocalizeRequest
from service.settings import Settings
from service.startup import load_registry
from service.workers.link import Setup


@dataclass(frozen=True, slots=True)
class Plan:
    """The job of every recording and what its workers run with; it can be sent to any machine."""

    job: RecordingJob
    given: Mapping[str, str]
    """The options as they were given, and the hash of the noise profile"""
    setup: Setup
    """With the bundles' content, so that all machines localize with the same"""
    method: Method
    model: ModelIdentity | None

    @classmethod
    def settle(
        cls,
        asked: LocalizeRequest,
        given: Mapping[str, str],
        settings: Settings,
        limits: AudioLimits,
    ) -> Self:
        """Choose method and model as ``localize`` does.

        Raises
        ------
        BundleError, ConfigError, OptionError
            If the bundles cannot be loaded, or the options do not fit them or the array.
        """
        registry = load_registry(settings)
        options = asked.options
        method, bundle = choose_method(options.method, options.model, options.array, registry)
        return cls(
            RecordingJob(asked, limits),
            dict(given),
            # As many recordings at a time as there are CPUs: each has one.
            Setup(settings.model_copy(update={"processes": 1}), registry.files),
            method,
            bundle.identity if bundle else None,
        )

    @property
    def identity(self) -> dict[str, Any]:
        """What must be the same for two records to belong into one result; JSON's types alone."""
        model = self.model and ModelAnswer.model_validate(self.model, from_attributes=True)
        return {
            "options": dict(self.given),
            "method": self.method,
            "model": model and model.model_dump(mode="json"),
        }

    def check(self, identity: Mapping[str, Any], place: str) -> None:
        """Raise InvalidOption where a result was made with something else."""
        for name, ours in self.identity.items():
            theirs = identity.get(name)
            if theirs != ours:
                raise InvalidOption(
                    f"{place} holds results of another run, with the {name} {_short(theirs)} "
                    f"instead of {_short(ours)}: name another --out, or delete it"
                )


def _short(value: Any) -> str:
    """A part of an identity in words."""
    if not isinstance(value, dict):
        return str(value)
    if "sha256" in value:
        return f"{value.get('name')} {value.get('version')} ({str(value['sha256'])[:12]})"
    return " ".join(f"{name}={text}" for name, text in value.items())

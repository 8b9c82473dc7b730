"""The options and models of a run, settled before the first recording is opened."""

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
    """The job for every recording and its workers' setup; it can be sent to any machine."""

    job: RecordingJob
    given: Mapping[str, str]
    """Options as the user gave them, with the hash of the noise profile"""
    setup: Setup
    """Workers' setup with the bundles' content, so that all machines use the same models"""
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
            # One CPU for each recording: as many recordings run at a time as there are CPUs.
            Setup(settings.model_copy(update={"processes": 1}), registry.files),
            method,
            bundle.identity if bundle else None,
        )

    @property
    def identity(self) -> dict[str, Any]:
        """What records of one result must have in common; JSON types alone."""
        model = self.model and ModelAnswer.model_validate(self.model, from_attributes=True)
        return {
            "options": dict(self.given),
            "method": self.method,
            "model": model and model.model_dump(mode="json"),
        }

    def check(self, identity: Mapping[str, Any], place: str) -> None:
        """Raise InvalidOption where a result was made with other options or models."""
        for name, ours in self.identity.items():
            theirs = identity.get(name)
            if theirs != ours:
                raise InvalidOption(
                    f"{place} holds results of another run, with the {name} {_short(theirs)} "
                    f"instead of {_short(ours)}: name another --out, or delete it"
                )


def _short(value: Any) -> str:
    """A short text for a part of an identity."""
    if not isinstance(value, dict):
        return str(value)
    if "sha256" in value:
        return f"{value.get('name')} {value.get('version')} ({str(value['sha256'])[:12]})"
    return " ".join(f"{name}={text}" for name, text in value.items())

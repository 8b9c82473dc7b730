"""What every recording of a run is localized with, settled before the first one is opened."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from service.api.schemas import ModelAnswer
from service.audio import AudioLimits
from service.errors import BundleIncompatible, InvalidOption
from service.inference.choice import check_num_sources, choose_method
from service.inference.registry import BundleRegistry
from service.inference.results import LocalizeOptions, Method, ModelIdentity
from service.settings import Settings
from service.startup import load_registry


@dataclass(frozen=True, slots=True)
class Plan:
    """Options, limits and the model that answers; sent to every process that localizes."""

    options: LocalizeOptions
    given: Mapping[str, str]
    """The options as they were given, and the hash of the noise profile"""
    settings: Settings
    limits: AudioLimits
    method: Method
    model: ModelIdentity | None

    @classmethod
    def settle(
        cls,
        options: LocalizeOptions,
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
        method, model = _choice(options, load_registry(settings))
        return cls(options, dict(given), settings, limits, method, model)

    @property
    def identity(self) -> dict[str, Any]:
        """What must be the same for two records to belong into one result; JSON's types alone."""
        model = self.model and ModelAnswer.model_validate(self.model, from_attributes=True)
        return {
            "options": dict(self.given),
            "method": self.method,
            "model": model and model.model_dump(mode="json"),
        }

    def load(self) -> BundleRegistry:
        """The bundles, in the process that localizes.

        Raises
        ------
        BundleError, ConfigError
            If they cannot be loaded.
        BundleIncompatible
            If they are others than where the plan was made.
        """
        registry = load_registry(self.settings)
        _, model = _choice(self.options, registry)
        if model != self.model:
            raise BundleIncompatible(
                f"this machine would localize with {_named(model)} instead of "
                f"{_named(self.model)}: install the same version and models on all machines"
            )
        return registry

    def check(self, identity: Mapping[str, Any], place: str) -> None:
        """Raise InvalidOption where a result was made with something else."""
        for name, ours in self.identity.items():
            theirs = identity.get(name)
            if theirs != ours:
                raise InvalidOption(
                    f"{place} holds results of another run, with the {name} {_short(theirs)} "
                    f"instead of {_short(ours)}: name another --out, or delete it"
                )


def _choice(
    options: LocalizeOptions, registry: BundleRegistry
) -> tuple[Method, ModelIdentity | None]:
    check_num_sources(options.num_sources, options.array)
    method, bundle = choose_method(options.method, options.model, options.array, registry)
    return method, bundle.identity if bundle else None


def _named(model: ModelIdentity | None) -> str:
    return f"{model.name} {model.version} ({model.sha256[:12]})" if model else "no model"


def _short(value: Any) -> str:
    """A part of an identity in words."""
    if not isinstance(value, dict):
        return str(value)
    if "sha256" in value:
        return f"{value.get('name')} {value.get('version')} ({str(value['sha256'])[:12]})"
    return " ".join(f"{name}={text}" for name, text in value.items())

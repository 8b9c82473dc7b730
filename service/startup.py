"""What a process loads before it can localize, for the server and the command line."""

from __future__ import annotations

from neuralmusic.errors import ConfigError, UnknownModel
from service.inference.registry import BundleRegistry
from service.settings import Settings


def load_registry(settings: Settings) -> BundleRegistry:
    """The bundles that the settings name, self-tested.

    Raises
    ------
    BundleError
        If a bundle cannot be used.
    ConfigError
        If the default model is not among the bundles.
    """
    try:
        return BundleRegistry.load(settings.models, default=settings.default_model)
    except UnknownModel as error:
        raise ConfigError(f"default_model: {error.detail}") from None

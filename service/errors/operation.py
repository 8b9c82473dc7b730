"""Bundles that cannot serve, and a service that is full or stops."""

from __future__ import annotations

from service.errors.base import DoaError


class BundleError(DoaError):
    """A model bundle cannot be used."""

    code, title = "bundle_invalid", "Unusable model bundle"


class BundleNotFound(BundleError):
    """There is no bundle at that place."""

    code, title = "bundle_not_found", "Model bundle not found"


class BundleCorrupt(BundleError):
    """A file of the bundle is missing or its hash differs from the manifest's."""

    code, title = "bundle_corrupt", "Corrupt model bundle"


class BundleIncompatible(BundleError):
    """The bundle was written for another version of this service."""

    code, title = "bundle_incompatible", "Incompatible model bundle"


class SelfTestFailed(BundleError):
    """The bundle's golden input does not give the golden output on this machine."""

    code, title = "self_test_failed", "Model self-test failed"


class ReloadRefused(BundleError):
    """The bundles on disk cannot be used; those that were loaded go on serving."""

    code, status, title = "reload_refused", 409, "Reload refused"


class CapacityError(DoaError):
    """The service is full; the same request may pass later."""

    code, status, title, retryable = "capacity", 503, "Out of capacity", True
    close_code = 1013


class Overloaded(CapacityError):
    """Every worker is busy and the queue is full."""

    code, title = "overloaded", "Overloaded"


class DiskFull(CapacityError):
    """What a client sent cannot be stored: the disk is full or refuses to be written."""

    code, title = "disk_full", "Disk full"


class NotReady(CapacityError):
    """The models are not loaded yet."""

    code, title = "not_ready", "Not ready"


class Draining(CapacityError):
    """The service is shutting down."""

    code, title = "draining", "Shutting down"
    close_code = 1012


class WorkerLost(CapacityError):
    """The process that computed a stream or localized a recording ended."""

    code, title = "worker_lost", "Worker lost"
    close_code = 1011

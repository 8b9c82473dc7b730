"""The bundles of a process, and the choice among them by geometry."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from neuralmusic.errors import (
    BundleCorrupt,
    BundleNotFound,
    DoaError,
    GeometryMismatch,
    SelfTestFailed,
    UnknownModel,
)
from service.doa.array import MicrophoneArray
from service.inference.bundle import (
    GOLDEN,
    MANIFEST,
    Bundle,
    BundleFiles,
    load_bundle,
    open_bundle,
    read_manifest,
)
from service.inference.localizer import localizer_of
from service.inference.manifest import Manifest

EMBEDDED_MODELS = Path(__file__).parent.parent / "models"
GOLDEN_TOLERANCE = 1e-3
"""Largest difference of spectra, whose maximum is 1; OpenBLAS's kernels for CPUs from Nehalem to
SkylakeX, chosen by OPENBLAS_CORETYPE, differ by 2e-6"""


class BundleRegistry:
    """Loaded and self-tested bundles; the first one that fits an array is its default."""

    def __init__(self, bundles: Sequence[Bundle]) -> None:
        self.bundles = tuple(bundles)
        names = [bundle.manifest.name for bundle in self.bundles]
        for name in names:
            if names.count(name) > 1:
                raise BundleCorrupt(f"two bundles are named {name!r}: keep one of them")

    @classmethod
    def load(
        cls, folders: Sequence[Path] = (), *, threads: int = 1, default: str | None = None
    ) -> BundleRegistry:
        """Load and self-test user bundles and the embedded ones.

        They are in the order of ``ordered_folders``.

        Parameters
        ----------
        folders : sequence of Path
            Bundles or folders of bundles.
        threads : int
            Threads of every onnxruntime session.
        default : str, optional
            Name of the bundle to prefer where it fits the array.

        Raises
        ------
        BundleError
            If a bundle cannot be used.
        UnknownModel
            If no bundle has the default's name.
        """
        bundles = [load_bundle(folder, threads=threads) for folder in ordered_folders(folders)]
        for bundle in bundles:
            _check(bundle)
        registry = cls(bundles)
        if default is None:
            return registry
        preferred = registry.get(default)
        return cls([preferred, *(bundle for bundle in bundles if bundle is not preferred)])

    @classmethod
    def of_files(cls, files: Sequence[BundleFiles], *, threads: int = 1) -> BundleRegistry:
        """The bundles of another process's registry, which has verified and self-tested them."""
        return cls([open_bundle(each, threads=threads) for each in files])

    @property
    def files(self) -> tuple[BundleFiles, ...]:
        """All bundles in order, in a form that another process can open."""
        return tuple(bundle.files for bundle in self.bundles)

    def __str__(self) -> str:
        return ", ".join(f"{each.manifest.name} {each.manifest.version}" for each in self.bundles)

    def get(self, name: str) -> Bundle:
        """The bundle of this name, or UnknownModel."""
        for bundle in self.bundles:
            if bundle.manifest.name == name:
                return bundle
        known = ", ".join(bundle.manifest.name for bundle in self.bundles) or "none"
        raise UnknownModel(f"no model is named {name!r}; loaded are: {known}")

    def for_array(self, array: MicrophoneArray, name: str | None = None) -> Bundle | None:
        """The named bundle, or the first that fits the array, or None.

        Raises
        ------
        UnknownModel
            If no bundle has that name.
        GeometryMismatch
            If the named bundle is bound to another array.
        """
        if name is None:
            return next((bundle for bundle in self.bundles if bundle.fits(array)), None)
        bundle = self.get(name)
        if not bundle.fits(array):
            bound = bundle.bound_array()
            raise GeometryMismatch(
                f"model {name!r} is bound to the array {bound.name if bound else '?'!r}: use that "
                "array, leave the model out, or choose a classical method"
            )
        return bundle


def by_error(manifests: Sequence[Manifest]) -> list[Manifest]:
    """Manifests by their mean error in the cells that all were scored on, least first."""
    cells = [manifest.scores.get("cells", {}) for manifest in manifests]
    shared = set[str]().union(*cells).intersection(*cells)
    errors = [sum(scored[cell].get("maae_deg", 0.0) for cell in shared) for scored in cells]
    order = sorted(range(len(manifests)), key=lambda index: errors[index])
    return [manifests[index] for index in order]


def ordered_folders(folders: Sequence[Path]) -> list[Path]:
    """The folders of all bundles, the best for use first.

    The user's come first, in the given order. Embedded ones follow by their error on the scenes of
    ``docs/results.md``, without those whose name a user's bundle has. Bundles of the purpose
    ``comparison`` come last.

    Raises
    ------
    BundleError
        If one of the places does not exist, or a manifest cannot be read.
    """
    found = [(read_manifest(each)[0], each) for path in folders for each in bundle_folders(path)]
    taken = {manifest.name for manifest, _ in found}
    places = {path: read_manifest(path)[0] for path in bundle_folders(EMBEDDED_MODELS)}
    embedded = {m.name: path for path, m in places.items() if m.name not in taken}
    found += [(m, embedded[m.name]) for m in by_error(list(places.values())) if m.name in embedded]
    found.sort(key=lambda each: each[0].purpose == "comparison")
    return [path for _, path in found]


def bundle_folders(folder: Path) -> list[Path]:
    """The folder itself if it is a bundle, else its subfolders that are; or BundleNotFound."""
    if not folder.is_dir():
        raise BundleNotFound(
            f"there is no folder {folder}: name a bundle's folder, or one with bundles in it"
        )
    if (folder / MANIFEST).is_file():
        return [folder]
    return sorted(path.parent for path in folder.glob(f"*/{MANIFEST}"))


def _check(bundle: Bundle) -> None:
    """``self_test``, whatever networks and arrays that fit nothing raise in it."""
    try:
        self_test(bundle)
    except DoaError:
        raise
    except Exception as error:
        raise SelfTestFailed(
            f"bundle {bundle.manifest.name}: the golden input cannot be localized ({error!r}): "
            "its networks, arrays and manifest do not fit each other; export the model again"
        ) from error


def golden_spectra(manifest: Manifest) -> dict[str, int]:
    """Names of the golden spectra, and the number of sources that is asked for each.

    Together they run every covariance network: one source is always asked for, then every number
    with a network of its own, and 0 where the network for any number does not answer for one.
    """
    known = manifest.covariance_by_count
    others = {0, *known} - {1} if 1 in known else set(known)
    return {"spectra": 1, **{f"spectra_{count}": count for count in sorted(others)}}


def self_test(bundle: Bundle) -> None:
    """Raise SelfTestFailed unless the golden input gives the golden spectra on this machine."""
    golden = bundle.golden
    array = bundle.bound_array() or MicrophoneArray("golden", golden["positions"])
    localizer = localizer_of(bundle, array)
    asked = golden_spectra(bundle.manifest)
    if missing := sorted(asked.keys() - golden.keys()):
        raise BundleCorrupt(f"{bundle.folder / GOLDEN} lacks {missing[0]}: export the model again")
    difference = max(
        float(np.abs(estimate.spectrum - expected).max())
        for name, count in asked.items()
        for estimate, expected in zip(
            localizer.estimate(golden["windows"], count, max(count, 1)), golden[name], strict=True
        )
    )
    if not difference <= GOLDEN_TOLERANCE:
        raise SelfTestFailed(
            f"bundle {bundle.manifest.name}: the golden spectra differ by {difference:.2g} (at "
            f"most {GOLDEN_TOLERANCE:g}): this machine or its onnxruntime computes differently"
        )

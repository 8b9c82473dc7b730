"""Noise profiles: as files, in the store, and what they do for localization."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from neuralmusic.errors import (
    InvalidOption,
    NoiseMismatch,
    NoiseProfileInvalid,
)
from neuralmusic.protocol.methods import METHODS
from service.doa.array import MicrophoneArray
from service.doa.presets import preset
from service.doa.scoring import circular_error
from service.doa.stft import Stft
from service.doa.types import FloatArray
from service.doa.whitening import NoiseCovariance, learn_noise
from service.inference.classical import ClassicalLocalizer
from service.inference.localizer import Localizer, localizer_of
from service.inference.noise_profile import MAX_BYTES, load_noise, noise_bytes
from service.inference.registry import BundleRegistry
from service.inference.stream import stream_localizer_of

SQUARE = preset("respeaker-usb-4mic-v2")
MOTOR = np.deg2rad(200.0)


def motor(seconds: float, seed: int) -> FloatArray:
    """(4, T) white noise from 200 degrees and, 30 dB below, from every microphone itself."""
    rng = np.random.default_rng(seed)
    samples = round(seconds * 16000)
    omega = 2 * np.pi * np.fft.rfftfreq(samples, 1 / 16000)
    advance = SQUARE.positions @ [np.cos(MOTOR), np.sin(MOTOR), 0.0] / 343.0
    shifted = np.fft.rfft(rng.standard_normal(samples)) * np.exp(1j * omega * advance[:, None])
    heard = np.fft.irfft(shifted, samples) + 0.03 * rng.standard_normal((4, samples))
    return (0.01 * heard).astype(np.float32)


@pytest.fixture(scope="module")
def profile() -> NoiseCovariance:
    return learn_noise([motor(5.0, 0)], SQUARE, Stft())


@pytest.fixture(scope="module")
def registry() -> BundleRegistry:
    return BundleRegistry.load()


def localizer(
    method: str, registry: BundleRegistry, noise: NoiseCovariance | None, array=SQUARE
) -> Localizer:
    if method != "neural":
        return ClassicalLocalizer(method, array, noise=noise)  # type: ignore[arg-type]
    bundle = registry.for_array(array)
    assert bundle is not None
    return localizer_of(bundle, array, noise)


@pytest.mark.parametrize("method", METHODS)
def test_a_talker_is_heard_over_a_motor_that_is_known(
    method: str, profile: NoiseCovariance, registry: BundleRegistry, plane_waves
) -> None:
    truth = np.array([20.0, 65.0, 110.0, 290.0, 335.0])
    speech = [plane_waves(SQUARE, [t], seed=i) for i, t in enumerate(truth)]
    noisy = np.stack(
        [
            s + motor(s.shape[1] / 16000, 10 + i) * np.float32(s.std() / 0.01)
            for i, s in enumerate(speech)
        ]
    )

    def near(noise: NoiseCovariance | None) -> float:
        estimates = localizer(method, registry, noise).estimate(noisy, 1, 1)
        found = np.array([estimate.sources[0].azimuth for estimate in estimates])
        return float(np.mean(circular_error(found, np.deg2rad(truth)) < np.deg2rad(10)))

    assert near(profile) >= 0.8
    if method != "neural":  # the network may tell a motor from a talker on its own
        assert near(profile) > near(None)


# Plain MUSIC is left out: it reports something of a few windows of white noise, too.
@pytest.mark.parametrize("method", ["neural", "norm_music", "srp_phat"])
def test_a_known_motor_alone_is_no_source(
    method: str, profile: NoiseCovariance, registry: BundleRegistry
) -> None:
    windows = np.stack([motor(1.04, 20 + i) for i in range(4)])
    assert all(e.sources for e in localizer(method, registry, None).estimate(windows, None, 3))
    known = localizer(method, registry, profile).estimate(windows, None, 3)
    assert [e.sources for e in known] == [()] * 4


@pytest.mark.parametrize("method", METHODS)
def test_a_profile_of_another_array_is_refused(
    method: str, profile: NoiseCovariance, registry: BundleRegistry
) -> None:
    with pytest.raises(NoiseMismatch):
        localizer(method, registry, profile, preset("respeaker-4mic-hat"))


def test_the_regression_variant_refuses_noise(profile: NoiseCovariance) -> None:
    bundle: Any = SimpleNamespace(manifest=SimpleNamespace(variant="regression", name="paper"))
    with pytest.raises(InvalidOption, match="noise cannot be used with the model paper"):
        localizer_of(bundle, SQUARE, profile)


def test_a_profile_survives_its_file(profile: NoiseCovariance, tmp_path: Path) -> None:
    path = tmp_path / "fans.npz"
    path.write_bytes(noise_bytes(profile))
    loaded = load_noise(path)
    np.testing.assert_array_equal(loaded.covariance, profile.covariance)
    np.testing.assert_array_equal(loaded.array.positions, SQUARE.positions)
    assert (loaded.array.name, loaded.stft, loaded.seconds) == (
        SQUARE.name,
        profile.stft,
        profile.seconds,
    )
    assert noise_bytes(loaded) == noise_bytes(profile)


def rewritten(content: bytes, compression: int = zipfile.ZIP_STORED, **changed: Any) -> bytes:
    """A profile's file with other members; None leaves one out, bytes are written as they are."""
    target = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(content)) as source,
        zipfile.ZipFile(target, "w", compression) as written,
    ):
        for entry in source.namelist():
            name = entry.removesuffix(".npy")
            value = changed.get(name, source.read(entry))
            if value is None:
                continue
            if not isinstance(value, bytes):
                member = io.BytesIO()
                np.save(member, value, allow_pickle=True)
                value = member.getvalue()
            written.writestr(entry, value)
    return target.getvalue()


def lying_header() -> bytes:
    """A member whose header claims a petabyte."""
    member = io.BytesIO()
    header = {"descr": "<c8", "fortran_order": False, "shape": (257, 2**20, 2**20)}
    np.lib.format.write_array_header_1_0(member, header)
    return member.getvalue() + bytes(64)


def named(*characters: int) -> bytes:
    """The member of a name of these code points, which need be no characters."""
    member = io.BytesIO()
    np.save(member, np.array("", dtype="<U64"))
    return member.getvalue()[:-256] + struct.pack(f"<{len(characters)}I", *characters).ljust(
        256, b"\0"
    )


def with_members(content: bytes, count: int) -> bytes:
    """A profile with so many empty files beside it."""
    file = io.BytesIO(content)
    with zipfile.ZipFile(file, "a") as archive:
        for number in range(count):
            archive.writestr(f"{number:04x}", b"")
    return file.getvalue()


BROKEN: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda content: b"",
    "text": lambda content: b"noise" * 100,
    "cut": lambda content: content[: len(content) // 2],
    "member missing": lambda content: rewritten(content, covariance=None),
    "compressed": lambda content: rewritten(content, zipfile.ZIP_DEFLATED),
    "pickle": lambda content: rewritten(content, name=np.array({"a": 1}, dtype=object)),
    "header lies": lambda content: rewritten(content, covariance=lying_header()),
    "another version": lambda content: rewritten(content, format=np.int64(2)),
    "wrong shape": lambda content: rewritten(content, covariance=np.ones((9, 4, 4), "c8")),
    "not finite": lambda content: rewritten(
        content, covariance=np.full((257, 4, 4), np.nan, np.complex64)
    ),
    "not Hermitian": lambda content: rewritten(
        content, covariance=np.triu(np.ones((257, 4, 4), np.complex64))
    ),
    "negative": lambda content: rewritten(
        content, covariance=np.tile(-np.eye(4, dtype=np.complex64), (257, 1, 1))
    ),
    "centimetres": lambda content: rewritten(content, positions=100 * SQUARE.positions),
    "no frames": lambda content: rewritten(content, hop=np.int64(0)),
    "positions as large as floats": lambda content: rewritten(
        content, positions=1e308 * np.sign(SQUARE.positions)
    ),
    "positions far away": lambda content: rewritten(content, positions=1e15 + SQUARE.positions),
    "too few samples a second": lambda content: rewritten(content, sample_rate=np.int64(1)),
    "too many samples a second": lambda content: rewritten(content, sample_rate=np.int64(2**62)),
    "surrogate": lambda content: rewritten(content, name=named(0x41, 0xD800)),
    "beyond Unicode": lambda content: rewritten(content, name=named(0x41, 0x110000)),
    "far beyond Unicode": lambda content: rewritten(content, name=named(0x41, 0xFFFFFFFF)),
    "NUL": lambda content: rewritten(content, name=named(0x41, 0, 0x42)),
    "a line of its own": lambda content: rewritten(content, name=named(0x41, 0x0A, 0x1B)),
    "nameless": lambda content: rewritten(content, name=named()),
    "no time": lambda content: rewritten(content, seconds=np.float64(-1)),
    "hardly any time": lambda content: rewritten(content, seconds=np.float64(5e-324)),
    "ages": lambda content: rewritten(content, seconds=np.float64(1e308)),
    "many members": lambda content: with_members(content, 6000),
    "too many members": lambda content: with_members(content, 2**16),
    "too large": lambda content: content + bytes(MAX_BYTES),
}


@pytest.mark.parametrize("broken", BROKEN)
def test_a_file_that_is_no_profile_is_refused(broken: str, profile: NoiseCovariance) -> None:
    with pytest.raises(NoiseProfileInvalid):
        load_noise(io.BytesIO(BROKEN[broken](noise_bytes(profile))))


def test_the_rewriting_of_members_alone_breaks_nothing(profile: NoiseCovariance) -> None:
    assert load_noise(io.BytesIO(rewritten(noise_bytes(profile)))).stft == profile.stft


def one_bin() -> FloatArray:
    matrices = np.zeros((257, 4, 4))
    matrices[0, 0, 0] = 1
    return matrices


# Bins decades apart, and off by what rounding leaves of the loudest.
DECADES = (10.0 ** np.linspace(-45, 38, 257))[:, None, None] * np.eye(4)
EXTREME = {
    "largest": np.tile(1e38 * np.eye(4), (257, 1, 1)),
    "largest everywhere": np.full((257, 4, 4), 3.4e38 * (1 + 0j)),
    "smallest": np.tile(1e-45 * np.eye(4), (257, 1, 1)),
    "one value": one_bin(),
    "decades": DECADES,
    "barely negative": DECADES - 1e33 * np.diag([0, 0, 1, 2]),
}


@pytest.mark.parametrize("extreme", EXTREME)
def test_a_profile_of_extreme_values_gives_directions_or_none(
    extreme: str, profile: NoiseCovariance, registry: BundleRegistry, plane_waves
) -> None:
    content = rewritten(noise_bytes(profile), covariance=EXTREME[extreme].astype(np.complex64))
    noise = load_noise(io.BytesIO(content))
    audio = plane_waves(SQUARE, [50.0])
    spectra = Stft().transform(audio)
    for method in METHODS:
        bundle = registry.for_array(SQUARE) if method == "neural" else None
        stream = stream_localizer_of(method, bundle, SQUARE, Stft(), noise)
        stream.push(spectra)
        found = [
            *localizer(method, registry, noise).estimate(audio[None], None, 3),
            *localizer(method, registry, noise).estimate(audio[None], 2, 3),
            stream.estimate(None, 3),
        ]
        for estimate in found:
            assert np.isfinite(estimate.spectrum).all()
            for source in estimate.sources:
                assert 0 <= source.azimuth < 2 * np.pi
                assert 0 <= source.confidence <= 1


def test_the_largest_array_with_the_longest_frames_fits_in_a_file() -> None:
    rng = np.random.default_rng(0)
    array = MicrophoneArray("many", rng.uniform(-0.5, 0.5, (32, 3)))
    covariance = np.tile(np.eye(32, dtype=np.complex64), (2049, 1, 1))
    noise = NoiseCovariance(covariance, array, Stft(16000, 4096, 2048), 5.0)
    assert load_noise(io.BytesIO(noise_bytes(noise))).covariance.shape == (2049, 32, 32)

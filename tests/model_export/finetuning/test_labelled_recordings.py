"""Labelled recordings: labels, refusals and their reasons, and the scenes made of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import soundfile

from model_export.finetuning.labelled_recordings import (
    LabelledRecording,
    level_gate,
    load_recordings,
)
from model_export.finetuning.labelled_scenes import Augmentation, LabelledScenes, room_noise
from model_export.finetuning.labels import LABELS, read_labels
from model_export.simulation.protocol import SceneProtocol, write_scenes
from model_export.simulation.scenes import WINDOW_SAMPLES, SceneConfig
from model_export.simulation.synthesis import synthetic_voice
from service.doa.array import MicrophoneArray
from service.doa.types import FloatArray

pytestmark = pytest.mark.torch

PlaneWaves = Callable[..., FloatArray]


@pytest.fixture
def record(tmp_path: Path, square: MicrophoneArray, plane_waves: PlaneWaves) -> Callable[..., Path]:
    def write(name: str, azimuth: float = 40.0, rate: int = 16000, **how: float) -> Path:
        audio = plane_waves(square, [azimuth], rate=rate, **{"seconds": 2.0, **how})
        soundfile.write(tmp_path / name, audio.T, rate, subtype="PCM_16")
        return tmp_path / name

    return write


def label(folder: Path, *rows: str, header: str = "file,azimuth_deg") -> None:
    (folder / LABELS).write_text("\n".join([header, *rows]) + "\n")


def with_pauses(square: MicrophoneArray, plane_waves: PlaneWaves) -> FloatArray:
    """Audio (4, T): a second of noise, one and a half of sound, a second of noise."""
    sound = plane_waves(square, [90.0], seconds=1.5)
    rng = np.random.default_rng(0)
    noise = 0.001 * rng.standard_normal((4, 56000)).astype(np.float32)
    noise[:, 16000:40000] += sound
    return noise


def load_one(folder: Path, array: MicrophoneArray, **how: str) -> LabelledRecording:
    (recording,) = load_recordings(folder, array, **how)
    return recording


def test_a_row_per_talker_and_times(tmp_path: Path, record: Callable[..., Path]) -> None:
    path = record("both.wav", seconds=6.0)
    label(
        tmp_path,
        "both.wav,30,,",
        "both.wav,-160,2,5",
        header="file,azimuth_deg,start_s,end_s",
    )
    first, second = read_labels(tmp_path)[path]
    assert np.rad2deg([first.azimuth, second.azimuth]) == pytest.approx([30, 200])
    assert (second.start, second.end) == (2.0, 5.0)


def test_windows_lie_where_their_talkers_speak(
    tmp_path: Path, record: Callable[..., Path], square: MicrophoneArray
) -> None:
    record("both.wav", seconds=6.0)
    label(
        tmp_path,
        "both.wav,30,0,4",
        "both.wav,200,2,6",
        header="file,azimuth_deg,start_s,end_s",
    )
    windows = load_one(tmp_path, square).windows
    talkers = [np.rad2deg(w.azimuth).round().tolist() for w in windows]
    assert talkers == [[30], [30, 200], [200]]
    for window, (start, end) in zip(windows, [(0, 2), (2, 4), (4, 6)], strict=True):
        assert start * 16000 <= window.starts.min()
        assert window.starts.max() <= window.last == end * 16000 - WINDOW_SAMPLES


def test_simulated_scenes_are_labelled_recordings(tmp_path: Path, square: MicrophoneArray) -> None:
    voices = [synthetic_voice(np.random.default_rng(0), 1.0)]
    write_scenes(tmp_path, SceneProtocol(orders=(0, 0)), voices, 2, seed=3)
    (tmp_path / "array.json").write_text(json.dumps({"positions_m": []}))  # no sidecar
    for recording in load_recordings(tmp_path, square):
        truth = json.loads(recording.path.with_suffix(".json").read_text())["azimuth_deg"]
        assert np.rad2deg(recording.windows[0].azimuth) == pytest.approx(truth)


def test_other_sample_rates_and_firmware_channels(
    tmp_path: Path, square: MicrophoneArray, plane_waves: PlaneWaves
) -> None:
    raw = plane_waves(square, [40.0], seconds=2.0, rate=48000)
    silent = np.zeros_like(raw[:1])
    soundfile.write(tmp_path / "six.wav", np.concatenate([silent, raw, silent]).T, 48000)
    label(tmp_path, "six.wav,40")
    recording = load_one(tmp_path, square)
    assert recording.audio.shape == (4, 32000)
    assert (recording.audio.std(axis=1) > 0).all()
    swapped = load_one(tmp_path, square, channel_map="4,3,2,1")
    np.testing.assert_array_equal(swapped.audio, recording.audio[::-1])


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("file;azimuth_deg\na.wav;3\n", r"line 1: the header must be file,azimuth_deg"),
        ("file,azimuth_deg\na.wav,10\n\na.wav,north\n", r"line 4: azimuth_deg is 'north'"),
        ("file,azimuth_deg\na.wav,361\n", r"line 2: azimuth_deg is 361, but must lie between"),
        ("file,azimuth_deg\na.wav,nan\n", r"line 2: azimuth_deg is nan"),
        ("file,azimuth_deg\na.wav\n", r"line 2: write file,azimuth_deg"),
        ("file,azimuth_deg\na.wav,1,2\n", r"line 2: write file,azimuth_deg"),
        ("file,azimuth_deg\na.wav,1\na.wav,1\n", r"line 3 repeats an earlier row"),
        (
            "file,azimuth_deg,start_s,end_s\na.wav,1,3,2\n",
            r"line 2: start_s is 3 and end_s 2",
        ),
        (
            "file,azimuth_deg,start_s,end_s\na.wav,1,0,9\n",
            r"a\.wav: a label holds until 9 s, but the recording lasts 2\.00 s",
        ),
        ("file,azimuth_deg\na.wav,0\nb.wav,9\n", r"labels b\.wav, but there is no such"),
        ("file,azimuth_deg\n", r"a\.wav has no label \(1 of 1 recordings\)"),
    ],
)
def test_wrong_tables(
    tmp_path: Path,
    record: Callable[..., Path],
    square: MicrophoneArray,
    table: str,
    message: str,
) -> None:
    record("a.wav")
    (tmp_path / LABELS).write_text(table)
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        load_recordings(tmp_path, square)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", r"a\.json is no JSON text"),
        ('{"azimuth_deg": []}', r"a\.json: azimuth_deg is empty"),
        ('{"azimuth_deg": [700]}', r"a\.json: azimuth_deg is 700"),
        ('{"azimuth": 7}', r"a\.wav has no label"),
    ],
)
def test_wrong_sidecars(
    tmp_path: Path, record: Callable[..., Path], content: str, message: str
) -> None:
    record("a.wav").with_suffix(".json").write_text(content)
    with pytest.raises(ValueError, match=message):
        read_labels(tmp_path)


def test_a_sidecar_without_its_recording(tmp_path: Path) -> None:
    (tmp_path / "gone.json").write_text('{"azimuth_deg": 3}')
    with pytest.raises(FileNotFoundError, match=r"gone\.json labels .* no such recording"):
        read_labels(tmp_path)


def test_no_folder_and_no_recordings(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="is no folder"):
        read_labels(tmp_path / "none")
    with pytest.raises(ValueError, match="holds no recordings"):
        read_labels(tmp_path)


def _loud(audio: FloatArray) -> FloatArray:
    return np.clip(audio * 40, -1, 1)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda audio: audio[:2], r"has 2 channels, but respeaker-usb-4mic-v2 has 4"),
        (lambda audio: np.vstack([audio, audio[:1]]), r"5 channels.*--channel-map"),
        (lambda audio: audio[:, :12000], r"too short: .* lasts 0\.75 s"),
        (lambda audio: 0 * audio, r"the recording is silent"),
        (lambda audio: 1e-4 * audio, r"the loudest half second has .* dBFS"),
        (_loud, r"clipped, up to .* lower the recording gain"),
        (lambda audio: audio * [[1], [1], [0], [1]], r"channel 2 is silent"),
    ],
)
def test_unusable_recordings_are_named_with_the_reason(
    tmp_path: Path,
    square: MicrophoneArray,
    plane_waves: PlaneWaves,
    damage: Callable[[FloatArray], FloatArray],
    message: str,
) -> None:
    audio = damage(plane_waves(square, [40.0], seconds=2.0))
    soundfile.write(tmp_path / "a.wav", audio.T, 16000, subtype="PCM_16")
    label(tmp_path, "a.wav,40")
    with pytest.raises(ValueError, match=rf"a\.wav: .*{message}"):
        load_recordings(tmp_path, square)


def test_a_file_that_is_no_audio(tmp_path: Path, square: MicrophoneArray) -> None:
    (tmp_path / "a.wav").write_text("not a recording")
    label(tmp_path, "a.wav,40")
    with pytest.raises(ValueError, match=r"a\.wav: the bytes are no audio file"):
        load_recordings(tmp_path, square)


def test_labelled_silence_inside_of_a_recording(
    tmp_path: Path, square: MicrophoneArray, plane_waves: PlaneWaves
) -> None:
    audio = np.pad(with_pauses(square, plane_waves), [(0, 0), (0, 32000)])
    audio += 0.001 * np.random.default_rng(1).standard_normal(audio.shape).astype(np.float32)
    soundfile.write(tmp_path / "a.wav", audio.T, 16000)
    label(tmp_path, "a.wav,90,3.5,5.5", header="file,azimuth_deg,start_s,end_s")
    with pytest.raises(ValueError, match=r"a\.wav: the labelled parts hold no sound"):
        load_recordings(tmp_path, square)


def test_too_many_talkers_at_once(
    tmp_path: Path, record: Callable[..., Path], square: MicrophoneArray
) -> None:
    record("a.wav")
    label(tmp_path, *(f"a.wav,{azimuth}" for azimuth in range(0, 250, 50)))
    with pytest.raises(ValueError, match=r"a\.wav: 5 talkers are labelled at once"):
        load_recordings(tmp_path, square)


def test_the_gate_finds_sound_and_pauses(square: MicrophoneArray, plane_waves: PlaneWaves) -> None:
    sounding, quiet = level_gate(with_pauses(square, plane_waves))
    inside = slice(16000 // 512 + 1, 40000 // 512)
    assert sounding[inside].mean() > 0.6
    assert not sounding[: 16000 // 512].any()
    assert quiet[: 16000 // 512].mean() > 0.8
    assert not (quiet & sounding).any()


def test_steady_sound_is_all_sound() -> None:
    noise = np.random.default_rng(0).standard_normal((4, 32000)).astype(np.float32)
    sounding, quiet = level_gate(noise)
    assert sounding.all()
    assert not quiet.any()


@pytest.fixture
def scenes(
    tmp_path: Path, square: MicrophoneArray, plane_waves: PlaneWaves
) -> tuple[LabelledScenes, list[LabelledRecording]]:
    for index, azimuth in enumerate((90.0, 200.0)):
        audio = with_pauses(square, lambda *_, a=azimuth, **how: plane_waves(square, [a], **how))
        soundfile.write(tmp_path / f"{index}.wav", audio.T, 16000)
    label(tmp_path, "0.wav,90", "1.wav,200")
    recordings = load_recordings(tmp_path, square)
    return LabelledScenes(recordings, square), recordings


def test_mixtures_have_both_talkers(
    scenes: tuple[LabelledScenes, list[LabelledRecording]],
) -> None:
    drawn, rng = scenes[0], np.random.default_rng(0)
    settings = Augmentation(mixtures=1.0, noise=0.0)
    counts = []
    for _ in range(20):
        scene = drawn.draw(rng, settings, SceneConfig())
        assert scene.audio.shape == (4, WINDOW_SAMPLES)
        degrees = np.rad2deg(scene.azimuth).round()
        assert set(degrees) <= {90.0, 200.0}
        counts.append(len(degrees))
        assert len(set(degrees)) == len(degrees)
    assert {1, 2} == set(counts)  # a recording is never added to its own direction


def test_added_noise_has_its_level(scenes: tuple[LabelledScenes, list[LabelledRecording]]) -> None:
    (clean, *_) = scenes[0].windows(1)
    noisy = scenes[0].with_noise(np.random.default_rng(0), clean, 6.0)
    scale = np.sqrt(np.mean(clean.audio[0] ** 2))
    noise = noisy.audio - clean.audio / scale
    assert 10 * np.log10(1 / np.mean(noise[0] ** 2)) == pytest.approx(6.0, abs=0.1)


def test_room_noise_sounds_like_the_pauses(
    scenes: tuple[LabelledScenes, list[LabelledRecording]],
) -> None:
    recording = scenes[1][0]
    noise = room_noise(np.random.default_rng(0), recording, WINDOW_SAMPLES)
    assert noise.shape == (4, WINDOW_SAMPLES)
    assert np.std(noise) == pytest.approx(0.001, rel=0.1)  # with_pauses' noise, no gaps or bumps
    halves = np.std(noise.reshape(4, 10, -1), axis=(0, 2))
    assert halves == pytest.approx(0.001, rel=0.3)

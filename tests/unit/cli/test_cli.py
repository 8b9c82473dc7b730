"""The command line as users meet it: output, exit codes, and one sentence for every error."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from command_line import refusal, run
from fastapi.testclient import TestClient

import neuralmusic.cli.arrays
import neuralmusic.cli.commands
import service.server
from neuralmusic import __version__
from neuralmusic.cli import main
from neuralmusic.cli.commands import OF_THE_SERVICE
from service.app import create_app
from service.doa.presets import PRESETS, preset
from service.doa.types import FloatArray
from service.inference.manifest import SCHEMA_VERSION
from service.inference.registry import EMBEDDED_MODELS
from service.settings import Settings

ARRAY = "respeaker-usb-4mic-v2"
RATE = 16_000


def bursts(azimuths_deg: list[float]) -> FloatArray:
    """(N, T) half a second of noise from each direction, delayed exactly."""
    random = np.random.default_rng(2)
    count = RATE // 2
    frequency = np.fft.rfftfreq(2 * count, 1 / RATE)
    parts = []
    for azimuth in np.deg2rad(azimuths_deg):
        sound = np.hanning(count) * random.standard_normal(count)
        lead = preset(ARRAY).positions @ [np.cos(azimuth), np.sin(azimuth), 0.0] / 343.0
        shifted = np.fft.rfft(sound, 2 * count) * np.exp(2j * np.pi * frequency * lead[:, None])
        parts.append(np.fft.irfft(shifted)[:, :count])
    audio = np.concatenate(parts, axis=-1)
    noisy = 0.1 * (audio + 0.03 * random.standard_normal(audio.shape))
    return noisy.astype(np.float32)


def write(path: Path, audio: FloatArray) -> str:
    soundfile.write(path, audio.T, RATE)
    return str(path)


@pytest.fixture
def talker(tmp_path: Path) -> str:
    return write(tmp_path / "talker.wav", bursts([60.0] * 4))


@pytest.fixture
def moving(tmp_path: Path) -> str:
    return write(tmp_path / "moving.wav", bursts([10, 100, 200, 250, 330, 45, 160, 290]))


def test_the_version_and_every_command_are_shown(capsys: pytest.CaptureFixture[str]) -> None:
    for argv in (["--version"], ["--help"]):
        with pytest.raises(SystemExit, match="0"):
            main(argv)
    out = capsys.readouterr().out
    assert out.startswith(f"neuralmusic {__version__}\n")
    assert all(f"\n    {name} " in out for name in (*OF_THE_SERVICE, "stream", "arrays"))
    assert "neuralmusic-service" not in out


def test_a_command_that_is_missing_says_which_package_brings_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(neuralmusic.cli.commands, "_entry_points", lambda: iter(()))
    for name in OF_THE_SERVICE:
        said = refusal(capsys, name, "--port", "1")
        assert f"{name} comes with the package neuralmusic-service" in said
        assert "pip install ./client ." in said
    with pytest.raises(SystemExit, match="0"):
        main(["--help"])
    out = " ".join(capsys.readouterr().out.split())
    assert f"neuralmusic-service adds {', '.join(OF_THE_SERVICE)}." in out
    assert "localize the sources" not in out
    assert main(["arrays"]) == 0


@pytest.mark.parametrize(
    "argv", [[], ["dance"], ["serve", "--prot", "1"], ["localize", "x.wav"], ["check"]]
)
def test_wrong_usage_exits_with_2(argv: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(argv)
    assert "usage: neuralmusic" in capsys.readouterr().err


def test_help_and_check_load_no_onnxruntime_and_no_server(talker: str) -> None:
    code = (
        "import sys\nfrom neuralmusic.cli import main\n"
        f"code = main(['check', {talker!r}, '--array', {ARRAY!r}])\n"
        "sys.exit(code or bool({'onnxruntime', 'fastapi', 'matplotlib'} & set(sys.modules)))"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_check_passes_a_good_recording(moving: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "check", moving, "--array", ARRAY)
    assert code == 0
    assert out.splitlines()[-1] == "nothing wrong found"
    assert "4.0 s, 4 channels, 16000 Hz" in out


def test_check_without_an_array_says_what_it_left_out(
    moving: str, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = run(capsys, "check", moving)
    assert code == 0
    assert "not checked: name the --array" in out


def test_check_finds_swapped_channels_and_its_advice_helps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    swapped = bursts([10, 100, 200, 250, 330, 45, 160, 290])[[1, 0, 2, 3]]
    file = write(tmp_path / "swapped.wav", swapped)
    code, out, _ = run(capsys, "check", file, "--array", ARRAY)
    assert code == 1
    assert "channel_order: " in out
    code, _, _ = run(capsys, "check", file, "--array", ARRAY, "--channel-map", "1,0,2,3")
    assert code == 0


def test_check_judges_only_the_raw_channels_of_a_known_firmware(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    raw = bursts([10, 100, 200, 250, 330, 45, 160, 290])
    silent = np.zeros_like(raw[:1])
    file = write(tmp_path / "six.wav", np.concatenate([raw.mean(0, keepdims=True), raw, silent]))
    code, out, _ = run(capsys, "check", file, "--array", ARRAY, "--json")
    answer = json.loads(out)
    assert code == 0
    assert answer["channel_map"] == [1, 2, 3, 4]
    assert answer["geometry_unchecked"] is None
    assert len(answer["levels"]) == 6
    assert answer["levels"][5]["rms_dbfs"] is None
    code, out, _ = run(capsys, "check", file, "--array", ARRAY)
    assert "not a microphone" in out
    code, out, _ = run(capsys, "check", file, "--json")
    assert code == 1
    assert [f["channels"] for f in json.loads(out)["findings"]] == [[5]]


def test_localize_prints_the_direction(talker: str, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, "localize", talker, "--array", ARRAY, "--method", "norm_music")
    assert (code, err) == (0, "")
    assert f"2.0 s of {ARRAY} (channels 0, 1, 2, 3) by norm_music" in out
    assert "60° front left" in out.splitlines()[2]


@pytest.mark.parametrize("command", ["localize", "check", "noise"])
def test_a_recording_may_come_from_standard_input(
    talker: str, command: str, tmp_path: Path
) -> None:
    """A pipe, which cannot be sought, gives what the file gives."""
    answers = []
    for file, piped in ((talker, b""), ("-", Path(talker).read_bytes())):
        profile = tmp_path / "profile.npz"
        more = ["--out", str(profile)] if command == "noise" else ["--json"]
        argv = [command, file, "--array", ARRAY, *more]
        code = f"import sys; from neuralmusic.cli import main; sys.exit(main({argv!r}))"
        done = subprocess.run(
            [sys.executable, "-c", code], input=piped, capture_output=True, check=False
        )
        answers.append((done.returncode, done.stdout, done.stderr))
    assert answers[0][0] != 2
    assert answers[0] == answers[1]


def test_localize_prints_the_json_of_the_http_interface(
    moving: str, capsys: pytest.CaptureFixture[str]
) -> None:
    geometry = json.dumps({"name": "mine", "positions_m": preset(ARRAY).positions.tolist()})
    options = {"array": geometry, "channel_map": "3,2,1,0", "hop_s": "0.7", "max_sources": "2"}
    with TestClient(create_app(Settings(workers=1))) as client:
        body = Path(moving).read_bytes()
        headers = {"Content-Type": "audio/wav"}
        answer = client.post("/localize", params=options, content=body, headers=headers)
    flags = ["--channel-map", "3,2,1,0", "--hop", "0.7", "--max-sources", "2"]
    code, out, _ = run(capsys, "localize", moving, "--array", geometry, *flags, "--json")
    assert (code, answer.status_code) == (0, 200)
    assert json.loads(out) == answer.json()


def test_an_array_may_come_from_a_file(
    talker: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "array.json"
    file.write_text(json.dumps({"positions_m": preset(ARRAY).positions.tolist()}))
    flags = ["--method", "srp_phat", "--num-sources", "1", "--json"]
    _, out, _ = run(capsys, "localize", talker, "--array", f"@{file}", *flags)
    answer = json.loads(out)
    assert answer["array"]["name"] == "custom"
    assert answer["summary"]["sources"][0]["azimuth_deg"] == pytest.approx(60, abs=3)


def test_localize_draws_a_picture(
    talker: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "picture.png"
    flags = ["--method", "norm_music", "--plot", str(picture)]
    assert run(capsys, "localize", talker, "--array", ARRAY, *flags)[0] == 0
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("command", ["localize", "check"])
def test_unusable_files_are_one_sentence(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = tmp_path / "notes.txt"
    text.write_text("no audio")
    for path, reason in (
        (tmp_path / "none.wav", "No such file or directory"),
        (tmp_path, "Is a directory"),
        (text, "no audio file"),
    ):
        assert reason in refusal(capsys, command, str(path), "--array", ARRAY)


@pytest.mark.parametrize(
    ("flags", "reason"),
    [
        (["--array", "respeaker"], "no array preset is called 'respeaker'"),
        (["--array", "@none.json"], "none.json: No such file"),
        (["--array", '{"positions_m": 1}'], "positions_m must be a list"),
        (["--array", "matrix-creator"], "8 microphones"),
        (["--array", ARRAY, "--channel-map", "0,1,2,9"], "names channel 9"),
        (["--array", ARRAY, "--channel-map", "0,1"], "names 2 channels"),
        (["--array", ARRAY, "--channel-map", "a"], "channel_map must list"),
    ],
)
@pytest.mark.parametrize("command", ["localize", "check"])
def test_wrong_arrays_and_maps_are_one_sentence(
    command: str, flags: list[str], reason: str, talker: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert reason in refusal(capsys, command, talker, *flags)


@pytest.mark.parametrize(
    ("flags", "reason"),
    [
        (["--num-sources", "4"], "at most 3"),
        (["--window", "0"], "window_s must be"),
        (["--model", "none"], "no model is named 'none'"),
        (["--plot", "picture.txt"], "no picture format"),
    ],
)
def test_wrong_options_are_one_sentence(
    flags: list[str], reason: str, talker: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert reason in refusal(capsys, "localize", talker, "--array", ARRAY, *flags)


def test_arrays_lists_every_preset_and_shows_one(capsys: pytest.CaptureFixture[str]) -> None:
    _, out, _ = run(capsys, "arrays")
    assert [line.split()[0] for line in out.splitlines()[1:]] == list(PRESETS)
    _, out, _ = run(capsys, "arrays", ARRAY)
    assert "22.85" in out
    assert "--channel-map 1,2,3,4" in out
    assert "did you mean 'matrix-voice'" in refusal(capsys, "arrays", "matrix_voice")


def manifest(**changes: Any) -> dict[str, Any]:
    graph = {"inputs": [], "outputs": []}
    return {
        "schema_version": SCHEMA_VERSION,
        "name": "square",
        "version": "2.1.0",
        "variant": "regression",
        "description": "A bundle [for tests].",
        "array": {"name": "small", "positions_m": [[0, 0, 0], [0.1, 0, 0]]},
        "stft": {"sample_rate": 16000, "n_fft": 512, "hop": 256, "frames": 64},
        "grid_size": 360,
        "first_bin": 1,
        "num_bins": 256,
        "max_sources": 3,
        "files": {"golden.npz": hashlib.sha256(b"golden").hexdigest()},
        "covariance": graph,
        "source_count": graph,
        "training": {"seed": 7, "config": {"steps": 1000}},
        "scores": {"cells": {"M=1": {"median_deg": 1.23456}}},
        "parity": {},
        "licences": ["CC BY 4.0 (Speech Commands)"],
        **changes,
    }


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    folder = tmp_path / "square"
    folder.mkdir()
    (folder / "bundle.json").write_text(json.dumps(manifest()))
    (folder / "golden.npz").write_bytes(b"golden")
    return folder


def test_bundle_show_prints_the_manifest(bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "bundle", "show", str(bundle))
    assert code == 0
    digest = hashlib.sha256((bundle / "bundle.json").read_bytes()).hexdigest()
    told = ["square 2.1.0", "[for tests]", "regression", "small", digest, "config.steps", "Speech"]
    assert [text for text in told if text not in out] == []
    assert out.splitlines()[-1] == "  golden.npz: 0 KiB, whole"
    scores = [line.split() for line in out.splitlines()]
    assert ["cell", "median_deg"] in scores
    assert ["M=1", "1.23"] in scores
    (bundle / "card.md").write_text("# The card [of tests]\n")
    _, out, _ = run(capsys, "bundle", "show", str(bundle))
    assert "\ncard\n# The card [of tests]\nfiles\n" in out


@pytest.mark.parametrize("content", [b"other", None])
def test_bundle_show_tells_changed_and_missing_files(
    content: bytes | None, bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (bundle / "golden.npz").unlink()
    if content:
        (bundle / "golden.npz").write_bytes(content)
    code, out, _ = run(capsys, "bundle", "show", str(bundle))
    assert code == 1
    assert out.splitlines()[-1].endswith("CHANGED" if content else "missing")


def test_bundle_show_lists_and_finds_what_the_service_would_load(
    bundle: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NEURALMUSIC_MODELS", str(bundle.parent))
    _, out, _ = run(capsys, "bundle", "show")
    embedded = [path.parent.name for path in EMBEDDED_MODELS.glob("*/bundle.json")]
    assert [line.split()[0] for line in out.splitlines()[1:] if line[0] != " "] == [
        "square",
        *sorted(embedded),
    ]
    _, out, _ = run(capsys, "bundle", "show", "square", "--json")
    assert json.loads(out)["training"] == {"seed": 7, "config": {"steps": 1000}}
    assert "neither a folder nor one of" in refusal(capsys, "bundle", "show", "circle")


def test_serve_turns_flags_into_settings(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    served: list[Settings] = []

    def serve(settings: Settings, announce: Any) -> None:
        served.append(settings)
        announce("http://host:1")

    monkeypatch.setattr(service.server, "serve", serve)
    monkeypatch.setenv("NEURALMUSIC_HOST", "::1")
    code, out, _ = run(capsys, "serve", "--port", "9000", "--max-upload-bytes", "4096")
    assert code == 0
    assert (served[0].port, served[0].max_upload_bytes, served[0].host) == (9000, 4096, "::1")
    assert out == f"neuralmusic {__version__} serves on http://host:1\n"
    assert "port must be" in refusal(capsys, "serve", "--port", "many")
    assert len(served) == 1


def test_every_setting_has_a_documented_flag(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["serve", "--help"])
    out = capsys.readouterr().out
    for name in Settings.model_fields:
        assert f"--{name.replace('_', '-')} " in out
        assert f"NEURALMUSIC_{name.upper()}" in out

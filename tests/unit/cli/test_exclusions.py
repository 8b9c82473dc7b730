"""``--exclude`` is read alike by every command: with commas, repeated, wrong."""

from __future__ import annotations

import json

import pytest
from command_line import refusal, run
from stream_command import ARRAY

FLAGS = ["--array", ARRAY, "--method", "norm_music"]


def heard(
    capsys: pytest.CaptureFixture[str], path: str, url: str, exclude: list[str]
) -> list[set[int]]:
    """Azimuths in whole degrees that ``localize`` and ``stream`` report of a talker at 60."""
    _, out, _ = run(capsys, "localize", path, *FLAGS, *exclude, "--json")
    windows = json.loads(out)["windows"]
    _, out, _ = run(capsys, "stream", path, *FLAGS, *exclude, "--url", url, "--output", "jsonl")
    results = [json.loads(line) for line in out.splitlines()]
    return [
        {round(source["azimuth_deg"]) for each in answers for source in each["sources"]}
        for answers in (windows, results)
    ]


@pytest.mark.parametrize(
    "exclude", [["--exclude=200:220,40:80"], ["--exclude=40:80", "--exclude", "200:220"]]
)
def test_sectors_come_with_commas_or_one_by_one(
    exclude: list[str], real_service: str, talk_wav: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for found in heard(capsys, talk_wav, real_service, ["--exclude=200:220"]):
        assert any(58 <= azimuth <= 62 for azimuth in found)
    for found in heard(capsys, talk_wav, real_service, exclude):
        assert not any(40 <= azimuth <= 80 for azimuth in found)


@pytest.mark.parametrize("wrong", ["front", "10:10", "80-100", "80:100,nowhere"])
def test_a_wrong_sector_is_the_same_sentence(
    wrong: str, real_service: str, talk_wav: str, capsys: pytest.CaptureFixture[str]
) -> None:
    said = {
        refusal(capsys, *command, "--exclude", wrong)
        for command in (
            ["localize", talk_wav, *FLAGS],
            ["stream", talk_wav, *FLAGS, "--url", real_service],
        )
    }
    assert len(said) == 1
    assert "exclude_deg must list sectors as from:to in degrees" in said.pop()

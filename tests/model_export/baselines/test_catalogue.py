"""The list of methods: complete, in order, with source and adaptation."""

from __future__ import annotations

import json

import pytest

from model_export.__main__ import main
from model_export.baselines.catalogue import ORDER, cards, network

pytestmark = pytest.mark.torch


def test_the_command_lists_every_method(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["methods", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [method["name"] for method in listed] == list(ORDER)
    assert len(listed) == 19
    for method in listed:
        assert method["kind"] in {"classical", "learned", "hybrid"}
        assert (method["parameters"] == 0) == (method["kind"] == "classical")
        assert method["source"]


def test_the_command_lists_them_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["methods"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(ORDER)
    assert "no parameters" in lines[0]


def test_only_root_music_needs_a_line() -> None:
    assert [name for name, card in cards().items() if card.linear_only] == ["root_music"]


def test_what_is_no_network_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match="no network is named 'music': crnn"):
        network("music", "cited")

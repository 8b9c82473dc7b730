"""schemathesis reads ``openapi.yaml`` and asks the running service what it says there."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from .served import ROOT, Served
from .sizes import EXAMPLES

pytestmark = [
    pytest.mark.fuzz,
    pytest.mark.skipif(find_spec("schemathesis") is None, reason="needs schemathesis"),
]

CONFIGURATION = Path(__file__).with_name("schemathesis.toml")
PROMPT_S = "10"
"""Seconds for an answer; other tests judge how long uploads take, one at a time"""
HANGING_S = 1800


@pytest.mark.parametrize("phases", ["examples,coverage,fuzzing", "stateful"])
def test_the_service_is_what_its_document_says(phases: str, served: Served, tmp_path: Path) -> None:
    program = "from schemathesis.cli import schemathesis; schemathesis()"
    examples = EXAMPLES if phases != "stateful" else max(EXAMPLES // 8, 2)
    options = {
        "--url": served.url,
        "--checks": "all",
        "--phases": phases,
        "--max-examples": str(examples),
        "--seed": "1",
        "--request-timeout": PROMPT_S,
    }
    done = subprocess.run(
        [
            *(sys.executable, "-c", program, "--config-file", str(CONFIGURATION)),
            *("run", str(ROOT / "openapi.yaml"), "--continue-on-failure", "--no-shrink"),
            *(part for option in options.items() for part in option),
        ],
        capture_output=True,
        text=True,
        check=False,
        timeout=HANGING_S,
        cwd=tmp_path,
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"

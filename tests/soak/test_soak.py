"""A minute of the soak: robots, churn and faults, judged by the script's own exit status."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.soak
def test_a_minute_of_soak(tmp_path: Path) -> None:
    command = [sys.executable, ROOT / "tests" / "bench" / "soak.py", "--minutes", "1"]
    ended = subprocess.run([*command, "--folder", tmp_path], capture_output=True, text=True)
    print(ended.stdout)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    soak = json.loads((tmp_path / "soak.json").read_text())
    assert soak["faults"]
    assert soak["results"] > 1000
    assert (tmp_path / "soak.png").exists()

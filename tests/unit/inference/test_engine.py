"""The runtime of the graphs does nothing but compute."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


SERVICE = """
from service.machine.environment import prepare_process
prepare_process()
from service.inference.registry import BundleRegistry
BundleRegistry.load()
"""
NOTEBOOK = """
from service import localize
localize("examples/two-talkers.flac", array="respeaker-usb-4mic-v2", num_sources=1)
"""


@pytest.mark.parametrize("program", [SERVICE, NOTEBOOK], ids=["service", "notebook"])
def test_loading_the_models_leaves_no_identifier_and_no_report_behind(
    program: str, tmp_path: Path
) -> None:
    """onnxruntime keeps what it reports to its maker in the home and the temporary folder."""
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith(("ORT_", "XDG_"))
    }
    places = {"HOME": str(tmp_path), "TMPDIR": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
    subprocess.run([sys.executable, "-c", program], check=True, cwd=ROOT, env=environment | places)
    assert list(tmp_path.rglob("*")) == []

"""What a newcomer does: start the service, post the sample as printed, read the directions."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
TALKERS_DEG = (45.0, 200.0)
"""Azimuths in examples/two-talkers.flac, from ``model_export.simulation.sample``"""


def printed_curl_line() -> str:
    """The line that ``make run`` prints, without running it."""
    recipe = subprocess.run(
        ["make", "--dry-run", "run"], capture_output=True, text=True, check=True, cwd=ROOT
    ).stdout
    (line,) = re.findall(r"curl -s .*?/localize", recipe)
    return str(line)


@pytest.mark.skipif(shutil.which("curl") is None, reason="needs curl")
def test_the_printed_line_gives_the_sample_s_directions(url: str) -> None:
    line = printed_curl_line()
    assert line in (ROOT / "README.md").read_text()
    line = re.sub(r"http://[^/]+", url, line)
    done = subprocess.run(shlex.split(line), capture_output=True, text=True, check=True, cwd=ROOT)
    answer = json.loads(done.stdout)
    assert answer["method"] == "neural"
    assert answer["model"]["name"] == "any-array"
    assert answer["warnings"] == []
    found = sorted(source["azimuth_deg"] for source in answer["summary"]["sources"])
    np.testing.assert_allclose(found, TALKERS_DEG, atol=4.0)
    reported = [s["azimuth_deg"] for w in answer["windows"] for s in w["sources"]]
    errors = np.abs((np.subtract.outer(reported, TALKERS_DEG) + 180) % 360 - 180).min(axis=1)
    assert np.mean(errors <= 15) >= 0.85

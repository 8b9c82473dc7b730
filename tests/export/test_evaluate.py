"""The evaluation runs every method on the same scenes and writes its tables and figures."""

from __future__ import annotations

import json
from pathlib import Path

from model_export.__main__ import main
from model_export.evaluate import CELLS
from model_export.results import PEER, TITLES
from service.inference.registry import EMBEDDED_MODELS


def test_tables_and_figures_are_written(corpus: Path, tmp_path: Path) -> None:
    readme = tmp_path / "README.md"
    readme.write_text("before <!-- results: begin --> old <!-- results: end --> after")
    out = tmp_path / "docs"
    command = ["evaluate", "--bundle", str(EMBEDDED_MODELS / "any-array")]
    command += ["--speech-commands", str(corpus), "--scenes", "1", "--out", str(out)]
    assert main([*command, "--figures", "1", "--readme", str(readme)]) == 0
    results = json.loads((out / "results.json").read_text())
    assert set(results["cells"]) == {cell.name for cell in CELLS}
    for scores in results["cells"].values():
        assert set(scores) == {"any-array", "norm_music", "music", "srp_phat", PEER}
        assert all(set(TITLES) <= set(values) for values in scores.values())
    assert sorted(path.name for path in out.glob("*.png")) == [
        "error-over-rt60.png",
        "error-over-separation.png",
        "error-over-snr.png",
        "reliability.png",
    ]
    text = readme.read_text()
    assert text.startswith("before <!-- results: begin -->\n")
    assert text.endswith("<!-- results: end --> after")
    assert " old " not in text

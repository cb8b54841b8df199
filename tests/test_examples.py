"""What the README shows works as it stands there."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm import load_experiment, run_experiment

ROOT = Path(__file__).parents[1]


def test_the_python_code_of_the_readme_runs_and_does_the_main_job(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.S)
    block = next(b for b in blocks if "run_experiment" in b)
    assert len(block.strip().splitlines()) <= 10
    monkeypatch.chdir(ROOT)
    exec(compile(block, "README.md", "exec"), {})
    detector, model = map(float, capsys.readouterr().out.splitlines()[0].split())
    assert model > detector + 0.1


def test_own_graph_and_evidence_files_run_without_touching_the_package() -> None:
    run = run_experiment(load_experiment(ROOT / "examples" / "own_files.yaml"))
    assert Path(str(run.model.graph.__file__)).name == "my_graph.py"
    assert run.model.parameters["recovery"] == 0.3
    np.testing.assert_allclose(run.beliefs.lane.sum(axis=1), 1, atol=1e-12)
    assert run.scores["model"]["accuracy"] > run.scores["detector"]["accuracy"]


def test_every_file_that_the_readme_links_to_exists() -> None:
    links = re.findall(r"\]\(([^)#]+)\)", (ROOT / "README.md").read_text())
    assert links
    missing = [link for link in links if "://" not in link and not (ROOT / link).exists()]
    assert not missing

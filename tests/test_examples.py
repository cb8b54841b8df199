"""What the README and the documentation show works as it stands there."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
import yaml

import egolane_pgm as ego
from egolane_pgm.command import egolane
from egolane_pgm.experiment import load_experiment
from egolane_pgm.graphs.cpds import quiet
from egolane_pgm.running import run_experiment
from tests.kits.drives import done, simulated

ROOT = Path(__file__).parents[1]
TUTORIAL = ROOT / "examples" / "tutorial_network.py"
MY_GRAPH = ROOT / "docs" / "howto" / "graph.md"
QUICKSTART = ROOT / "experiments" / "quickstart.yaml"


PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def blocks_of(language: str, page: Path) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(), flags=re.S)


@pytest.mark.filterwarnings("ignore:the network has no Line_ve")
def test_the_python_code_of_the_readme_and_of_the_page_on_graphs_runs_and_does_the_main_job(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    first, *others = [b for page in (PAGES[0], MY_GRAPH) for b in blocks_of("python", page)]
    assert len(first.split("\n\n")[1].strip().splitlines()) == 3, "four lines with the import"
    names: dict[str, Any] = {}
    exec(compile(first, "README.md", "exec"), names)
    scores, beliefs = names["run"].scores, names["beliefs"]
    assert scores["model"]["accuracy"] > scores["detector"]["accuracy"] + 0.1
    np.testing.assert_allclose(beliefs.filter(like="Lane=").sum(axis=1), 1, atol=1e-9)
    for block in others:
        if "\n        ...\n" not in block:
            exec(compile(block, "README.md", "exec"), names)
    assert "Lane@203(4)" in capsys.readouterr().out


def test_the_page_on_graphs_shows_a_part_of_the_graph_that_it_names() -> None:
    (shown,) = (block for block in blocks_of("python", MY_GRAPH) if "def build" in block)
    squeezed = "".join((ROOT / "examples" / "my_graph.py").read_text().split())
    for line in shown.splitlines():
        if line.startswith(("HIDDEN", "OBSERVED", "def ")) or "uniform(" in line:
            assert "".join(line.split()) in squeezed, line


def test_every_command_of_the_documentation_is_there_with_its_options() -> None:
    text = "\n".join(page.read_text() for page in PAGES).replace("\\\n", " ")
    found = re.findall(r"(?:^|`)egolane (\w+)([^`#\n]*)", text, flags=re.M)
    assert len(found) > 30
    for name, rest in found:
        command = egolane.get_command(click.Context(egolane), name)
        assert command is not None, name
        known = {option for parameter in command.params for option in parameter.opts}
        assert known.issuperset(re.findall(r"--[a-z][a-z-]*", rest)), (name, rest)


def test_own_graph_and_evidence_files_run_without_touching_the_package() -> None:
    run = run_experiment(load_experiment(ROOT / "examples" / "own_files.yaml"))
    assert Path(str(run.model.graph.__file__)).name == "my_graph.py"
    assert run.model.parameters["recovery"] == 0.3
    np.testing.assert_allclose(run.beliefs.lane.sum(axis=1), 1, atol=1e-12)
    assert run.scores["model"]["accuracy"] > run.scores["detector"]["accuracy"]


def test_a_network_in_pgmpys_own_style_is_compiled_filtered_and_learned() -> None:
    assert "egolane" not in TUTORIAL.read_text()
    with quiet():
        network = runpy.run_path(str(TUTORIAL))["network"]
    with pytest.warns(UserWarning, match="DetectorOutput_ve, WOR_ve: virtual-evidence nodes that"):
        compiled = ego.compile(network, observed=["DetectorOutput", "WOR"])
    assert compiled.hidden == ("Lane", "Sensor")
    run = ego.run(simulated(graph=str(TUTORIAL)))
    beliefs = ego.filter_beliefs(compiled, run.evidence, "assumed_density")
    np.testing.assert_array_equal(beliefs.lane, run.beliefs.lane)
    assert run.scores["model"]["accuracy"] > run.scores["detector"]["accuracy"]
    # pgmpy's own answer to the first frame, the tables multiplied by name.
    given = run.evidence.likelihoods
    with quiet():
        first = network.get_cpds(("DetectorOutput", 0))
        values = {tuple(name): k for k, name in enumerate(first.variables)}
        order = [values[name, 0] for name in ("Sensor", "Lane", "DetectorOutput")]
        wor = network.get_cpds(("WOR", 0)).values.T @ given["WOR"][0]
    seen = first.values.transpose(order) @ given["DetectorOutput"][0]
    right = (seen * wor[:, None]).sum(axis=0)
    lane = ego.filter_beliefs(compiled, run.evidence, "exact").lane[0]
    np.testing.assert_allclose(lane, right / right.sum(), atol=1e-12)
    fitted = ego.fit_tables(compiled, run.evidence, iterations=5)
    assert np.all(np.diff(fitted.log_posterior) > 0)


def test_a_network_in_pgmpys_own_style_goes_through_the_commands(tmp_path: Path) -> None:
    words = [QUICKSTART, "--set", "recording.frames=[0, 600]", "--set", "tuning.blocks=2"]
    own = ["--set", f"graph={TUTORIAL}", "--set", "parameters={}"]
    done("learn", *words, *own, "--out", tmp_path / "learned.yaml")
    learned = yaml.safe_load((tmp_path / "learned.graph.yaml").read_text())
    assert learned["hidden"] == ["Lane", "Sensor"]
    done("network", TUTORIAL, tmp_path / "network.bif")
    graphs = f"sensor_failure,{TUTORIAL},{tmp_path / 'network.bif'}"
    options = ["--set", "fit=learn", "--blocks", 2, "--json", tmp_path / "compared.json"]
    done("compare", *words, *options, "--graphs", graphs)
    compared = json.loads((tmp_path / "compared.json").read_text())["recordings"][0]["experiments"]
    names = [experiment["name"] for experiment in compared]
    assert names == ["sensor_failure", "tutorial_network", "network"]
    _, declared, from_file = compared
    assert declared["free_parameters"] == from_file["free_parameters"] == 38
    assert declared["scores"] == from_file["scores"]


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"])
def test_every_file_that_a_page_links_to_exists(name: str) -> None:
    links = re.findall(r"\]\(([^)#]+)\)", (ROOT / name).read_text())
    assert links
    missing = [link for link in links if "://" not in link and not (ROOT / link).exists()]
    assert not missing

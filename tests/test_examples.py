"""What the README and the documentation show works as it stands there."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import numpy as np
import pytest
import yaml

import egolane_pgm as ego
from egolane_pgm.graphs.cpds import quiet
from tests.kits.drives import done, simulated

ROOT = Path(__file__).parents[1]
TUTORIAL = ROOT / "examples" / "tutorial_network.py"
MY_GRAPH = ROOT / "docs" / "howto" / "graph.md"
QUICKSTART = ROOT / "experiments" / "quickstart.yaml"


def blocks_of(language: str, page: Path) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(), flags=re.S)


def test_the_page_on_graphs_shows_a_part_of_the_graph_that_it_names() -> None:
    (shown,) = (block for block in blocks_of("python", MY_GRAPH) if "def build" in block)
    squeezed = "".join((ROOT / "examples" / "my_graph.py").read_text().split())
    for line in shown.splitlines():
        if line.startswith(("HIDDEN", "OBSERVED", "def ")) or "uniform(" in line:
            assert "".join(line.split()) in squeezed, line


def test_a_network_in_pgmpys_own_style_is_compiled_and_filtered() -> None:
    assert "egolane" not in TUTORIAL.read_text()
    with quiet():
        network = runpy.run_path(str(TUTORIAL))["network"]
    compiled = ego.compile(network, observed=["DetectorOutput", "WOR"])
    assert compiled.hidden == ("Lane", "Sensor")
    run = ego.run(simulated(graph=str(TUTORIAL)))
    beliefs = ego.filter_beliefs(compiled, run.evidence, "assumed_density")
    np.testing.assert_array_equal(beliefs.lane, run.node("Lane"))
    assert run.scores["model"]["accuracy"] > run.scores["detector"]["accuracy"]


def test_a_network_in_pgmpys_own_style_goes_through_the_commands(tmp_path: Path) -> None:
    words = [QUICKSTART, "--set", "recording.frames=[0, 200]"]
    own = ["--set", f"graph={TUTORIAL}", "--set", "parameters={}", "--folds", 2]
    done("learn", *words, *own, "--out", tmp_path / "learned")
    learned = yaml.safe_load((tmp_path / "learned/best.graph.yaml").read_text())
    assert learned["hidden"] == ["Lane", "Sensor"]
    done("show", TUTORIAL, "--out", tmp_path / "network.bif")
    table = tmp_path / "graphs.csv"
    graphs = ["sensor_failure", TUTORIAL, "network.bif"]
    rows = [f"{k},{graph},{{}}" for k, graph in enumerate(graphs)]
    table.write_text("\n".join(["name,graph,parameters", *rows]) + "\n")
    options = [
        "--held-out",
        "--set",
        "fit.method=learn",
        "--set",
        "fit.folds=2",
        "--out",
        tmp_path / "runs",
    ]
    done("run", *words, "--table", table, *options)
    compared = ego.compare(tmp_path / "runs")
    assert list(compared.index) == ["0", "1", "2"]
    assert compared["accuracy"]["1"] == compared["accuracy"]["2"]


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"])
def test_every_file_that_a_page_links_to_exists(name: str) -> None:
    links = re.findall(r"\]\(([^)#]+)\)", (ROOT / name).read_text())
    assert links
    missing = [link for link in links if "://" not in link and not (ROOT / link).exists()]
    assert not missing

"""The commands `show` and `plot`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.loading import experiments_folder
from egolane_pgm.runs import open_input, run_input
from tests.kits.drives import done, refused

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_results_and_studies_are_drawn_and_several_results_share_a_sheet(tmp_path: Path) -> None:
    experiment = open_input("quickstart", overrides={"recording.frames": [0, 200]})
    for name in "ab":
        run_input(experiment).save(tmp_path / name)
    target = tmp_path / "figures"
    shown = done("plot", tmp_path / "a", tmp_path / "b", "--out", target)
    figures = {str(Path(line).relative_to(target)) for line in shown.stdout.split()}
    of_one = {f"{name}.png" for name in ("strips", "confusion", "reliability", "coverage")}
    assert figures == {"dispersion.png", *(f"{k}/{name}" for k in "ab" for name in of_one)}
    assert all((target / name).is_file() for name in figures)
    shown = done("plot", tmp_path / "a", "--frames", 50, 99, "--style", "svg")
    assert str(tmp_path / "a" / "figures" / "strips.svg") in shown.stdout.split()
    assert "the result has 0 to 199" in refused("plot", tmp_path / "a", "--frames", 900, 999)
    assert "empty range" in refused("plot", tmp_path / "a", "--frames", 2, 1)
    assert "shows one result" in refused("plot", tmp_path / "a", tmp_path / "b", "--out", "x.mp4")
    assert "is not a result directory" in refused("plot", tmp_path / "c")
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "study.json").write_text("{}")
    assert "is not the directory of a search" in refused("plot", tmp_path / "study")
    assert "--frames: " in refused("plot", tmp_path / "study", "--frames", 1, 2)


def test_without_a_name_it_lists_what_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(experiments_folder().parent)
    shown = done("show").stdout
    words = " ".join(shown.split())
    assert "wor_direct, wor_levels, wor_on_edge, wor_on_lane" in words
    assert "simulations: a2, a4, quickstart" in words
    assert "experiments/quickstart.yaml simulated drive of two minutes" in words
    assert len([line for line in shown.splitlines() if "paper/run" in line]) == 10
    assert "published" not in shown
    assert done("show", "simulations").stdout == "simulations:  a2, a4, quickstart\n"


@pytest.mark.parametrize("graph", ["wor_on_lane", str(EXAMPLES / "my_graph.py")])
def test_a_graph_is_drawn_by_name_or_file(tmp_path: Path, graph: str) -> None:
    target = tmp_path / "graph.svg"
    assert done("show", graph, "--out", target, "--n-lanes", "2").stdout == f"{target}\n"
    assert "SensorState" in target.read_text()


def test_a_graph_that_cannot_be_built_is_refused(tmp_path: Path) -> None:
    (tmp_path / "g.py").write_text("HIDDEN = OBSERVED = ()\ndef build(n, p):\n    return n.x\n")
    said = refused("show", tmp_path / "g.py", "--out", tmp_path / "g.svg")
    assert "g.py, line 3: AttributeError" in said
    said = refused("show", "no_wor", "--out", tmp_path / "g.txt")
    assert said.endswith("g.txt: unknown format; a network is written to .png, .svg, .pdf, .bif")
    assert "(did you mean 'no_wor'?)" in refused("show", "no_wro", "--out", tmp_path / "g.svg")
    own = tmp_path / "g.bif"
    own.write_text("")
    assert "g.bif: is read here" in refused("show", own, "--out", own)
    assert "only a graph" in refused("show", "ml", "--out", tmp_path / "g.png")


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("sensor_failure", "graph"),
        ("graph:lane_only", "graph"),
        ("counting", "evidence rule"),
        ("sl", "detector"),
        (str(EXAMPLES / "my_graph.py"), "graph"),
        (str(EXAMPLES / "sensor_failure.yaml"), "graph"),
        (str(EXAMPLES / "my_evidence.py"), "evidence rule"),
        (str(EXAMPLES / "my_detector.py"), "detector"),
    ],
)
def test_whatever_is_listed_or_one_writes_is_shown(name: str, kind: str) -> None:
    shown = done("show", name).stdout
    assert shown.splitlines()[0] == f"{kind} {name.removeprefix('graph:')}"
    assert "\nparameters" in shown


def test_an_experiment_is_shown_with_what_it_includes(drive: Path, tmp_path: Path) -> None:
    shown = done("show", "run01_italy_ml").stdout
    assert shown.startswith("experiment run01_italy_ml\n")
    assert "ground_truth:" in shown
    keys = json.loads(done("show", drive, "--json", "-").stdout)["keys"]
    assert keys["recording"]["path"].endswith("lines.csv")
    shown = done("show", experiments_folder() / "tuning" / "all_italy.yaml").stdout
    assert shown.startswith("tuning file all_italy\n")
    assert "(known: " in refused("show", "schema:x")


def test_a_graph_s_tables_are_printed_and_written(tmp_path: Path) -> None:
    target = tmp_path / "graph.json"
    assert "OK, 4" not in done("show", "sensor_failure", "--n-lanes", 4).stdout
    shown = done("show", "sensor_failure", "--n-lanes", 4, "--tables", "--json", target).stdout
    assert "OK, 4" in shown
    content = json.loads(target.read_text())
    assert (content["kind"], content["n_lanes"]) == ("graph", 4)
    assert np.shape(content["tables"][1]["values"]) == (4, 4)
    assert content["parameters"][0]["range"] == [0.0, 3.0]


def test_what_cannot_be_shown_is_refused_in_a_line(tmp_path: Path) -> None:
    assert refused("show", "sensor_failur").endswith("(did you mean 'sensor_failure'?)")
    assert "(known: aly, autoregressive, " in refused("show", "zzz")
    assert refused("show", "evidence:sensor_failure").startswith("evidence: unknown name")
    assert refused("show", "none.py").startswith("graph: no file ")
    both = tmp_path / "both.py"
    both.write_text("def build(n, p): ...\ndef evidence(log, n, p): ...\n")
    said = refused("show", both)
    assert said == f"{both} is of several kinds; write graph:{both} or evidence:{both}"
    assert "does not define" in refused("show", f"detector:{both}")
    (tmp_path / "none").write_text("")
    target = tmp_path / "none" / "x.json"
    assert "cannot be written" in refused("show", "lane_only", "--json", target)
    said = refused("show", EXAMPLES / "my_graph.py", "--json", EXAMPLES / "my_graph.py")
    assert said.endswith("is read here; name another file")

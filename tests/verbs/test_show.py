"""The commands `show`, `plot` and `run --dry-run`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.experiment import experiments_folder
from egolane_pgm.paper import paper_experiment
from tests.kits.drives import (
    done,
    refused,
    run_json,
    write_drive,
)

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_several_results_make_one_sheet(drive: Path, tmp_path: Path) -> None:
    run_json(drive, tmp_path / "a")
    run_json(drive, tmp_path / "b", "--set", "parameters.bonus_value=0", "--set", "name=b")
    (tmp_path / "b" / "out").rename(tmp_path / "b" / "none")
    shown = done("plot", tmp_path / "a/out", tmp_path / "b/none", "--out", tmp_path / "figures")
    figures = {str(Path(line).relative_to(tmp_path / "figures")) for line in shown.stdout.split()}
    assert {"dispersion.png", "bonus_ablation.png", "out/strips.png", "none/strips.png"} <= figures
    assert all((tmp_path / "figures" / name).is_file() for name in figures)


def test_a_dry_run_checks_every_experiment_of_the_paper(recordings: Path) -> None:
    paths = [paper_experiment(number) for number in range(1, 11)]
    lines = done("run", "--dry-run", *paths).stdout.splitlines()
    assert [line.partition(":")[0] for line in lines] == [str(path) for path in paths]
    assert lines[0].endswith("ok (4 lanes, 8 joint states)")
    assert lines[9].endswith("ok (3 lanes, 6 joint states)")


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
    assert said.endswith(
        "g.txt: a network is written to a file that ends in .png, .svg, .pdf, .dot, .bif"
    )
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
    assert keys["recording"]["path"] == "lines.csv"
    shown = done("show", experiments_folder() / "tuning" / "all_italy.yaml").stdout
    assert shown.startswith("tuning file all_italy\n")
    assert "(known: " in refused("show", "schema:x")


def test_a_graph_s_tables_are_printed_and_written(tmp_path: Path) -> None:
    target = tmp_path / "graph.json"
    assert "OK, 4" not in done("show", "sensor_failure", "--n-lanes", 4).stdout
    shown = done("show", "sensor_failure", "--n-lanes", 4, "--tables", "--json", target).stdout
    assert "OK, 4" in shown
    content = json.loads(target.read_text())
    assert (content["schema_version"], content["kind"], content["n_lanes"]) == (1, "graph", 4)
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


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: b: c\n", "is not YAML"),
        ("- 1\n", "needs keys and values"),
        ("recording: {simulate: a4}\nn_lanes: 3\n", "name: is missing"),
    ],
)
def test_a_file_that_is_no_experiment_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "e.yaml").write_text(text)
    assert refused("run", "--dry-run", tmp_path / "e.yaml").startswith(
        f"{tmp_path / 'e.yaml'}: {said}"
    )


@pytest.mark.parametrize("override", ["n_lanes", "=3", "a..b=1", "parameters.p1=[", "n_lanes.x=1"])
def test_an_override_that_is_none_is_refused(tmp_path: Path, override: str) -> None:
    experiment = write_drive(tmp_path, 20)
    assert refused("run", "--dry-run", experiment, "--set", override).startswith(
        f"--set: {override}: "
    )

"""The commands `show`, `data list` and `run --dry-run`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.loading import experiments_folder
from egolane_pgm.paper import paper_experiment
from egolane_pgm.recordings import catalog
from tests.kits.drives import done, refused

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_a_dry_run_checks_every_experiment_of_the_paper(recordings: Path) -> None:
    for number in range(1, 11):
        path = paper_experiment(number)
        n_lanes = 3 if number >= 6 else 4
        expected = f"{path}: ok ({n_lanes} lanes, {2 * n_lanes} joint states)\n"
        assert done("run", "--dry-run", path).stdout == expected


def test_without_a_name_it_lists_all_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(experiments_folder().parent)
    shown = done("show").stdout
    words = " ".join(shown.split())
    assert "sensor_failure, wor_on_lane" in words
    assert "simulations: a2, a4, quickstart" in words
    assert "experiments/quickstart.yaml simulated drive of two minutes" in words
    assert len([line for line in shown.splitlines() if "paper/run" in line]) == 10
    assert "published" not in shown
    assert done("show", "simulations").stdout == "simulations:  a2, a4, quickstart\n"


@pytest.mark.parametrize("graph", ["wor_on_lane", str(EXAMPLES / "my_graph.py")])
def test_a_graph_is_drawn_by_name_or_file(tmp_path: Path, graph: str) -> None:
    target = tmp_path / "graph.svg"
    assert done("show", graph, "--out", target, "--n-lanes", "2").stdout == f"{target}\n"
    assert "frame t + 1" in target.read_text()
    assert done("show", graph, "--out", target, "--numbers").stdout == f"{target}\n"
    assert "P(WOR given " in target.read_text()
    done("show", graph, "--out", tmp_path / "graph.bif", "--numbers")
    assert "variable SensorState_0" in (tmp_path / "graph.bif").read_text()


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


def test_a_graph_s_tables_are_printed_and_written(tmp_path: Path) -> None:
    target = tmp_path / "graph.json"
    assert "OK, 4" not in done("show", "sensor_failure", "--n-lanes", 4).stdout
    shown = done("show", "sensor_failure", "--n-lanes", 4, "--numbers", "--json", target).stdout
    assert "OK, 4" in shown
    content = json.loads(target.read_text())
    assert (content["kind"], content["n_lanes"]) == ("graph", 4)
    assert np.shape(content["tables"][1]["values"]) == (4, 4)
    assert content["parameters"][0]["range"] == [0.0, 3.0]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("sensor_failur", "(did you mean 'sensor_failure'?)"),
        ("zzz", "(known: aly, autoregressive, "),
        ("evidence:sensor_failure", "evidence: unknown name"),
        ("none.py", "graph: no file "),
        ("detector:{0}/both.py", "does not define"),
        ("lane_only --n-lanes 51", "'--n-lanes': 51 is not in the range"),
        ("lane_only --json {0}/both.py/x.json", "cannot be written"),
        ("{0}/both.py --json {0}/both.py", "is read here; name another file"),
        ("{0}/g.py --out {0}/g.svg", "g.py, line 3: AttributeError"),
        ("no_wor --out {0}/g.txt", "g.txt: unknown format; a figure ends in .png, .svg, "),
        ("{0}/own.bif --out {0}/own.bif", "own.bif: is read here"),
        ("ml --out {0}/g.png", "only a graph"),
        ("{0}/x.yaml", "x.yaml: has no nodes and no tables, so it is not a graph; an experiment"),
    ],
)
def test_a_name_that_cannot_be_shown_is_refused_in_a_line(
    tmp_path: Path, words: str, message: str
) -> None:
    (tmp_path / "both.py").write_text("def build(n, p): ...\ndef evidence(log, n, p): ...\n")
    (tmp_path / "g.py").write_text("HIDDEN = OBSERVED = ()\ndef build(n, p):\n    return n.x\n")
    (tmp_path / "own.bif").touch()
    (tmp_path / "x.yaml").write_text("include: quickstart.yaml\n")
    assert message.format(tmp_path) in refused("show", *words.format(tmp_path).split())


def test_data_list_shows_the_files_where_a_run_would_find_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("EGOLANE_DATA", str(tmp_path / "data"))
    (tmp_path / "data" / "rle").mkdir(parents=True)
    (tmp_path / "data" / "rle" / "ISIS_01.txt").write_text("1;1;0\n")
    lines = done("data", "list").stdout.splitlines()
    assert lines[0] == f"looked in: {tmp_path / 'data'}"
    assert lines[1] == f"looked in: {catalog.data_folders()[-1]}"
    assert len(lines) == 2 + 12
    state = {line.rpartition("/")[2]: line.split()[0] for line in lines[2:]}
    assert state.pop("ISIS_01.txt") == "bad"
    assert set(state.values()) == {"missing"}

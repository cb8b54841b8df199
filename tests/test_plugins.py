"""Graphs, evidence rules and formats by name, and files of a user's own."""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np
import pytest
from egolane_pgm.results import read_result

from egolane_pgm.experiment import load_experiment
from egolane_pgm.graphs.cpds import quiet
from egolane_pgm.graphs.from_pgmpy import read_file
from egolane_pgm.model import prepare_model
from egolane_pgm.plugins import load_plugin, plugin_names
from tests.kits.drives import done, refused, short_drive, write_drive

with quiet():
    from pgmpy.readwrite import XMLBIFWriter

EXAMPLES = Path(__file__).parents[1] / "examples"

#: The least that a graph and a rule have to say.
GRAPH = """
    import numpy as np
    from egolane_pgm.graphs.cpds import declare, dynamics, previous, prior, uniform, within
    HIDDEN = ("Lane",)
    OBSERVED = ("Seen",)
    def build(n_lanes, parameters):
        stay = 0.9 * np.eye(n_lanes) + 0.1 / n_lanes
        tables = [
            *prior("Lane", uniform(n_lanes)),
            *dynamics("Lane", [previous("Lane")], stay),
            *within("Seen", ["Lane"], np.eye(n_lanes)),
        ]
        return declare(tables, OBSERVED)
"""
RULE = """
    import numpy as np
    from egolane_pgm.types import Evidence
    def evidence(log, n_lanes, parameters):
        seen = np.ones((len(log), n_lanes))
        seen[:, 0] += log.is_valid.sum(axis=1)
        return Evidence({"Seen": seen})
"""
#: The same graph in pgmpy alone.
PLAIN = """
    from pgmpy.factors.discrete import TabularCPD
    from pgmpy.models import DynamicBayesianNetwork

    network = DynamicBayesianNetwork([(("Lane", 0), ("Lane", 1)), (("Lane", 0), ("Seen", 0))])
    stay = [[0.9 * (i == j) + 0.1 / 3 for i in range(3)] for j in range(3)]
    same = [[float(i == j) for i in range(3)] for j in range(3)]
    network.add_cpds(
        TabularCPD(("Lane", 0), 3, [[1 / 3]] * 3),
        TabularCPD(("Lane", 1), 3, stay, [("Lane", 0)], [3]),
        TabularCPD(("Seen", 0), 3, same, [("Lane", 0)], [3]),
    )
"""
READER = """
    import shutil
    from egolane_pgm.recordings.table import read_table
    def read(path, *, frame_rate):
        return read_table(shutil.copy(path, path.with_suffix(".csv")), frame_rate=frame_rate)
"""
GIVES_SEEN = 'PROVIDES = ("Seen", "Other")\n'


def write(path: Path, text: str) -> Path:
    path.write_text(textwrap.dedent(text))
    return path


def test_plugins_are_the_files_of_their_folder() -> None:
    some = {"lane_only", "no_wor", "sensor_failure", "wor_on_lane", "wor_levels"}
    assert some <= set(plugin_names("graphs"))
    assert {"counting", "counting_levels"} <= set(plugin_names("evidence"))
    assert not [n for f in ("graphs", "evidence") for n in plugin_names(f) if n.startswith("_")]
    listed = done("show").stdout
    for name in (*plugin_names("graphs"), *plugin_names("evidence")):
        assert name in listed
    assert "run01_italy_ml.yaml" in listed


def test_files_of_ones_own_run_without_parameters_or_promises(tmp_path: Path) -> None:
    write(tmp_path / "g.py", GRAPH)
    write(tmp_path / "r.py", RULE)
    experiment = write_drive(tmp_path, graph="./g.py", evidence="r.py")
    shown = done("run", "--dry-run", experiment).stdout
    assert "ok (3 lanes, 3 joint states)" in shown
    ran = done("run", experiment, "--no-figures", "--out", tmp_path / "out")
    assert "graph ./g.py" in ran.stdout
    result = read_result(tmp_path / "out")
    assert result.tentative is None
    assert set(result.scores) & {"detector", "model"} == {"model"}
    belief = np.full(3, 1 / 3)
    stay = 0.9 * np.eye(3) + 0.1 / 3
    for t, n_valid in enumerate(short_drive().log.is_valid.sum(axis=1)):
        belief = (belief @ stay if t else belief) * [1 + n_valid, 1, 1]
        belief /= belief.sum()
        np.testing.assert_allclose(result.marginals["Lane"][t], belief, rtol=0, atol=1e-12)


def test_a_result_of_files_of_ones_own_runs_again_where_they_are_gone(tmp_path: Path) -> None:
    graph, rule = write(tmp_path / "g.py", GRAPH), write(tmp_path / "r.py", RULE)
    experiment = write_drive(tmp_path, graph="./g.py", evidence="./r.py")
    done("run", experiment, "--no-figures", "--out", tmp_path / "out")
    graph.unlink()
    rule.unlink()
    again = tmp_path / "out" / "experiment.yaml"
    done("run", again, "--no-figures", "--out", tmp_path / "again")
    one, other = read_result(tmp_path / "out"), read_result(tmp_path / "again")
    np.testing.assert_array_equal(one.marginals["Lane"], other.marginals["Lane"])


def test_parameters_of_files_of_ones_own_are_checked_as_any_other(tmp_path: Path) -> None:
    parameters = """
    from egolane_pgm.parameters import Parameter
    PARAMETERS = (Parameter("trust", "probability", 0.5, "how much a line counts"),)
    """
    write(tmp_path / "g.py", GRAPH)
    write(tmp_path / "r.py", parameters + RULE.replace("+= log", "+= parameters['trust'] * log"))
    experiment = write_drive(tmp_path, graph="./g.py", evidence="./r.py")
    assert "ok" in done("run", "--dry-run", experiment, "--set", "parameters.trust=1").stdout
    said = refused("run", "--dry-run", experiment, "--set", "parameters.trust=2")
    assert said.endswith("parameters.trust: 2 is not a probability (0 to 1)")
    said = refused("run", "--dry-run", experiment, "--set", "parameters.trst=1")
    assert said.endswith("unknown key 'trst' (did you mean 'trust'?)")
    said = refused("run", "--dry-run", experiment, "--set", "parameters.sigma1=1")
    assert said.endswith(
        "unknown key 'sigma1' (known: trust); `parameters: {}` drops all of another graph"
    )
    empty = {"graph": "sensor_failure", "evidence": "counting", "parameters": {}}
    other = load_experiment(write_drive(tmp_path, parameters={"trust": 1}), empty)
    assert prepare_model(other).parameters["sigma1"] == 0.4


@pytest.mark.parametrize(
    ("graph", "said"),
    [
        ("x = (", "g.py cannot be imported: SyntaxError"),
        ("HIDDEN = OBSERVED = ()", "g.py does not define build, nor a pgmpy network at its top"),
        (PLAIN + "    b = network.copy()", "and has 2 pgmpy networks (network, b) at its top"),
        (PLAIN, "the graph does not say what it observes (OBSERVED), nor the evidence rule what"),
        (GRAPH.replace("return declare", "declare"), "build() gave NoneType, not a pgmpy network"),
        (GRAPH.replace("stay = ", "stay = 1 / 0 + "), "g.py, line 7: ZeroDivisionError"),
        (GRAPH.replace("0.9 *", "0.8 *"), "the rows of the table must sum to one"),
        (GRAPH.replace('"Lane"', '"Line"'), "needs a hidden node Lane with 3 values, has none"),
        (GRAPH + "    PARAMETERS = ('x',)", "PARAMETERS has 'x', which is no Parameter"),
    ],
)  # fmt: skip
def test_a_graph_file_with_a_fault_is_refused_by_its_name_and_line(
    tmp_path: Path, graph: str, said: str
) -> None:
    write(tmp_path / "g.py", graph)
    write(tmp_path / "r.py", RULE)
    experiment = write_drive(tmp_path, 20, graph="./g.py", evidence="./r.py")
    assert said in refused("run", "--dry-run", experiment)


def test_plain_pgmpy_is_a_graph_whose_roles_follow_from_the_evidence_rule(tmp_path: Path) -> None:
    write(tmp_path / "r.py", GIVES_SEEN + textwrap.dedent(RULE))
    said_so = GRAPH.replace("OBSERVED = (", 'UNUSED, OBSERVED = ("Other",), (')
    silent = GRAPH.replace("OBSERVED)", "())").replace("    OBSERVED", "    # OBSERVED")
    for name, text in (("own", said_so), ("plain", PLAIN), ("silent", silent)):
        write(tmp_path / f"{name}.py", text)
    done("show", tmp_path / "plain.py", "--out", tmp_path / "g.bif")
    with quiet():
        XMLBIFWriter(read_file(tmp_path / "g.bif")).write(tmp_path / "g.xml")
    beliefs = []
    for graph in ("own.py", "plain.py", "silent.py", "g.bif", "g.xml"):
        experiment = write_drive(tmp_path, graph=graph, evidence="./r.py")
        done("run", experiment, "--no-figures", "--out", tmp_path / "out" / graph)
        result = read_result(tmp_path / "out" / graph)
        assert list(result.marginals) == ["Lane"]
        beliefs.append(result.marginals["Lane"])
    for other in beliefs[1:]:
        np.testing.assert_allclose(other, beliefs[0], rtol=0, atol=1e-12)
    # A copy of the network is beside the result, which runs again from there.
    again = tmp_path / "out" / "g.bif" / "experiment.yaml"
    done("run", again, "--no-figures", "--out", tmp_path / "again")
    np.testing.assert_array_equal(read_result(tmp_path / "again").marginals["Lane"], beliefs[3])


def test_a_bif_file_with_a_fault_is_refused_by_its_name(tmp_path: Path) -> None:
    (tmp_path / "g.bif").write_text("{'a': 1}")
    said = "g.bif: has no variable; is it a BIF file?"
    assert said in refused("run", "--dry-run", write_drive(tmp_path, 20, graph="./g.bif"))
    assert said in refused("show", tmp_path / "g.bif", "--out", tmp_path / "g.dot")


def test_a_file_that_an_override_names_is_found_from_where_one_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    write(tmp_path / "here" / "g.py", GRAPH)
    write(tmp_path / "r.py", RULE)
    experiment = write_drive(tmp_path, 20)
    words = ["--set", "graph=./g.py", "--set", "evidence=r.py", "--set", "recording.path=lines.csv"]
    monkeypatch.chdir(tmp_path / "here")
    assert "ok" in done("run", "--dry-run", experiment, *words).stdout
    # A folder that is called as a plugin of the package is none.
    (tmp_path / "here" / "no_wor").mkdir()
    assert "ok" in done("run", "--dry-run", experiment, "--set", "graph=no_wor").stdout
    monkeypatch.chdir(tmp_path)
    assert "graph: no file" in refused("run", "--dry-run", experiment, *words)
    monkeypatch.chdir(tmp_path / "here")
    said = refused("run", "--dry-run", experiment, "--set", "graph=nope.py")
    assert said.endswith(f"graph: no file {tmp_path / 'nope.py'}, nor {tmp_path / 'here/nope.py'}")


@pytest.mark.parametrize(
    ("rule", "said"),
    [
        (RULE.replace("return Evidence(", "return dict("), "gave dict, not Evidence"),
        (RULE.replace("return", "seen = seen[1:]; return"), "gave 19 frames for the 20 recorded"),
        (RULE.replace("seen[:, 0]", "seen[:, 7]"), "r.py, line 6: IndexError"),
        (RULE.replace('"Seen"', '"Sen"'), "observed node Seen: the evidence has nothing for it"),
        (RULE.replace("return", "seen[3] = -1; return"), "frame 3 has a negative or NaN value"),
        ('PROVIDES = ("Sen",)\n' + textwrap.dedent(RULE), "the graph observes Seen, the evidence"),
    ],
)  # fmt: skip
def test_a_rule_file_with_a_fault_is_refused_by_its_name(
    tmp_path: Path, rule: str, said: str
) -> None:
    write(tmp_path / "g.py", GRAPH)
    write(tmp_path / "r.py", rule)
    experiment = write_drive(tmp_path, 20, graph="./g.py", evidence="./r.py")
    assert said in refused("run", experiment, "--no-figures", "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_rule_that_gives_more_than_the_graph_observes_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "g.py", GRAPH.replace("Seen", "DetectorOutput"))
    experiment = write_drive(tmp_path, 20, graph="./g.py")
    said = refused("run", "--dry-run", experiment)
    assert "the evidence rule gives WOR, which the graph does not observe" in said
    assert "UNUSED" in said
    text = GRAPH.replace("Seen", "DetectorOutput") + '    UNUSED = ("WOR",)\n'
    write(tmp_path / "g.py", text)
    assert "ok" in done("run", "--dry-run", experiment).stdout


def test_a_format_of_ones_own_reads_a_recording(tmp_path: Path) -> None:
    write(tmp_path / "f.py", READER)
    experiment = write_drive(
        tmp_path, 20, recording={"path": "lines.dat", "format": "./f.py", "frame_rate": 20}
    )
    (tmp_path / "lines.csv").rename(tmp_path / "lines.dat")
    done("run", experiment, "--no-figures", "--out", tmp_path / "out")
    result = read_result(tmp_path / "out")
    np.testing.assert_array_equal(result.time_s, short_drive(20).log.frame_id / 20)
    assert Path(result.config["recording"]["format"]) == tmp_path / "f.py"
    write(tmp_path / "f.py", "def read(path, **options):\n    return path.nothing\n")
    said = refused("run", experiment, "--no-figures", "--out", tmp_path / "out")
    assert "recording.format: " in said
    assert "f.py, line 2: AttributeError" in said


def test_plugins_of_an_installed_package_are_found_by_their_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    others, info = tmp_path / "site" / "others", tmp_path / "site" / "others-1.0.dist-info"
    for folder in (others, info):
        folder.mkdir(parents=True)
    for name in ("my_graph", "my_evidence", "my_detector"):
        (others / f"{name}.py").write_bytes((EXAMPLES / f"{name}.py").read_bytes())
    write(others / "reader.py", READER)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: others\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[egolane_pgm.graphs]\nby_lane = others.my_graph\n"
        "[egolane_pgm.evidence]\ntempered = others.my_evidence\n"
        "[egolane_pgm.recordings]\ndat = others.reader\n"
        "[egolane_pgm.detectors]\nstrips = others.my_detector\nbroken = others.nothing\n"
    )
    own = {"graph": str(EXAMPLES / "my_graph.py"), "evidence": str(EXAMPLES / "my_evidence.py")}
    done("run", write_drive(tmp_path / "own", 20, **own), "--no-figures", "--out", tmp_path / "a")
    offered = {"graph": "by_lane", "evidence": "tempered"}
    recording = {"path": "lines.dat", "format": "dat"}
    experiment = write_drive(tmp_path / "offered", 20, **offered, recording=recording)
    (tmp_path / "offered" / "lines.csv").rename(tmp_path / "offered" / "lines.dat")
    assert "unknown name 'tempered'" in refused("run", experiment, "--out", tmp_path / "b")

    monkeypatch.syspath_prepend(tmp_path / "site")
    listed = done("show").stdout
    assert all(name in listed for name in ("by_lane", "tempered", "dat", "strips"))
    assert "contrast" in done("show", "strips").stdout
    done("run", experiment, "--no-figures", "--out", tmp_path / "b")
    # What the result holds runs again, too.
    done("run", tmp_path / "b" / "experiment.yaml", "--no-figures", "--out", tmp_path / "c")
    one, *others_ = (read_result(tmp_path / name).marginals["Lane"] for name in "abc")
    for other in others_:
        np.testing.assert_array_equal(one, other)
    said = refused("show", "broken")
    assert "others.nothing cannot be imported: ModuleNotFoundError" in said


def test_two_files_of_the_same_name_are_two_modules(tmp_path: Path) -> None:
    for folder, value in (("a", 1), ("b", 2)):
        (tmp_path / folder).mkdir()
        write(tmp_path / folder / "g.py", f"build = HIDDEN = OBSERVED = {value}")
    one = load_plugin("graphs", "g.py", tmp_path / "a", "x")
    other = load_plugin("graphs", "g.py", tmp_path / "b", "x")
    assert (one.build, other.build) == (1, 2)
    assert load_plugin("graphs", "./g.py", tmp_path / "a", "x") is one
    write(tmp_path / "a" / "g.py", "build = HIDDEN = OBSERVED = 3")
    assert load_plugin("graphs", "g.py", tmp_path / "a", "x").build == 3  # changed since
    assert not (tmp_path / "a" / "__pycache__").exists()


def test_a_defect_of_the_package_is_not_taken_for_a_users_mistake(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = write_drive(tmp_path, 20)
    monkeypatch.setattr("egolane_pgm.evidence.counting.evidence", lambda *a, **k: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        done("run", experiment, "--no-figures", "--out", tmp_path / "out")

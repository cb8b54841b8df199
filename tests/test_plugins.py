"""Graphs, evidence rules and formats by name, and files of a user's own."""

from __future__ import annotations

import re
import textwrap
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.contracts import Graph, Rule
from egolane_pgm.graphs.cpds import declare, quiet
from egolane_pgm.graphs.from_pgmpy import read_file
from egolane_pgm.loading import load_experiment
from egolane_pgm.model import compile_model
from egolane_pgm.plugins import load_plugin, plugin_names
from egolane_pgm.types import InputError
from tests.kits.drives import done, run, short_drive, write_drive

with quiet():
    from pgmpy.readwrite import BIFWriter, XMLBIFWriter

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
    some = {"lane_only", "no_wor", "sensor_failure", "wor_on_lane"}
    assert some <= set(plugin_names(Graph))
    assert {"counting", "line_geometry"} <= set(plugin_names(Rule))
    assert not [n for kind in (Graph, Rule) for n in plugin_names(kind) if n.startswith("_")]
    listed = done("show").stdout
    for name in (*plugin_names(Graph), *plugin_names(Rule)):
        assert name in listed
    assert "run01_italy_ml.yaml" in listed


def test_files_of_ones_own_run_without_parameters_or_promises(tmp_path: Path) -> None:
    write(tmp_path / "g.py", GRAPH)
    write(tmp_path / "r.py", RULE)
    experiment = write_drive(tmp_path, graph="./g.py", evidence="r.py")
    result = run(experiment)
    assert "detector_lane" not in result.frames
    assert set(result.scores) & {"detector", "model"} == {"model"}
    belief = np.full(3, 1 / 3)
    stay = 0.9 * np.eye(3) + 0.1 / 3
    for t, n_valid in enumerate(short_drive().log.is_valid.sum(axis=1)):
        belief = (belief @ stay if t else belief) * [1 + n_valid, 1, 1]
        belief /= belief.sum()
        np.testing.assert_allclose(result.node("Lane")[t], belief, rtol=0, atol=1e-12)


def test_parameters_of_files_of_ones_own_are_checked_as_any_other(tmp_path: Path) -> None:
    parameters = """
    from egolane_pgm.parameters import Parameter
    PARAMETERS = (Parameter("trust", "probability", 0.5, "how much a line counts"),)
    """
    write(tmp_path / "g.py", GRAPH)
    write(tmp_path / "r.py", parameters + RULE.replace("+= log", "+= parameters['trust'] * log"))
    experiment = write_drive(tmp_path, graph="./g.py", evidence="./r.py")
    trusting = compile_model(load_experiment(experiment, {"parameters.trust": 1}))
    assert trusting.parameters["trust"] == 1
    for name, value, said in (
        ("trust", 2, "parameters.trust: 2 is not a probability (0 to 1)"),
        ("trst", 1, "unknown key 'trst' (did you mean 'trust'?)"),
        ("sigma1", 1, "unknown key 'sigma1' (known: trust); `parameters: {}` drops all of another"),
    ):
        with pytest.raises(InputError, match=re.escape(said)):
            compile_model(load_experiment(experiment, {f"parameters.{name}": value}))
    empty = {"graph": "sensor_failure", "evidence": "counting", "parameters": {}}
    other = load_experiment(write_drive(tmp_path, parameters={"trust": 1}), empty)
    assert compile_model(other).parameters["sigma1"] == 0.4


@pytest.mark.parametrize(
    ("graph", "said"),
    [
        ("x = (", "g.py: SyntaxError"),
        ("HIDDEN = OBSERVED = ()", "g.py defines neither tables nor build, nor a pgmpy network"),
        (PLAIN + "    b = network.copy()", "and has 2 pgmpy networks (network, b) at its top"),
        (PLAIN, "the evidence rule gives nothing (it has no PROVIDES), the graph has"),
        (GRAPH.replace("return declare", "declare"), "build() returned NoneType, not"),
        (GRAPH.replace("stay = ", "stay = 1 / 0 + "), "g.py, line 7: ZeroDivisionError"),
        (GRAPH.replace("0.9 *", "0.8 *"), "the rows of the table must sum to one"),
        (GRAPH.replace('"Lane"', '"Line"'), "needs a hidden node Lane with 3 values, has none"),
        (GRAPH + "    PARAMETERS = ('x',)", "g.py: PARAMETERS: needs tuple[Parameter, ...], got"),
        (GRAPH + "    UNSUED = ('x',)", "g.py: unknown name UNSUED (did you mean 'UNUSED'?)"),
        (GRAPH.replace("HIDDEN", "HIDEN"), "g.py: unknown name HIDEN (did you mean 'HIDDEN'?)"),
        (GRAPH.replace('("Lane",)', '"Lane"', 1), "g.py: HIDDEN: needs tuple[str, ...] | None"),
        (GRAPH.replace("(n_lanes, parameters)", "(n_lanes)"), "g.py: build: needs a function of ("),
        (GRAPH + "    tables = 3", "g.py: tables: needs a function of (n_lanes, parameters)"),
    ],
)  # fmt: skip
def test_a_graph_file_with_a_fault_is_refused_by_its_name_and_line(
    tmp_path: Path, graph: str, said: str
) -> None:
    write(tmp_path / "g.py", graph)
    write(tmp_path / "r.py", RULE)
    experiment = load_experiment(write_drive(tmp_path, 20, graph="./g.py", evidence="./r.py"))
    with pytest.raises(InputError, match=re.escape(said)):
        compile_model(experiment)


def test_plain_pgmpy_is_a_graph_whose_roles_follow_from_the_evidence_rule(tmp_path: Path) -> None:
    write(tmp_path / "r.py", GIVES_SEEN + textwrap.dedent(RULE))
    said_so = GRAPH.replace("OBSERVED = (", 'UNUSED, OBSERVED = ("Other",), (')
    silent = GRAPH.replace("OBSERVED)", "())").replace("    OBSERVED", "    # OBSERVED")
    for name, text in (("own", said_so), ("plain", PLAIN), ("silent", silent)):
        write(tmp_path / f"{name}.py", text)
    own = write_drive(tmp_path, graph="own.py", evidence="./r.py")
    compiled = compile_model(load_experiment(own)).compiled
    with quiet():
        network = declare(compiled.tables.values(), (), compiled.values)
        BIFWriter(network.get_constant_bn()).write(tmp_path / "g.bif")
        XMLBIFWriter(read_file(tmp_path / "g.bif")).write(tmp_path / "g.xml")
    beliefs = []
    for graph in ("own.py", "plain.py", "silent.py", "g.bif", "g.xml"):
        result = run(write_drive(tmp_path, graph=graph, evidence="./r.py"))
        if graph == "g.bif":
            result.save(tmp_path / "out")
        assert list(result.run["values"]) == ["Lane"]
        beliefs.append(result.node("Lane"))
    for other in beliefs[1:]:
        np.testing.assert_allclose(other, beliefs[0], rtol=0, atol=1e-12)
    # A copy of the network is beside the result, which runs again from there.
    again = run(tmp_path / "out" / "experiment.yaml")
    np.testing.assert_array_equal(again.node("Lane"), beliefs[3])


def test_a_folder_that_is_called_as_a_plugin_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "no_wor").mkdir()
    monkeypatch.chdir(tmp_path)
    experiment = load_experiment(write_drive(tmp_path / "e", 20), {"graph": "no_wor"})
    assert compile_model(experiment).graph.is_ours
    with pytest.raises(InputError, match=f"graph: no file {tmp_path / 'nope.py'}"):
        compile_model(load_experiment(experiment, {"graph": "nope.py"}))


@pytest.mark.parametrize(
    ("rule", "said"),
    [
        (RULE.replace("return Evidence(", "return dict("), "evidence() returned dict, not"),
        (RULE.replace("return", "seen = seen[1:]; return"), "evidence() returned 19 frames for 20"),
        (RULE.replace("seen[:, 0]", "seen[:, 7]"), "r.py, line 6: IndexError"),
        (RULE.replace('"Seen"', '"Sen"'), "observed node Seen: the evidence has nothing for it"),
        (RULE.replace("return", "seen[3] = -1; return"), "frame 3 has a negative or NaN value"),
        ('PROVIDES = ("Sen",)\n' + textwrap.dedent(RULE), "observes Seen, the evidence rule gives"),
        ('PROVIDE = ("Seen",)\n' + textwrap.dedent(RULE), "r.py: unknown name PROVIDE (did you"),
        (RULE.replace("def evidence", "def evidnce"), "r.py does not define evidence"),
        (RULE.replace("log, n_lanes,", "log,"), "r.py: evidence: needs a function of (log,"),
    ],
)  # fmt: skip
def test_a_rule_file_with_a_fault_is_refused_by_its_name(
    tmp_path: Path, rule: str, said: str
) -> None:
    write(tmp_path / "g.py", GRAPH)
    write(tmp_path / "r.py", rule)
    with pytest.raises(InputError, match=re.escape(said)):
        run(write_drive(tmp_path, 20, graph="./g.py", evidence="./r.py"))


def test_a_rule_that_gives_more_than_the_graph_observes_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "g.py", GRAPH.replace("Seen", "DetectorOutput"))
    experiment = load_experiment(write_drive(tmp_path, 20, graph="./g.py"))
    with pytest.raises(InputError, match=r"WOR.*UNUSED"):
        compile_model(experiment)
    text = GRAPH.replace("Seen", "DetectorOutput") + '    UNUSED = ("WOR",)\n'
    write(tmp_path / "g.py", text)
    assert compile_model(experiment).unused == {"WOR"}


def test_a_format_of_ones_own_reads_a_recording(tmp_path: Path) -> None:
    write(tmp_path / "f.py", READER)
    experiment = write_drive(
        tmp_path, 20, recording={"path": "lines.dat", "format": "./f.py", "frame_rate": 20}
    )
    (tmp_path / "lines.csv").rename(tmp_path / "lines.dat")
    result = run(experiment)
    np.testing.assert_array_equal(result.frames["time_s"], short_drive(20).log.frame_id / 20)
    assert result.experiment.recording.format == str(tmp_path / "f.py")
    write(tmp_path / "f.py", "def read(path, **options):\n    return path.nothing\n")
    with pytest.raises(InputError, match=r"recording\.format: .*f\.py, line 2: AttributeError"):
        run(experiment)


def test_two_files_of_the_same_name_are_two_modules(tmp_path: Path) -> None:
    for folder, value in (("a", 1), ("b", 2)):
        (tmp_path / folder).mkdir()
        write(tmp_path / folder / "g.py", f"def build(n_lanes, parameters): return {value}")
    one = load_plugin(Graph, str(tmp_path / "a" / "g.py"), "x")
    other = load_plugin(Graph, str(tmp_path / "b" / "g.py"), "x")
    assert one.build
    assert other.build
    assert (one.build(3, {}), other.build(3, {})) == (1, 2)
    assert load_plugin(Graph, str(tmp_path / "b" / ".." / "a" / "g.py"), "x").build is one.build
    write(tmp_path / "a" / "g.py", "def build(n_lanes, parameters): return 3")
    changed = load_plugin(Graph, str(tmp_path / "a" / "g.py"), "x")
    assert changed.build
    assert changed.build(3, {}) == 3
    assert not (tmp_path / "a" / "__pycache__").exists()


def test_a_defect_of_the_package_is_not_taken_for_a_users_mistake(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = write_drive(tmp_path, 20)
    monkeypatch.setattr("egolane_pgm.evidence.counting.evidence", lambda *a, **k: 1 // 0)
    with pytest.raises(ZeroDivisionError):
        run(experiment)

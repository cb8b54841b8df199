"""What goes wrong for someone who explores graphs: their own graph files, and recordings that tell
little. Each is one line that names the experiment and the graph, or a run that ends well."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.recordings.table import write_table
from egolane_pgm.results import read_result
from egolane_pgm.types import FloatArray, LineLog
from tests.conftest import needs_compiler
from tests.kits.drives import command, done, refused, short_drive, write_drive

ZERO_LABEL = Path(__file__).parents[2] / "experiments" / "zero_label.yaml"

GRAPH = """
import numpy as np
from egolane_pgm.graphs.cpds import *
HIDDEN, OBSERVED, UNUSED = {hidden}, ("DetectorOutput",), ("WOR",)
def build(n, parameters):
    return declare([
        *prior("Lane", uniform(n)), *dynamics("Lane", [previous("Lane")], uniform(n, n)),
        *within("DetectorOutput", ["Lane"], np.eye(n)),
        {more}
    ], OBSERVED)
"""


def graph_said(folder: Path, more: str, hidden: str = '("Lane", "X")') -> str:
    """What is said of a graph of one's own: the paper's Lane and detector, and `more`."""
    (folder / "g.py").write_text(GRAPH.format(more=more, hidden=hidden))
    said = refused("validate", write_drive(folder, 20, graph="./g.py"))
    assert refused("run", folder / "experiment.yaml", "--out", folder / "out") == said
    assert "experiment.yaml: graph" in said
    assert "./g.py" in said or "g.py" in said
    return said


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (
            '*prior("X", uniform(2)), *dynamics("X", [previous("Lane")], uniform(4, 2))',
            "X at t+1: its table has 4 rows for Lane at t, which has 3 values",
        ),
        (
            '*prior("X", uniform(2)), *dynamics("X", [previous("Y")], uniform(2, 2))',
            "X at t+1 has the parent Y at t, for which there is no table",
        ),
        (
            '*prior("X", uniform(2)), *dynamics("X", [previous("X")], uniform(2))',
            "P(X at t+1 | X at t): the table has 1 axes, needs 2",
        ),
    ],
)
def test_a_table_that_does_not_fit_its_parents_is_refused_naming_both(
    tmp_path: Path, more: str, said: str
) -> None:
    assert said in graph_said(tmp_path, more)


def test_a_cycle_in_a_slice_is_refused_naming_two_of_its_nodes(tmp_path: Path) -> None:
    two = '*within("X", ["Y"], np.eye(2)), *within("Y", ["X"], np.eye(2))'
    said = graph_said(tmp_path, two, '("Lane", "X", "Y")')
    assert "Y at t cannot depend on X at t" in said
    assert "forms a loop" in said
    three = (
        '*within("X", ["Z"], np.eye(2)), *within("Y", ["X"], np.eye(2)),'
        ' *within("Z", ["Y"], np.eye(2))'
    )
    said = graph_said(tmp_path, three, '("Lane", "X", "Y", "Z")')
    assert "Z at t cannot depend on Y at t" in said
    said = graph_said(tmp_path, '*within("X", ["X"], np.eye(2))')
    assert "X at t cannot depend on X at t" in said


def test_a_cycle_in_a_graph_in_yaml_is_refused_naming_two_of_its_nodes(tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(
        "nodes: {Lane: n_lanes, X: 2, Y: 2, DetectorOutput: n_lanes}\nhidden: [Lane, X, Y]\n"
        "observed: [DetectorOutput]\nunused: [WOR]\n"
        "edges: {within: [Lane -> DetectorOutput, X -> Y, Y -> X], across: [Lane -> Lane]}\n"
        "tables:\n  Lane: {first: uniform, next: {identity: {of: Lane before}}}\n"
        "  X: {identity: {of: Y}}\n  Y: {identity: {of: X}}\n"
        "  DetectorOutput: {identity: {of: Lane}}\n"
    )
    said = refused("validate", write_drive(tmp_path, 20, graph="./g.yaml"))
    assert "experiment.yaml: graph ./g.yaml: Y at t cannot depend on X at t" in said


def test_a_hidden_leaf_that_is_no_function_of_its_parents_is_refused(tmp_path: Path) -> None:
    said = graph_said(tmp_path, '*within("X", ["Lane"], uniform(n, 2))')
    assert "X: a hidden node without an edge across the slices must be a deterministic" in said


def test_nodes_that_are_neither_hidden_nor_observed_are_refused(tmp_path: Path) -> None:
    said = graph_said(tmp_path, '*within("X", ["Lane"], uniform(n, 2))', '("Lane",)')
    assert "X: neither hidden, observed, input nor virtual evidence" in said


def test_observed_nodes_and_evidence_that_miss_each_other_are_refused(tmp_path: Path) -> None:
    (tmp_path / "g.py").write_text(GRAPH.format(more="", hidden='("Lane",)').replace("WOR", "W"))
    said = refused("validate", write_drive(tmp_path, 20, graph="./g.py"))
    assert "the evidence rule gives WOR, which the graph does not observe" in said
    text = GRAPH.format(more='*within("GPS", ["Lane"], np.eye(n)),', hidden='("Lane",)')
    (tmp_path / "g.py").write_text(text.replace('("DetectorOutput",)', '("DetectorOutput", "GPS")'))
    said = refused("validate", tmp_path / "experiment.yaml")
    assert "the graph observes GPS, the evidence rule gives only DetectorOutput, WOR" in said


def test_a_joint_state_over_the_limit_is_refused_with_its_size_and_nodes(tmp_path: Path) -> None:
    more = '*prior("X", uniform(2000)), *dynamics("X", [previous("X")], np.eye(2000))'
    said = graph_said(tmp_path, more)
    assert "the joint hidden state has 6000 values (Lane 3 x X 2000), more than 4096" in said


def test_a_table_function_that_does_not_exist_is_refused_with_a_suggestion(tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(
        "nodes: {Lane: n_lanes, DetectorOutput: n_lanes}\nhidden: [Lane]\n"
        "observed: [DetectorOutput]\nunused: [WOR]\n"
        "edges: {within: [Lane -> DetectorOutput], across: [Lane -> Lane]}\n"
        "tables:\n  Lane: {first: uniform, next: {norml: {around: Lane before, sigma: 0.4}}}\n"
        "  DetectorOutput: {identity: {of: Lane}}\n"
    )
    said = refused("run", write_drive(tmp_path, 20, graph="./g.yaml"), "--out", tmp_path / "out")
    assert "graph ./g.yaml: tables.Lane.next: unknown table function 'norml'" in said
    assert "(did you mean 'normal'?)" in said


# --- recordings that tell little -----------------------------------------------------------------


def log_of(offset_m: FloatArray, is_valid: bool = True) -> LineLog:
    ids = np.arange(len(offset_m))
    known = np.isfinite(offset_m)
    return LineLog(
        ids,
        ids / 10.0,
        offset_m,
        known & is_valid,
        np.zeros(offset_m.shape, dtype=bool),
        np.full(offset_m.shape, 10.0),
    )


def belief_of(folder: Path, log: LineLog) -> tuple[FloatArray, str]:
    """P(lane) of the model without labels, and what is said on standard error."""
    write_table(folder / "lines.csv", log)
    words = ("--recording", folder / "lines.csv", "--n-lanes", "3", "--no-figures")
    ran = done("run", ZERO_LABEL, *words, "--out", folder / "result")
    return read_result(folder / "result").marginals["Lane"], ran.stderr


@needs_compiler
def test_a_recording_in_which_no_width_can_be_told_is_run_with_the_usual_one(
    tmp_path: Path,
) -> None:
    belief, said = belief_of(tmp_path, log_of(np.full((300, 1), -1.6)))
    assert "no two lines in one frame" in said
    assert "3.5 m is used" in said
    np.testing.assert_allclose(belief.sum(axis=1), 1)
    anywhere = np.random.default_rng(0).uniform(-9, 9, (600, 4))
    belief, said = belief_of(tmp_path, log_of(anywhere))
    assert "unsure" in said
    assert "3.5 m is used" in said
    np.testing.assert_allclose(belief.sum(axis=1), 1)


@needs_compiler
def test_lines_of_nan_or_at_exactly_zero_are_as_good_as_none(tmp_path: Path) -> None:
    """Placeholders: a detector that has nothing to say writes them."""
    given = np.zeros((200, 3))
    given[::2] = np.nan
    belief, _ = belief_of(tmp_path, log_of(given))
    none, _ = belief_of(tmp_path, log_of(np.full((200, 3), np.nan)))
    np.testing.assert_array_equal(belief, none)
    assert np.isfinite(belief).all()


@needs_compiler
def test_placeholders_beside_lines_change_nothing(tmp_path: Path) -> None:
    drive = short_drive(200).log
    alone, _ = belief_of(tmp_path, drive)
    offset = np.concatenate([drive.offset_m, np.zeros((200, 1)), np.full((200, 1), np.nan)], axis=1)
    more = LineLog(
        drive.frame_id,
        drive.time_s,
        offset,
        np.concatenate([drive.is_valid, np.ones((200, 1), bool), np.zeros((200, 1), bool)], axis=1),
        np.concatenate([drive.is_continuous, np.zeros((200, 2), bool)], axis=1),
        np.concatenate([drive.lri, np.full((200, 2), 10.0)], axis=1),
    )
    with_them, _ = belief_of(tmp_path, more)
    np.testing.assert_array_equal(with_them, alone)


@needs_compiler
def test_a_jump_of_frame_ids_diffuses_the_belief_by_the_frames_that_are_missing(
    tmp_path: Path,
) -> None:
    """As if the missing frames were there and said nothing, which `predict` puts in."""
    drive = short_drive(200).log
    kept = np.ones(200, dtype=bool)
    kept[100:105] = False
    write_table(tmp_path / "lines.csv", drive.take(kept))
    words = ("--recording", tmp_path / "lines.csv", "--n-lanes", "3", "--no-figures")
    belief = {}
    for missing in ("skip", "predict"):
        out = tmp_path / missing
        done(
            "run", ZERO_LABEL, *words, "--set", f"recording.missing_frames={missing}", "--out", out
        )
        result = read_result(out)
        belief[missing] = dict(zip(result.frame_id.tolist(), result.marginals["Lane"], strict=True))
    ids = drive.frame_id
    assert len(belief["predict"]) == len(belief["skip"]) + 5
    for t in (99, 105, 106, 150):
        np.testing.assert_allclose(belief["skip"][ids[t]], belief["predict"][ids[t]], atol=1e-6)


def test_with_predict_the_papers_model_diffuses_over_missing_frames_too(tmp_path: Path) -> None:
    drive = short_drive(40).log
    kept = np.ones(40, dtype=bool)
    kept[20:25] = False
    path = write_drive(
        tmp_path, 40, filter="exact", graph="lane_only", recording__missing_frames="predict"
    )
    write_table(tmp_path / "lines.csv", drive.take(kept))
    done("run", path, "--no-figures", "--out", tmp_path / "out")
    belief = read_result(tmp_path / "out").marginals["Lane"]
    centres = np.arange(3)
    move = np.exp(-0.5 * ((centres[None] - centres[:, None]) / 0.4) ** 2)
    move /= move.sum(axis=1, keepdims=True)
    for k in range(20, 25):
        np.testing.assert_allclose(belief[k], belief[k - 1] @ move, atol=1e-9)


def test_a_valid_line_of_nan_is_refused_by_its_frame(tmp_path: Path) -> None:
    path = write_drive(tmp_path, 20)
    lines = (tmp_path / "lines.csv").read_text().splitlines()
    header, first = lines[0].split(","), lines[1].split(",")
    first[header.index("offset_m")] = "nan"
    first[header.index("is_valid")] = "true"
    (tmp_path / "lines.csv").write_text("\n".join([lines[0], ",".join(first), *lines[2:]]))
    result = command("run", path, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "lines.csv" in result.stderr
    assert len(result.stderr.splitlines()) == 1

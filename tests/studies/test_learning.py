"""The tables of a graph learned from a recording: from labels, without labels, and held out."""

from __future__ import annotations

import functools
import json
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from egolane_pgm.drive import Drive, Recorded, load_recording
from egolane_pgm.held_out import held_out_result
from egolane_pgm.learning import fit, n_learned, with_found
from egolane_pgm.learning.graph_file import graph_yaml
from egolane_pgm.learning.tables import starting, training_frames

import egolane_pgm as ego
from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.graphs.cpds import lane_normals
from egolane_pgm.inference.compile import compile
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.model import Model, Roles, prepare_model
from egolane_pgm.plugins import load_plugin
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.running import run_experiment
from egolane_pgm.tools.files import plain
from egolane_pgm.types import LaneTruth
from tests.conformance.networks import draw_graph, graph_names
from tests.conftest import needs_compiler
from tests.kits.drives import done, refused, write_drive

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("drive")


@functools.cache
def prepared(
    folder: Path, learning: str = "{}", n_frames: int = 600
) -> tuple[Experiment, Model, Recorded]:
    changes = {"learning": yaml.safe_load(learning)} if learning != "{}" else {}
    path = write_drive(folder, n_frames, **changes)
    experiment = load_experiment(path)
    return experiment, prepare_model(experiment), load_recording(experiment)


@pytest.fixture(autouse=True)
def _some_blocks_lack_a_lane() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "(?s).*no frame to learn from has lane", UserWarning)
        yield


UNLABELLED = "{labels: false}"


@needs_compiler
@pytest.mark.parametrize("learning", ["{}", UNLABELLED])
def test_only_the_training_frames_are_looked_at(folder: Path, learning: str) -> None:
    """Neither the labels nor the lines of the other frames, nor the labels of crossing ones."""
    experiment, model, recorded = prepared(folder, learning)
    truth, log = recorded.truth, recorded.log
    assert truth is not None
    is_train = np.arange(len(truth)) < 300
    train = np.flatnonzero(is_train)
    other = np.where(is_train & ~truth.is_crossing, truth.lane, 4 - truth.lane)
    offset = log.offset_m.copy()
    unused = ~training_frames(recorded.scored, train, len(recorded.log))
    offset[unused] = -offset[unused]
    changed = replace(
        recorded,
        log=replace(log, offset_m=offset),
        truth=LaneTruth(truth.frame_id, other, truth.is_crossing),
    )
    found = fit(Drive(experiment, model, recorded), train)
    assert unused.sum() > 200
    assert fit(Drive(experiment, model, changed), train) == found
    assert fit(Drive(experiment, model, recorded), np.arange(len(truth))) != found


@needs_compiler
def test_labels_are_used_unless_they_are_not_to_be(folder: Path) -> None:
    for learning, is_same in (("{}", False), (UNLABELLED, True)):
        experiment, model, recorded = prepared(folder, learning)
        assert recorded.truth is not None
        train = np.arange(len(recorded.truth))
        mirrored = replace(recorded.truth, lane=4 - recorded.truth.lane)
        changed = replace(recorded, truth=mirrored)
        one, other = (fit(Drive(experiment, model, r), train) for r in (recorded, changed))
        assert (one == other) is is_same


@needs_compiler
def test_a_lane_without_a_label_keeps_its_first_guess_and_is_said(folder: Path) -> None:
    experiment, model, recorded = prepared(folder)
    truth = recorded.truth
    assert truth is not None
    some = np.flatnonzero((truth.lane != 3) & ~truth.is_crossing)
    with pytest.warns(UserWarning, match="no frame to learn from has lane 3; it keeps its first"):
        found = fit(Drive(experiment, model, recorded), some)
    changed = with_found(model, found, experiment)
    start = starting(model, experiment).compiled.tables
    before, after = (tables["Lane", 1].values for tables in (start, changed.compiled.tables))
    np.testing.assert_allclose(after[2], before[2], atol=1e-9)
    assert np.abs(after[:2] - before[:2]).max() > 0.01
    output = np.reshape(found["tables.DetectorOutput"], (2, 3, 3))
    np.testing.assert_allclose(output[:, 2], start["DetectorOutput", 1].values[:, 2], atol=1e-9)


@needs_compiler
def test_each_block_is_believed_with_tables_of_the_other_blocks(folder: Path) -> None:
    experiment, model, recorded = prepared(folder)
    truth = recorded.truth
    assert truth is not None
    drive = Drive(experiment.model_copy(update={"fit": "learn"}), model, recorded)
    result = held_out_result(drive, n_blocks=3)
    found = fit(drive, np.flatnonzero(result.block != 0))
    assert result.run["parameters_per_block"][0] == plain(found)
    assert (result.assigned_lane == truth.lane)[~truth.is_crossing].mean() > 0.6


def test_frames_between_two_training_frames_are_trained_on_others_are_not() -> None:
    rows = np.array([1, 2, 5, 6, 7])

    def trained(train: list[int]) -> list[int]:
        return np.flatnonzero(training_frames(rows, np.array(train), 9)).tolist()

    assert trained([0, 1, 2]) == [0, 1, 2, 3, 4, 5]
    assert trained([0, 4]) == [0, 1, 7, 8]
    # One neighbour alone is not enough: 3 and 4 lie between 2 and 5.
    assert trained([0, 1]) == [0, 1, 2]
    assert trained([2, 3, 4]) == [5, 6, 7, 8]
    assert training_frames(np.arange(4), np.array([1, 3]), 4).tolist() == [False, True] * 2


@needs_compiler
def test_a_block_that_is_left_out_is_no_step_from_what_is_before_to_what_is_after_it(
    folder: Path,
) -> None:
    """Lane 1 up to the block, lane 3 behind it: nobody was seen to go from one to the other."""
    experiment, model, recorded = prepared(folder)
    assert recorded.truth is not None
    n_frames = len(recorded.truth)
    is_before = np.arange(n_frames) < n_frames // 2
    truth = LaneTruth(
        recorded.truth.frame_id, np.where(is_before, 1, 3), np.zeros(n_frames, dtype=bool)
    )
    train = np.flatnonzero(np.abs(np.arange(n_frames) - n_frames // 2) > 50)
    found = fit(Drive(experiment, model, replace(recorded, truth=truth)), train)
    start = starting(model, experiment).compiled.tables
    move, first = np.reshape(found["tables.Lane.next"], (3, 3)), start["Lane", 1].values
    assert move[0, 2] <= first[0, 2]
    assert move[2, 0] <= first[2, 0]
    # Behind the block the drive begins anew, in lane 3.
    prior = np.asarray(found["tables.Lane.first"])
    assert prior[0] == pytest.approx(prior[2])


def test_a_rule_that_looks_back_has_seen_what_is_before_the_training_frames(tmp_path: Path) -> None:
    """This one says lane 1 in the first ten frames that it is given, then lane 3."""
    (tmp_path / "rule.py").write_text(
        "import numpy as np\n"
        "from egolane_pgm.types import Evidence\n"
        "PARAMETERS, PROVIDES = (), ('DetectorOutput',)\n"
        "def evidence(log, n_lanes, parameters):\n"
        "    says = np.where(np.arange(len(log)) < 10, 0, 2)\n"
        "    return Evidence({'DetectorOutput': np.eye(n_lanes)[says] + 1e-3})\n"
    )
    changes = {"evidence": "./rule.py", "graph": "lane_only", "learning": {"labels": False}}
    experiment = load_experiment(write_drive(tmp_path, 100, **changes))
    model, recorded = prepare_model(experiment), load_recording(experiment)
    found = fit(Drive(experiment, model, recorded), np.arange(40, 100))
    first = np.asarray(found["tables.Lane.first"])
    assert first[2] > first[0]


def test_the_prior_is_as_strong_as_the_experiment_says(folder: Path) -> None:
    away = {}
    for strength in (1, 1_000_000):
        experiment, model, recorded = prepared(folder, f"{{strength: {strength}}}")
        assert recorded.truth is not None
        found = fit(Drive(experiment, model, recorded), np.arange(len(recorded.truth)))
        start = starting(model, experiment).compiled.tables["Lane", 1].values
        away[strength] = np.abs(np.reshape(found["tables.Lane.next"], (3, 3)) - start).max()
    assert away[1_000_000] < 1e-3 < 0.02 < away[1]


@needs_compiler
def test_frames_that_are_never_fit_are_not_learned_from(tmp_path: Path) -> None:
    path = write_drive(tmp_path, 600, tuning={"never_fit": {"from_frame": 500}})
    experiment = load_experiment(path)
    recorded = load_recording(experiment)
    assert recorded.truth is not None
    learned = ego.learn(experiment, blocks=3)
    truth, ids = recorded.truth, recorded.truth.frame_id
    lane = np.where(ids >= 500, truth.lane % 3 + 1, truth.lane)
    write_ground_truth(tmp_path / "ground_truth.txt", replace(truth, lane=lane))
    again = ego.learn(experiment, blocks=3)
    assert again.scores["parameters"] == learned.scores["parameters"]
    assert again.run["parameters_per_block"] == learned.run["parameters_per_block"]
    assert again.scores["model_all_frames"] != learned.scores["model_all_frames"]


def test_leaving_out_every_frame_is_refused(tmp_path: Path) -> None:
    said = refused("learn", write_drive(tmp_path, 60, tuning={"never_fit": {"from_frame": 0}}))
    assert said.endswith("tuning.never_fit leaves no frame to learn from")


def test_the_log_evidence_is_that_of_frames_that_can_be_and_of_the_tables_started_from(
    tmp_path: Path,
) -> None:
    """A rule that says as much of every lane says ln 1/2 each frame, but for the first ten."""
    (tmp_path / "rule.py").write_text(
        "import numpy as np\n"
        "from egolane_pgm.types import Evidence\n"
        "PARAMETERS, PROVIDES = (), ('DetectorOutput',)\n"
        "def evidence(log, n_lanes, parameters):\n"
        "    rows = np.full((len(log), n_lanes), 0.5)\n"
        "    rows[:10] = 0\n"
        "    return Evidence({'DetectorOutput': rows})\n"
    )
    path = write_drive(tmp_path, 60, evidence="./rule.py", graph="lane_only")
    found = ego.learn(path, blocks=3)
    assert any("10 frame(s) to learn from cannot be" in note for note in found.notes)
    assert found.learned.log_evidence == pytest.approx((np.log(0.5), np.log(0.5)))

    changes = {"tuned_on": "same_frames", "parameters": {"sigma1": 0.1}}
    tuned = load_experiment(write_drive(tmp_path, 100, **changes))
    model, recorded = prepare_model(tuned), load_recording(tuned)
    before, _ = ego.learn(tuned, blocks=2).learned.log_evidence
    evidence = run_experiment(tuned, recorded=recorded).evidence
    beliefs = filter_beliefs(starting(model, tuned).compiled, evidence, "exact")
    assert before == pytest.approx(beliefs.log_evidence[recorded.scored].mean())
    own = filter_beliefs(model.compiled, evidence, "exact").log_evidence[recorded.scored]
    assert before != pytest.approx(own.mean())


def test_a_rule_that_learns_what_it_does_not_name_is_refused(tmp_path: Path) -> None:
    (tmp_path / "rule.py").write_text(
        "from egolane_pgm.evidence import counting\n"
        "PARAMETERS, PROVIDES = counting.PARAMETERS, counting.PROVIDES\n"
        "evidence, LEARNED = counting.evidence, ('bonus_value',)\n"
        "def fit(log, lane, is_used, n_lanes, parameters):\n"
        "    return {'bonus_value': 2.0, 'max_lri': 7.0}\n"
    )
    said = refused("learn", write_drive(tmp_path, 60, evidence="./rule.py"))
    assert said.endswith("rule.py: fit() gave max_lri, not one of LEARNED")


@needs_compiler
@pytest.mark.parametrize("words", [(), ("--set", "learning.labels=false")])
def test_what_was_learned_can_be_run_and_compared(tmp_path: Path, words: tuple[str, ...]) -> None:
    write_drive(tmp_path / "in", 600)
    (tmp_path / "out").mkdir()
    out = tmp_path / "out" / "learned.yaml"
    target = tmp_path / "scores.json"
    said = done(
        *("learn", tmp_path / "in" / "experiment.yaml", "--out", out, "--blocks", "3", *words),
        *("--json", target),
    ).output
    assert "held out, 3 blocks:" in said
    assert "neither its labels nor its lines" in said.replace("\n", " ")
    assert "log evidence per frame" in said
    assert "learned.graph.yaml" in said
    content = yaml.safe_load(out.read_text())
    assert content["graph"] == "./learned.graph.yaml"
    assert content["tuned_on"] == "same_frames"
    assert "sigma1" not in content["parameters"]
    assert "bonus_value" in content["parameters"]
    shown = done("run", out, "--no-figures", "--out", tmp_path / "result").output
    assert "in-sample" in shown
    found = json.loads(target.read_text())
    assert np.shape(found["parameters"]["tables.Lane.next"]) == (3, 3)
    assert found["log_evidence"]["held_out"] > found["log_evidence"]["before"]
    # Beliefs of the file are those of what was learned.
    experiment = load_experiment(
        tmp_path / "in" / "experiment.yaml", ["learning.labels=false"] if words else []
    )
    model, recorded = prepare_model(experiment), load_recording(experiment)
    assert recorded.truth is not None
    everything = fit(Drive(experiment, model, recorded), np.arange(len(recorded.truth)))
    right = with_found(model, everything, experiment).compiled
    mine = prepare_model(load_experiment(out)).compiled
    np.testing.assert_allclose(mine.transition, right.transition, rtol=1e-9)
    shown = done("compare", tmp_path / "in" / "experiment.yaml", out, "--blocks", "3").stdout
    assert "learned |" in shown


@needs_compiler
def test_without_ground_truth_only_the_evidence_is_learned_from(tmp_path: Path) -> None:
    path = write_drive(tmp_path, 300, ground_truth=None)
    said = refused("learn", path, "--out", tmp_path / "a.yaml")
    assert "ground_truth: is missing, learning needs it, or learning.labels: false" in said
    shown = done(
        "learn", path, "--set", "learning.labels=false", "--out", tmp_path / "a.yaml"
    ).stdout
    assert "held out, 5 blocks" in shown
    assert "no ground truth" in shown
    assert "log evidence per frame" in shown
    done("run", tmp_path / "a.yaml", "--no-figures", "--out", tmp_path / "result")


@needs_compiler
def test_compare_learns_without_each_block(tmp_path: Path) -> None:
    path = write_drive(tmp_path, 600, fit="learn", tuned_on="not_tuned")
    target = tmp_path / "c.json"
    done("compare", path, "--blocks", "3", "--json", target)
    (entry,) = json.loads(target.read_text())["recordings"][0]["experiments"]
    learned = ego.learn(path, blocks=3)
    assert entry["scores"]["all_frames"]["accuracy"] == learned.scores["model"]["accuracy"]
    assert entry["tuned_on"] == "other_frames"
    # Lane 2 + 3 x 2, SensorState 1 + 2, DetectorOutput 6 x 2, WOR 2.
    assert entry["free_parameters"] == 8 + 3 + 12 + 2
    assert entry["parameters"] == learned.run["parameters_per_block"]


def test_tables_that_have_seen_the_frames_are_not_started_from(tmp_path: Path) -> None:
    given = {"parameters": {"sigma1": 0.1, "bonus_value": 5}}
    start = {}
    for tuned_on in ("same_frames", "not_tuned"):
        experiment = load_experiment(write_drive(tmp_path, 60, tuned_on=tuned_on, **given))
        model = prepare_model(experiment)
        start[tuned_on] = starting(model, experiment).compiled.tables["Lane", 1].values
    sigma1 = next(p.default for p in model.graph.PARAMETERS if p.name == "sigma1")
    assert isinstance(sigma1, float)
    np.testing.assert_array_equal(start["same_frames"], lane_normals(sigma1, 3))
    assert start["not_tuned"][0, 0] > 0.999
    result = done(
        "learn",
        write_drive(tmp_path, 60, tuned_on="same_frames", **given),
        "--out",
        tmp_path / "a.yaml",
    )
    assert "tuned_on same_frames: learning starts from the defaults of sigma1" in result.stderr
    assert "bonus_value of the evidence rule is kept as given" in result.stderr
    said = done("compare", tmp_path / "experiment.yaml", "--set", "fit=learn").stderr
    assert said.count("bonus_value of the evidence rule is kept as given") == 1
    again = done("learn", tmp_path / "a.yaml", "--out", tmp_path / "b.yaml")
    assert "no parameters with defaults to start from, so held-out scores have seen" in again.stderr


@needs_compiler
def test_a_graph_of_ones_own_is_learned_wherever_the_result_is_written(tmp_path: Path) -> None:
    (tmp_path / "away").mkdir()
    out = tmp_path / "away" / "own.yaml"
    done("learn", ROOT / "examples" / "own_files.yaml", "--out", out, "--blocks", "2")
    content = yaml.safe_load(out.read_text())
    assert Path(tmp_path / "away" / content["evidence"]).resolve() == (
        ROOT / "examples" / "my_evidence.py"
    )
    assert content["parameters"]["tempering"] == 0.7
    done("run", "--dry-run", out)


DISCRETE = [name for name in graph_names() if not name.startswith("position_in")]

#: A table in YAML that gives a node its parent's value.
SAME = "[[1, 0, 0], [0, 1, 0], [0, 0, 1]]"

#: Short drives do not come to each lane.
pytestmark = pytest.mark.filterwarnings("ignore:.*no frame to learn from has lane:UserWarning")


@needs_compiler
@pytest.mark.parametrize("name", DISCRETE)
def test_every_discrete_graph_can_be_learned_and_written(name: str, tmp_path: Path) -> None:
    """The file compiles to the arrays that were learned, with the same nodes."""
    rule = "counting_levels" if name == "wor_levels" else "counting"
    experiment = load_experiment(write_drive(tmp_path, 200, graph=name, evidence=rule))
    model, recorded = prepare_model(experiment), load_recording(experiment)
    assert recorded.truth is not None
    found = fit(Drive(experiment, model, recorded), np.arange(len(recorded.truth)))
    assert n_learned(model, experiment) > 0
    learned = with_found(model, found, experiment)
    content = graph_yaml(learned, "learned")
    (tmp_path / "g.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    module = load_plugin("graphs", "./g.yaml", tmp_path, "graph")
    assert (module.HIDDEN, module.OBSERVED) == (model.graph.HIDDEN, model.graph.OBSERVED)
    for optional, default in (("VALUES", {}), ("UNUSED", ())):
        assert getattr(module, optional) == getattr(model.graph, optional, default)
    read = compile(
        module.build(3, {}), hidden=module.HIDDEN, observed=module.OBSERVED, inputs=module.INPUTS
    )
    np.testing.assert_allclose(read.prior, learned.compiled.prior, rtol=1e-9, atol=0)
    np.testing.assert_allclose(read.transition, learned.compiled.transition, rtol=1e-9, atol=0)
    for mine, right in zip(read.groups, learned.compiled.groups, strict=True):
        assert mine.observed == right.observed
        np.testing.assert_allclose(mine.emission, right.emission, rtol=1e-9, atol=0)


@pytest.mark.parametrize("seed", range(8))
def test_random_graphs_come_back_from_their_file(seed: int, tmp_path: Path) -> None:
    """Inputs, functions and joint evidence too; a graph of one's own may have all of them."""
    rng = np.random.default_rng(seed)
    drawn = draw_graph(rng)
    compiled = drawn.compiled()
    own = tmp_path / "own.py"
    own.write_text("def build(n, p): ...\n")
    module = load_plugin("graphs", "./own.py", tmp_path, "graph")
    roles = Roles(drawn.hidden, drawn.observed, drawn.inputs, ())
    model = Model(module, module, {}, compiled, 3, roles)
    (tmp_path / "g.yaml").write_text(yaml.safe_dump(graph_yaml(model, "")))
    read = load_plugin("graphs", "./g.yaml", tmp_path, "graph")
    found = compile(
        read.build(3, {}), hidden=read.HIDDEN, observed=read.OBSERVED, inputs=read.INPUTS
    )
    np.testing.assert_allclose(found.transition, compiled.transition, rtol=1e-9)
    np.testing.assert_allclose(found.prior, compiled.prior, rtol=1e-9)
    for mine, right in zip(found.groups, compiled.groups, strict=True):
        np.testing.assert_allclose(mine.emission, right.emission, rtol=1e-9)


@pytest.mark.parametrize(
    ("learning", "said"),
    [
        ({"tables": []}, "learning.tables: names no table; leave it out to learn all of"),
        ({"tables": ["Lan"]}, "learning.tables: 'Lan' has no table to learn (did you mean 'Lane'?"),
        ({"strenth": 3}, "learning: unknown key 'strenth' (did you mean 'strength'?)"),
        ({"strength": 0}, "learning.strength: input should be greater than 0 (got 0)"),
        ({"strength": float("inf")}, "learning.strength: input should be a finite number"),
        ({"iterations": 0}, "learning.iterations: input should be greater than or equal to 1"),
        ({"labels": "perhaps"}, "learning.labels: input should be a valid boolean"),
    ],
)
def test_a_setting_that_does_not_fit_is_named(
    tmp_path: Path, learning: dict[str, object], said: str
) -> None:
    assert said in refused("learn", write_drive(tmp_path, 30, learning=learning))


def test_a_graph_without_a_table_to_learn_is_refused(tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(
        "nodes: {Lane: 3, DetectorOutput: 3}\nhidden: [Lane]\n"
        "observed: [DetectorOutput]\nunused: [WOR]\n"
        "edges: {within: [Lane -> DetectorOutput], across: [Lane -> Lane]}\n"
        "tables:\n  Lane: {first: {rows: {values: [1, 0, 0]}},"
        f" next: {{rows: {{of: [Lane before], values: {SAME}}}}}}}\n"
        f"  DetectorOutput: {{rows: {{of: [Lane], values: {SAME}}}}}\n"
    )
    said = refused("learn", write_drive(tmp_path, 30, graph="./g.yaml"))
    assert "evidence rule counting cannot be learned, nor can the graph ./g.yaml" in said
    assert "egolane tune" in said
    said = refused("compare", tmp_path / "experiment.yaml", "--set", "fit=learn")
    assert "nor can the graph ./g.yaml" in said


def test_what_a_rule_learned_is_written_with_four_digits(tmp_path: Path) -> None:
    (tmp_path / "rule.py").write_text(
        "from egolane_pgm.evidence import counting\n"
        "from egolane_pgm.parameters import Parameter\n"
        "PARAMETERS = (*counting.PARAMETERS, Parameter(\n"
        "    'shares', 'non_negative', (0.0,) * 6, '', shape=lambda n: (n, 2)))\n"
        "PROVIDES, evidence, LEARNED = counting.PROVIDES, counting.evidence, ('shares',)\n"
        "def fit(log, lane, is_used, n_lanes, parameters):\n"
        "    return {'shares': (0.123456, 2.0, 1234.56, 1e-7, 0.0, 0.999949)}\n"
    )
    path = write_drive(tmp_path, 60, evidence="./rule.py")
    done("learn", path, "--out", tmp_path / "out.yaml", "--blocks", "2")
    content = yaml.safe_load((tmp_path / "out.yaml").read_text())
    assert content["parameters"]["shares"] == [[0.1235, 2.0], [1235.0, 1e-7], [0.0, 0.9999]]


@needs_compiler
def test_labels_that_the_graph_does_not_allow_are_left_out_and_counted(tmp_path: Path) -> None:
    path = write_drive(tmp_path, 600, tuned_on="not_tuned", parameters={"sigma1": 1e-9})
    experiment = load_experiment(path)
    model, recorded = prepare_model(experiment), load_recording(experiment)
    assert recorded.truth is not None
    with pytest.warns(UserWarning, match=r"frame\(s\) to learn from cannot be under graph sensor"):
        fit(Drive(experiment, model, recorded), np.arange(len(recorded.truth)))


def test_without_labels_no_number_is_fitted_to_them(tmp_path: Path) -> None:
    for labels in (True, False):
        experiment = load_experiment(write_drive(tmp_path, 30, learning={"labels": labels}))
        assert (n_learned(prepare_model(experiment), experiment) > 0) is labels

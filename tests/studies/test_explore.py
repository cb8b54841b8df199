"""The search of edges: on drives drawn from a known network, and its numbers by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import pandas as pd
import pytest
from scipy import stats

import egolane_pgm as ego
from egolane_pgm.drives import Drive
from egolane_pgm.graphs.cpds import Table
from egolane_pgm.inference.compile import compile_tables, free_parameters
from egolane_pgm.scoring.scores import SCORES
from egolane_pgm.studies import explore as module
from egolane_pgm.studies import structures
from egolane_pgm.studies.explore import Problem, explore, fitted, judged, make_problem
from egolane_pgm.studies.objective import drive_summands
from egolane_pgm.studies.structures import Edge, parse_edge, with_structure
from egolane_pgm.studies.study import Fold, block_folds, everything
from tests.benchmarks.workbench import search
from tests.kits.line_logs import line_log
from tests.kits.studies import drive_of, fitting

KEYS = {"recording.frames": [0, 300], "fit.strength": 1.0}
DRIVE = drive_of(ego.load_experiment("quickstart", KEYS))
FIVE_LANES = drive_of(ego.load_experiment("quickstart", {**KEYS, "n_lanes": 5}))
UNLABELLED = replace(DRIVE, true_lane=np.zeros(300, np.int64))
WHOLE, BIC = everything([DRIVE]), make_problem([DRIVE], [], judge="bic")
START = DRIVE.model.compiled
ADDED = [Edge("WOR", "Lane", 0), Edge("WOR", "WOR", 1)]
REPEATS = Edge("WOR", "WOR", 1, repeats=True)
THREE = [*ADDED, Edge("WOR", "Lane", 1)]
REMOVED = Edge("DetectorOutput", "SensorState", 0)


def drawn_from(truth: Edge, n_frames: int) -> Problem:
    """A drive of the network with an edge more, whose new table is random."""
    tables = {table.node: table for table in with_structure(BIC.tables, frozenset({truth}), 0)[0]}
    shape = tables[truth.child, 1].values.shape[:-1]
    ok = np.random.default_rng(101).uniform(0.1, 0.9, shape)
    for node in ((truth.child, s) for s in range(truth.lag, 2)):
        tables[node] = replace(tables[node], values=np.stack([ok, 1 - ok], axis=-1))
    roles = {"observed": START.observed, "hidden": START.hidden, "values": START.values}
    frames = ego.sample(compile_tables(list(tables.values()), **roles), n_frames, seed=1)
    lane = frames["Lane"].cat.codes.to_numpy(np.int64) + 1
    nothing = np.zeros((n_frames, 0))
    drive = Drive("drawn", DRIVE.model, line_log(nothing), lane, nothing.any(axis=1))
    evidence = ego.Evidence.hard(frames[["DetectorOutput", "WOR"]], START)
    return replace(make_problem([drive], [], judge="bic"), evidence=(evidence,))


@pytest.mark.parametrize("truth", ADDED, ids=str)
def test_an_edge_is_found_again(truth: Edge) -> None:
    others = [REMOVED, Edge("WOR", "DetectorOutput", 0), Edge("SensorState", "Lane", 1)]
    found = explore(drawn_from(truth, 4000), [*map(str, [*others, *ADDED])])
    assert found.best == {truth}
    assert found.edges["passes"].tolist() == [True, False, False, False, False]
    assert found.edges["selected"].iloc[0] > 0.9
    assert found.gain["gain"] == found.edges["gain"].iloc[0] > 0.01


def test_a_study_keeps_what_it_tried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On disk: a repeated call fits nothing but the best structure."""
    problem = make_problem([DRIVE], block_folds([DRIVE], 2), nodes=["Rain=2"])
    edges, fits = ["Rain -> WOR", str(REPEATS)], []
    first = explore(problem, edges, trials=4, directory=tmp_path)
    monkeypatch.setattr(module, "fitted", lambda *a: fits.append(a[1]) or fitted(*a))
    again = explore(problem, edges, trials=4, directory=tmp_path)
    assert again.edges.equals(first.edges)
    # A drive of 300 frames lets nothing pass.
    assert fits == [first.best] == [frozenset()]


@pytest.mark.parametrize(
    "sampler", ["random", optuna.samplers.RandomSampler(0)], ids=["name", "own"]
)
def test_a_pruned_set_is_not_the_answer(sampler: Any) -> None:
    problem, edges = make_problem([DRIVE], block_folds([DRIVE], 2)), ["Lane -> WOR", str(REPEATS)]
    all_sets = explore(problem, edges, trials=8, sampler=sampler)
    pruner = optuna.pruners.ThresholdPruner(lower=np.inf)
    alone = explore(problem, edges, trials=8, sampler=sampler, pruner=pruner)
    assert (len(all_sets.structures), len(alone.structures)) == (4, 3)


def judgement(values: Any, free_parameters: int) -> pd.DataFrame:
    """What `judged` returns for the values (T,) of each recording, as of a mean."""
    recording = np.repeat(np.arange(len(values)), [len(each) for each in values])
    table = pd.DataFrame({"0": np.concatenate(values), "1": 1.0, "recording": recording})
    table.attrs = {"free_parameters": free_parameters}
    return table


@pytest.mark.parametrize("sampler", ["evolution", "tpe"])
def test_every_sampler_of_a_search_explores(sampler: str) -> None:
    problem = make_problem([DRIVE], [], judge="bic")
    found = explore(problem, ["Lane -> WOR", str(REPEATS)], trials=6, sampler=sampler)
    assert len(found.structures) == 4
    assert found.structures["score"].is_monotonic_decreasing


def test_clips_of_one_recording_are_several_drives() -> None:
    clips = [replace(DRIVE, name=name) for name in ("a", "b")]
    seeded = ego.load_experiment("quickstart", {**KEYS, "recording.seed": 1})
    other = replace(DRIVE, model=replace(DRIVE.model, experiment=seeded))
    assert make_problem(clips, [], judge="bic").drive_ids == (0, 1)
    assert make_problem([DRIVE, DRIVE], [], judge="bic").drive_ids == (0, 0)
    assert make_problem([DRIVE, other], [], judge="bic").drive_ids == (0, 1)


def test_recordings_of_one_drive_count_once_over_drives() -> None:
    tried, edge = module.Tried(replace(BIC, drive_ids=(0, 1, 1)), None), frozenset({REPEATS})
    tried.found[frozenset(), 0] = judgement([np.zeros(700)] * 3, 1)
    tried.found[edge, 0] = judgement([np.full(700, each) for each in (0.1, 0.2, 0.6)], 2)
    gain = tried.gain(edge)
    of_frames = [gain["gain"], gain["gain_low"], gain["gain_high"]]
    np.testing.assert_allclose(of_frames, 0.3)
    of_drives = [gain["over_drives"], gain["over_drives_low"], gain["over_drives_high"]]
    np.testing.assert_allclose(of_drives, [0.25, *stats.t.interval(0.95, 1, 0.25, 0.15)])
    assert (gain["drives"], gain["free_parameters"]) == (2, 1)
    # A loss that grows is no gain.
    tried.problem = replace(tried.problem, judge="brier")
    assert tried.gain(edge)["gain"] == pytest.approx(-0.3)
    assert tried.gain(edge)["drives"] == 0


def test_only_frames_of_trusted_labels_outside_of_crossings_are_judged() -> None:
    drive = fitting(DRIVE, untrusted_frames=[[40, 90]])
    problem = make_problem([drive], block_folds([drive], 2))
    counted = np.concatenate([judged(problem, ((), k))["1"] for k in (0, 1)])
    is_untrusted = (drive.log.frame_id[drive.rows] >= 40) & (drive.log.frame_id[drive.rows] < 90)
    np.testing.assert_array_equal(counted == 0, is_untrusted | drive.is_crossing[drive.rows])


@pytest.mark.parametrize("judge", SCORES)
def test_any_score_is_a_judge(judge: str) -> None:
    """Its score is that of the held-out frames of all folds together."""
    folds = block_folds([DRIVE], 2)
    problem = make_problem([fitting(DRIVE, objective="log_evidence")], folds, judge=judge)
    found = explore(problem, ["Lane -> WOR"])
    score, summands = SCORES[judge], []
    for fold in folds:
        [evidence], is_used = problem.evidence, np.zeros(len(DRIVE), dtype=bool)
        is_used[fold.test[0]] = True
        is_used &= ~DRIVE.is_crossing[DRIVE.rows]
        beliefs = ego.filter_beliefs(fitted(problem, frozenset(), fold)[0], evidence)
        [each] = drive_summands([DRIVE], [beliefs], [is_used], judge)
        summands.append(each.sum(axis=0))
    expected = score.statistic(np.sum(summands, axis=0)) * (1 if score.is_maximised else -1)
    start = found.structures.set_index("edges").loc["none", "score"]
    assert start == pytest.approx(expected)
    assert found.judge.startswith("gain in held-out ")


def test_the_start_is_judged_with_its_declared_tables_if_a_fit_makes_it_worse() -> None:
    """Labels of no meaning in the training frames of the only fold."""
    lane = np.where(np.arange(300) < 150, 5 - DRIVE.true_lane, DRIVE.true_lane)
    drive = replace(fitting(DRIVE, strength=0.01, block=1), true_lane=lane)
    fold = block_folds([drive], 2)[1]
    problem = make_problem([drive], [fold])
    worse, declared = (
        ego.filter_beliefs(each, problem.evidence[0]).take(drive.rows)
        for each in (fitted(problem, frozenset(), fold)[0], module.made(problem, frozenset())[0])
    )
    is_used = np.isin(np.arange(300), fold.test[0]) & ~drive.is_crossing[drive.rows]
    [bad], [good] = (
        drive_summands([drive], [each], [is_used], "log_loss") for each in (worse, declared)
    )
    assert good.sum(axis=0)[0] < bad.sum(axis=0)[0]
    found = judged(problem, ((), 0))[["0", "1"]].to_numpy()
    np.testing.assert_allclose(found, good[fold.test[0]])


def test_a_gain_by_chance_ends_a_greedy_search() -> None:
    tried, (clear, other) = module.Tried(BIC, None), ADDED
    chance = np.random.default_rng(1).normal(0.01, 1, 3000)
    assert 0 < chance.mean() < 0.1
    gains = {frozenset[Edge](): 0.0, frozenset({clear}): 0.1, frozenset({other}): chance}
    gains[frozenset(ADDED)] = chance + 0.1
    for structure, gain in gains.items():
        tried.found[structure, 0] = judgement([gain + np.zeros(3000)], 1)
    assert module._greedy(tried, ADDED) == {clear}


@pytest.mark.parametrize("edge", [*ADDED, REPEATS, REMOVED], ids=str)
def test_a_changed_table_says_as_much_as_before(edge: Edge) -> None:
    # A node that is new gets random factors.
    tables, bases = with_structure(BIC.tables, frozenset({edge}), 0, new={edge.child})
    [now] = [table for table in tables if table.node == (edge.child, 1)]
    np.testing.assert_allclose(now.values.sum(axis=-1), 1)
    before = START.tables[edge.child, 1].values
    if edge == REMOVED:
        np.testing.assert_array_equal(now.values, before.mean(axis=0))
    elif edge.repeats:
        np.testing.assert_array_equal(bases[now.node], before)
        np.testing.assert_allclose(
            now.values, np.broadcast_to(before[:, None], (2, 2, 2)), atol=2e-3
        )
    else:
        ratio = now.values / before[..., None, :]
        assert 1 / 1.2 <= ratio.min() < 1 < ratio.max() <= 1.2


def test_repetition_is_found_from_its_counts() -> None:
    counts = 1000 * structures.repetition(np.array([[0.2, 0.3, 0.5], [0.6, 0.3, 0.1]]), 0.7)
    step, posterior = structures.repetition_step(np.full((2, 3), 1 / 3), strength=5), []
    for _ in range(300):
        values, log_prior = step(counts)
        posterior.append(float((counts * np.log(values)).sum()) + log_prior)
    assert (np.diff(posterior) > -1e-8).all()
    np.testing.assert_allclose(values, counts / 1000, atol=0.01)


def test_free_parameters_and_bic_by_hand() -> None:
    repeated = structures.repetition(np.array([0.0, 0.4, 0.6]), 0.5)
    plain = np.array([[0.5, 0.5], [1.0, 0.0], [0.9, 0.1]])
    tables = [Table(("A", 1), (("A", 0),), repeated), Table(("B", 1), (("A", 1),), plain)]
    assert free_parameters({t.node: t for t in tables}, [("A", 1)]) == (1 + 1) + (1 + 0 + 1)
    [evidence] = BIC.evidence
    found = judged(BIC, ((), 0)).attrs
    lane = np.where(DRIVE.is_crossing, -1, DRIVE.true_lane - 1)
    fit = ego.fit_tables(START, evidence, {"Lane": lane}, strength=1.0, iterations=50)
    log_evidence = ego.filter_beliefs(fit.compiled, evidence).log_evidence.sum()
    # SensorState and Lane in later frames, DetectorOutput, WOR.
    numbers = 2 + 4 * 3 + 8 * 3 + 2
    assert found["bic"] == pytest.approx(log_evidence - numbers / 2 * np.log(300))


def test_bic_and_the_best_edges_are_those_of_pgmpy() -> None:
    _, ours, others, _ = search()
    np.testing.assert_allclose(ours(), others["pgmpy"](), atol=1e-5)


def test_edges_are_read_as_they_are_written() -> None:
    found = module.candidates(BIC)
    assert [parse_edge(str(edge), START.values) for edge in found] == found


NO_FRAMES = fitting(DRIVE, untrusted_frames=[[0, None]])
EMPTY = Fold((np.zeros(0, dtype=int),), (np.arange(len(DRIVE)),))
OF_INPUT = replace(BIC, model=replace(BIC.model, compiled=replace(START, inputs=("Lane",))))
REFUSED = {
    "no node 'Rain'": lambda: parse_edge("Rain -> WOR", START.values),
    "judge: unknown score 'acuracy' .did you mean 'accuracy'": lambda: make_problem(
        [DRIVE], [], judge="acuracy"
    ),
    "log_loss needs held-out frames": lambda: make_problem([DRIVE], []),
    "log_loss needs ground truth": lambda: make_problem([UNLABELLED], [WHOLE]),
    "differ in n_lanes": lambda: make_problem([DRIVE, FIVE_LANES], [WHOLE]),
    "WOR -> SensorState': the edges within a slice form a cycle": lambda: explore(
        BIC, ["WOR -> SensorState"]
    ),
    "unknown sampler 'best'": lambda: explore(BIC, ["Lane -> WOR"], sampler="best"),
    "no table that an input selects": lambda: module.made(OF_INPUT, frozenset(ADDED)),
    "WOR has more than 3 parents": lambda: module.made(BIC, frozenset(THREE)),
    "block 1: no frame is left to fit to": lambda: make_problem([NO_FRAMES], [EMPTY]),
    "NEW_NAME=SIZE": lambda: make_problem([DRIVE], [], judge="bic", nodes=["Lane=3"]),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_does_not_fit_is_refused(message: str) -> None:
    with pytest.raises(ego.InputError, match=message):
        REFUSED[message]()

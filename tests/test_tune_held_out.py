"""Held-out studies: they see nothing of the part they are scored on, and say what they are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tuning_kit import BLOCKS, plan, problem

from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.confusion import confusion
from egolane_pgm.tune import tuning
from egolane_pgm.tune.held_out import (
    assess,
    beliefs_at,
    block_frames,
    check_blocks,
    difference,
    run_nested,
    stitched,
    training_frames,
)
from egolane_pgm.tune.objective import all_used
from egolane_pgm.tune.plan import Plan, Problem, make_problem, together, with_options
from egolane_pgm.types import InputError
from egolane_pgm.validation import bootstrap_interval, confusion_counts


def with_labels(found: Problem, lanes: list[Any]) -> Problem:
    drives = tuple(
        replace(d, truth=replace(d.truth, lane=lane))
        for d, lane in zip(found.drives, lanes, strict=True)
    )
    return replace(found, drives=drives)


def scrambled(found: Problem, part: int, seed: int) -> Problem:
    """The labels of a block, and of the frames that are never fitted, at random."""
    rng = np.random.default_rng(seed)
    lanes = []
    for drive, seen in zip(found.drives, training_frames(found, part, False), strict=True):
        lane = drive.truth.lane.copy()
        lane[~seen] = rng.integers(1, drive.n_lanes + 1, size=(~seen).sum())
        lanes.append(lane)
    return with_labels(found, lanes)


@pytest.mark.parametrize("part", range(0, BLOCKS, 2))
@pytest.mark.parametrize("objective", ["accuracy", "log_loss"])
def test_nothing_of_a_block_influences_its_study(part: int, objective: str) -> None:
    trials = 90 if objective == "accuracy" else 35
    found = problem(trials=trials, objective=(objective,), never_fit=((1000, 1020), (1150, None)))
    honest = run_nested(found, part, False)
    for seed in (1, 2):
        assert run_nested(scrambled(found, part, seed), part, False) == honest
    seen = training_frames(found, part, False)[0]
    upside = found.drives[0].truth.lane.copy()
    upside[seen] = found.drives[0].n_lanes + 1 - upside[seen]
    assert run_nested(with_labels(found, [upside]), part, False) != honest


def test_known_values_are_not_told_to_a_nested_study() -> None:
    found = problem(trials=5)
    current = found.drives[0].model.parameters
    same = replace(found.drives[0], model=replace(found.drives[0].model, parameters=current))
    other = replace(
        found.drives[0],
        model=replace(found.drives[0].model, parameters={**current, "sigma1": 0.123, "p1": 0.321}),
    )
    first = run_nested(replace(found, drives=(same,)), 0, False)
    assert run_nested(replace(found, drives=(other,)), 0, False) == first
    assert first.point != {key: current[key] for key in found.space.keys}


def test_the_stitched_belief_is_each_blocks_own() -> None:
    found = problem(trials=40)
    nested = [run_nested(found, b, False) for b in range(BLOCKS)]
    belief = stitched(found, nested, False)[0]
    for result, inside in zip(nested, block_frames(found.drives[0], BLOCKS), strict=True):
        alone = beliefs_at(found, result.point)[0]
        np.testing.assert_array_equal(belief[inside], alone[inside])
    assert len({str(n.point) for n in nested}) > 1


def test_scores_of_one_recording_are_those_of_validation() -> None:
    found = problem()
    drive = found.drives[0]
    belief = beliefs_at(found, {k: drive.model.parameters[k] for k in found.space.keys})
    scores = assess([drive], belief, all_used([drive]))
    assigned = assigned_lane(belief[0])
    truth = drive.truth
    matrix = confusion(assigned, truth.lane, truth.is_crossing, drive.n_lanes)
    assert scores["confusion"] == matrix.tolist()
    counts = confusion_counts(assigned, truth.lane, truth.is_crossing, drive.n_lanes)
    from egolane_pgm.scoring.confusion import accuracy

    interval = bootstrap_interval(counts, accuracy)
    assert scores["accuracy"] == interval.estimate
    assert scores["intervals"]["accuracy"] == pytest.approx([interval.low, interval.high])


def test_the_difference_of_a_belief_with_itself_is_nothing() -> None:
    found = problem()
    drive = found.drives[0]
    belief = beliefs_at(found, {k: drive.model.parameters[k] for k in found.space.keys})
    same = difference([drive], belief, belief, all_used([drive]))
    assert same["accuracy"] == 0
    assert same["intervals"]["accuracy"] == [0, 0]


def test_a_drive_too_short_for_an_interval_has_none() -> None:
    drive = problem().drives[0]
    keep = np.zeros(len(drive), dtype=bool)
    keep[:400] = True
    belief = beliefs_at(problem(), {k: drive.model.parameters[k] for k in problem().space.keys})
    scores = assess([drive], belief, [keep])
    assert scores["intervals"]["accuracy"] is None
    assert 0 < scores["accuracy"] <= 1


def test_more_blocks_than_lane_changes_are_refused() -> None:
    with pytest.raises(InputError, match=r"60 blocks, but the drive has \d+ lane change"):
        check_blocks(problem(blocks=60))


def test_a_lane_that_would_be_left_without_a_frame_to_fit_on_is_refused_with_advice() -> None:
    with pytest.raises(
        InputError, match=r"without block \d of 2 no frame in lane \d is left to fit on; take \d+"
    ):
        check_blocks(problem(blocks=2))


def test_a_block_without_one_of_the_lanes_is_said() -> None:
    notes = check_blocks(problem())
    assert any("block" in note and "has no frame in lane" in note for note in notes)


def two_drives(**options: Any) -> Plan:
    one = plan(**options)
    other = one.experiments[0].model_copy(update={"name": "second"})
    object.__setattr__(
        other, "recording", other.recording.model_copy(update={"seed": other.recording.seed + 1})
    )
    second = replace(one, name="second", experiments=(other,))
    return with_options(together([one, second]), options)


def test_a_whole_recording_is_held_out_without_being_seen() -> None:
    found = make_problem(two_drives(trials=35))
    assert len(found.drives) == 2
    honest = run_nested(found, 1, True)
    rng = np.random.default_rng(0)
    drive = found.drives[1]
    lanes = [found.drives[0].truth.lane, rng.integers(1, drive.n_lanes + 1, size=len(drive))]
    assert run_nested(with_labels(found, lanes), 1, True) == honest
    nested = [run_nested(found, part, True) for part in (0, 1)]
    beliefs = stitched(found, nested, True)
    np.testing.assert_array_equal(beliefs[0], beliefs_at(found, nested[0].point)[0])
    np.testing.assert_array_equal(beliefs[1], beliefs_at(found, nested[1].point)[1])


def test_a_study_reports_in_sample_and_held_out_and_marks_them(tmp_path: Any) -> None:
    study = tuning.prepare(plan(trials=35, never_fit=((1100, None),)), tmp_path / "s")
    document = next(iter(tuning.tune([study])))
    assert document["in_sample"]["tuned_on"] == "same_frames"
    assert document["held_out"]["tuned_on"] == "other_frames"
    for subset in ("all_frames", "without_never_fit"):
        inside, outside = document["in_sample"][subset], document["held_out"][subset]
        lost = document["difference"][subset]["accuracy"]
        assert lost == pytest.approx(inside["accuracy"] - outside["accuracy"])
        low, high = inside["intervals"]["accuracy"]
        assert low <= inside["accuracy"] <= high
    assert document["in_sample"]["all_frames"]["accuracy"] == pytest.approx(
        document["best"]["values"]["accuracy"]
    )
    scored = [document["held_out"][k]["frames_scored"] for k in ("all_frames", "without_never_fit")]
    assert scored[0] > scored[1]


def test_processes_find_the_same_as_one(tmp_path: Any) -> None:
    documents = []
    for jobs in (1, 2):
        study = tuning.prepare(plan(trials=35), tmp_path / str(jobs))
        documents.append(next(iter(tuning.tune([study], jobs=jobs))))
    one, two = documents
    for key in ("in_sample", "held_out", "difference"):
        assert one[key] == two[key]
    assert one["best"]["point"] == two["best"]["point"]


def test_nested_studies_that_are_done_are_not_run_again(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = []
    original = tuning.run_nested

    def counted(found: Problem, part: int, *rest: Any) -> Any:
        if part == 3 and not ran.count(3):
            ran.append(3)
            raise KeyboardInterrupt
        ran.append(part)
        return original(found, part, *rest)

    monkeypatch.setattr(tuning, "run_nested", counted)
    with pytest.raises(KeyboardInterrupt):
        list(tuning.tune([tuning.prepare(plan(trials=35), tmp_path / "s")]))
    list(tuning.tune([tuning.prepare(plan(trials=35), tmp_path / "s")]))
    assert ran == [0, 1, 2, 3, *range(3, BLOCKS)]


def test_a_study_is_tested_on_another_drive(tmp_path: Any) -> None:
    second = replace(two_drives(), experiments=two_drives().experiments[1:], name="second")
    study = tuning.prepare(plan(trials=35), tmp_path / "s", "none", second)
    document = next(iter(tuning.tune([study])))
    assert document["held_out"] is None
    assert document["test"]["tuned_on"] == "other_frames"
    point = document["best"]["point"]
    other = make_problem(second)
    expected = assess(other.drives, beliefs_at(other, point), all_used(other.drives))
    assert document["test"]["all_frames"] == expected

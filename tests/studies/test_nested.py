"""Held-out studies: they see nothing of the part they are scored on, and say what they are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from egolane_pgm.scoring import score_all
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.bootstrap import (
    bootstrap_interval,
    circular_block_bootstrap,
    confusion_counts,
    resampled_sums,
)
from egolane_pgm.scoring.confusion import accuracy
from egolane_pgm.scoring.held_out import blocks
from egolane_pgm.tuning.assess import assess, difference
from egolane_pgm.tuning.nested import (
    Nested,
    blocks_lacking_lanes,
    nested_search,
    settings_of_part,
)
from egolane_pgm.tuning.objective import all_used
from egolane_pgm.tuning.plan import Fleet, Plan, Problem, make_problem, together, with_options
from egolane_pgm.tuning.recording_task import beliefs_at, without_part
from tests.kits.tuning_kit import BLOCKS, plan, problem


def run_nested(found: Problem, part: int) -> Nested:
    return nested_search(*without_part(found, part), part)


def current(found: Problem) -> list[dict[str, Any]]:
    """The point of the experiment's own values."""
    parameters = found.drives[0].model.parameters
    return [{key: parameters[key] for key in found.space.keys}]


def with_labels(found: Problem, lanes: list[Any]) -> Problem:
    drives = tuple(
        replace(d, recorded=replace(d.recorded, truth=replace(d.truth, lane=lane)))
        for d, lane in zip(found.drives, lanes, strict=True)
    )
    return replace(found, drives=drives)


def scrambled(found: Problem, part: int, seed: int) -> Problem:
    """The labels of a block, and of the frames that are never fitted, at random."""
    rng = np.random.default_rng(seed)
    lanes = []
    for drive, seen in zip(found.drives, without_part(found, part)[1], strict=True):
        lane = drive.truth.lane.copy()
        lane[~seen] = rng.integers(1, drive.n_lanes + 1, size=(~seen).sum())
        lanes.append(lane)
    return with_labels(found, lanes)


@pytest.mark.parametrize("part", range(0, BLOCKS, 2))
@pytest.mark.parametrize("objective", ["accuracy", "log_loss", "share_missed"])
def test_nothing_of_a_block_influences_its_study(part: int, objective: str) -> None:
    trials = 90 if objective == "accuracy" else 35
    found = problem(trials=trials, objective=(objective,), never_fit=((1000, 1020), (1150, None)))
    honest = run_nested(found, part)
    for seed in (1, 2):
        assert run_nested(scrambled(found, part, seed), part) == honest
    seen = without_part(found, part)[1][0]
    upside = found.drives[0].truth.lane.copy()
    upside[seen] = found.drives[0].n_lanes + 1 - upside[seen]
    assert run_nested(with_labels(found, [upside]), part) != honest


def test_known_values_are_not_told_to_a_nested_study() -> None:
    found = problem(trials=5)
    current = found.drives[0].model.parameters
    same = replace(found.drives[0], model=replace(found.drives[0].model, parameters=current))
    other = replace(
        found.drives[0],
        model=replace(found.drives[0].model, parameters={**current, "sigma1": 0.123, "p1": 0.321}),
    )
    first = run_nested(replace(found, drives=(same,)), 0)
    assert run_nested(replace(found, drives=(other,)), 0) == first
    assert first.point != {key: current[key] for key in found.space.keys}


def test_the_stitched_belief_is_each_blocks_own() -> None:
    found = problem(trials=40)
    nested = [run_nested(found, b) for b in range(BLOCKS)]
    belief = beliefs_at(found, [n.point for n in nested])[0]
    for result, inside in zip(nested, blocks(len(belief), BLOCKS), strict=True):
        alone = beliefs_at(found, [result.point])[0]
        np.testing.assert_array_equal(belief[inside], alone[inside])
    assert len({str(n.point) for n in nested}) > 1


def frames_of(found: Problem, part: int) -> list[bool]:
    mask = np.zeros(len(found.drives[0]), dtype=bool)
    mask[blocks(len(mask), BLOCKS)[part]] = True
    return mask.tolist()


def test_what_a_study_may_look_at_is_neither_its_part_nor_untrusted() -> None:
    found = problem(never_fit=((1000, 1020), (1150, None)))
    ids = found.drives[0].truth.frame_id
    trusted = ~(((ids >= 1000) & (ids < 1020)) | (ids >= 1150))
    for part in range(BLOCKS):
        [seen] = without_part(found, part)[1]
        np.testing.assert_array_equal(seen, trusted & ~np.array(frames_of(found, part)))
    two = make_problem(two_drives(((0,), (1,)), never_fit=((1000, 1020), (1150, None))))
    smaller, [first] = without_part(two, 1)
    np.testing.assert_array_equal(first, trusted)
    assert smaller.drives == two.drives[:1]


def test_each_part_is_searched_for_with_a_seed_of_its_own() -> None:
    found = problem()
    seeds = {settings_of_part(found.settings, part).seed for part in range(BLOCKS)}
    assert len(seeds) == BLOCKS
    assert found.settings.seed not in seeds


def rejecting(found: Problem, below: float) -> Problem:
    """The same drives, answers of less than this rejected."""
    drives = tuple(
        replace(d, experiment=d.experiment.model_copy(update={"unassigned_below": below}))
        for d in found.drives
    )
    return replace(found, drives=drives)


def test_every_score_is_of_the_frames_that_are_kept_and_the_answers_that_are_given() -> None:
    found = rejecting(problem(), 0.8)
    [drive] = found.drives
    [belief] = beliefs_at(found, current(found))
    keep = np.arange(len(drive)) % 3 != 0
    truth, rows = drive.truth.take(keep), belief[keep]
    scores = assess([drive], [belief], [keep])
    right = score_all(rows, truth.lane, truth.is_crossing, truth.frame_id, 10, 0.8)
    assert truth.is_crossing.any()
    assert right["coverage"] < 0.99
    for name in ("accuracy", "precision", "recall", "f1", "log_loss", "brier"):
        assert scores[name] == pytest.approx(right[name]), name
    for name in ("confusion", "frames_scored"):
        assert scores[name] == right[name], name


def test_a_difference_is_the_first_less_the_second() -> None:
    found = rejecting(problem(), 0.8)
    [drive] = found.drives
    [belief] = beliefs_at(found, current(found))
    worse = 0.6 * belief + 0.4 / drive.n_lanes
    keep = all_used([drive])
    less = difference([drive], [belief], [worse], keep)
    one, other = (assess([drive], [b], keep) for b in (belief, worse))
    assert less["accuracy"] == one["accuracy"] - other["accuracy"] > 0
    assert less["log_loss"] == one["log_loss"] - other["log_loss"] < 0
    truth = drive.truth
    counts = [
        confusion_counts(assigned_lane(b, 0.8), truth.lane, truth.is_crossing, drive.n_lanes)
        for b in (belief, worse)
    ]
    right = bootstrap_interval(counts[:1], accuracy, minus=counts[1:])
    assert less["intervals"]["accuracy"] == pytest.approx([right.low, right.high])


def test_recordings_count_alike_and_each_is_resampled_by_itself() -> None:
    found = make_problem(two_drives())
    beliefs = beliefs_at(found, current(found))
    scores = assess(found.drives, beliefs, all_used(found.drives))
    each, drawn = [], []
    for seed, (drive, belief) in enumerate(zip(found.drives, beliefs, strict=True)):
        truth = drive.truth
        counts = confusion_counts(
            assigned_lane(belief), truth.lane, truth.is_crossing, drive.n_lanes
        )
        each.append(counts.sum(axis=0))
        resamples = circular_block_bootstrap(len(counts), seed=seed)
        drawn.append(accuracy(resampled_sums(counts, resamples)))
    assert scores["accuracy"] == pytest.approx(np.mean([accuracy(m) for m in each]))
    assert scores["frames_scored"] == sum(int(m.sum()) for m in each)
    bounds = np.quantile(np.mean(drawn, axis=0), [0.025, 0.975])
    assert scores["intervals"]["accuracy"] == pytest.approx(bounds.tolist())


def labelled(lane: np.ndarray, crossing: np.ndarray, **options: Any) -> Problem:
    found = problem(**options)
    [drive] = found.drives
    truth = replace(drive.truth, lane=lane, is_crossing=crossing)
    return replace(found, drives=(replace(drive, recorded=replace(drive.recorded, truth=truth)),))


def lacking(found: Problem) -> list[str]:
    return blocks_lacking_lanes(found.drives[0], found.plan.tuning.blocks)


@pytest.mark.parametrize("why", ["crossing", "never_fit"])
def test_frames_that_are_not_fitted_on_do_not_save_a_lane(why: str) -> None:
    """Lane 3 is in block 2, and else only where nothing is learned."""
    n_frames = len(problem().drives[0])
    lane = np.where(np.arange(n_frames) // 10 % 2, 1, 2)
    crossing = np.zeros(n_frames, dtype=bool)
    second, last = (blocks(n_frames, BLOCKS)[k][:20] for k in (1, -1))
    lane[second] = lane[last] = 3
    first_of_last = int(problem().drives[0].truth.frame_id[last[0]])
    options = {"never_fit": ((first_of_last, None),)} if why == "never_fit" else {}
    crossing[last] = why == "crossing"
    [note] = lacking(labelled(lane, crossing, **options))
    assert note.endswith("; no frame is left to fit on in lane 3 without block 2")
    [note] = lacking(labelled(lane, np.zeros(n_frames, dtype=bool)))
    assert "left to fit on" not in note


def two_drives(parts: tuple[tuple[int, ...], ...] = (), **options: Any) -> Plan:
    """Two drives that are searched on together; with parts those of a fleet."""
    one = plan(**options)
    other = one.experiments[0].model_copy(update={"name": "second"})
    object.__setattr__(
        other, "recording", other.recording.model_copy(update={"seed": other.recording.seed + 1})
    )
    second = replace(one, name="second", experiments=(other,))
    both = together([one, second])
    if parts:
        both = replace(both, fleet=Fleet(one.experiments[0], parts, ({}, {}), ("one", "second")))
    return with_options(both, options)


def test_a_whole_recording_is_held_out_without_being_seen() -> None:
    found = make_problem(two_drives(((0,), (1,)), trials=35))
    assert len(found.drives) == 2
    honest = run_nested(found, 1)
    rng = np.random.default_rng(0)
    drive = found.drives[1]
    lanes = [found.drives[0].truth.lane, rng.integers(1, drive.n_lanes + 1, size=len(drive))]
    assert run_nested(with_labels(found, lanes), 1) == honest
    nested = [run_nested(found, part) for part in (0, 1)]
    # Scores of the other recording alone: nothing of the one left out goes into their mean.
    seen = beliefs_at(found, [nested[1].point])[0]
    alone = assess(found.drives[:1], [seen], all_used(found.drives[:1]))
    assert nested[1].values == pytest.approx((alone["accuracy"],))
    beliefs = beliefs_at(found, [n.point for n in nested])
    np.testing.assert_array_equal(beliefs[0], beliefs_at(found, [nested[0].point])[0])
    np.testing.assert_array_equal(beliefs[1], beliefs_at(found, [nested[1].point])[1])

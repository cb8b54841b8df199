"""What a page's timeline shows, byte by byte, and its lists."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.page import lists
from egolane_pgm.page.document import page_of
from egolane_pgm.page.packed import BLANK, CERTAIN, CONTINUOUS, NOT_VALID, VALID, packed
from egolane_pgm.running import run_experiment
from egolane_pgm.types import InputError, LineLog
from tests.kits.drives import simulated
from tests.kits.tiny_result import IDS, MODEL, a_result, long_drive, without_truth


def some_lines() -> LineLog:
    """Two lines in every frame, and a third that is not valid in the first."""
    n = len(IDS)
    offset = np.tile([-1.8, 1.704, np.nan], (n, 1))
    offset[0, 2] = 5.0
    valid = np.tile([True, True, False], (n, 1))
    continuous = np.tile([True, False, False], (n, 1))
    ids = np.array(IDS)
    return LineLog(ids, ids / 10, offset, valid, continuous, np.full((n, 3), np.nan))


def test_a_short_drive_is_packed_frame_by_frame() -> None:
    pack = packed(a_result(lines=some_lines()))
    columns = pack.columns
    assert pack.frames_per_step == 1
    assert pack.step_s == pytest.approx(0.1)
    assert columns["id"].tolist() == IDS
    belief = np.stack([columns[f"b{k}"] for k in (1, 2, 3)], axis=1)
    assert np.abs(belief / CERTAIN - MODEL).max() <= 0.5 / CERTAIN
    assert columns["truth"].tolist() == [1, 1, 1, 2, 2, 2, 0]
    assert columns["model"].tolist() == [1, 1, 1, 2, 2, 3, 2]
    assert columns["first"].tolist() == [0, 3, 5, 7, 9, 11, 13]
    assert pack.lines["cm"].tolist() == [-180, 170, 500, *[-180, 170] * 6]
    assert pack.lines["kind"].tolist() == [
        *[CONTINUOUS, VALID, NOT_VALID],
        *[CONTINUOUS, VALID] * 6,
    ]


def test_a_long_drive_is_thinned_out_to_means_and_keeps_what_is_wrong() -> None:
    result = long_drive(1001)
    wrong = result.assigned_lane.copy()
    wrong[[7, 8, 500]] = 3
    pack = packed(replace(result, assigned_lane=wrong), max_steps=300)
    assert pack.frames_per_step == 4
    assert len(pack.columns["t"]) == 251
    assert pack.step_s == pytest.approx(0.4)
    # The means of [.1, .7, .2] and [.3, .5, .2] by turns; the last step is one frame alone.
    assert pack.columns["b1"][:-1].tolist() == [round(0.2 * CERTAIN)] * 250
    assert pack.columns["b1"][-1] == round(0.1 * CERTAIN)
    at = np.flatnonzero(pack.columns["model"] == 3)
    assert pack.columns["id"][at].tolist() == [7 + 5, 8 + 5, 500 + 5]


def test_a_lane_that_the_map_does_not_have_is_blank_unless_it_is_believed() -> None:
    believed = np.array(MODEL)
    believed[0] = [0.99, 0.0, 0.01]
    result = a_result(marginals={"Lane": believed}, road_lanes=np.full(len(IDS), 2))
    shown = packed(result).columns["b3"]
    assert shown[0] == BLANK
    assert (shown[1:] != BLANK).all()


def test_a_result_without_frames_is_refused() -> None:
    with pytest.raises(InputError, match="results/tiny: has no frames to show"):
        packed(a_result(frame_id=np.zeros(0, dtype=int)))


def test_the_worst_stretches_are_those_with_the_most_wrong_frames() -> None:
    result = run_experiment(simulated(evidence_reading="hard"))
    said, header, places = lists.worst_stretches(result)
    scored = (result.true_lane > 0) & ~result.is_crossing
    wrong = scored & (result.assigned_lane != result.true_lane)
    assert said.startswith(f"{wrong.sum()} of {scored.sum()} frames are wrong")
    assert len(header) == len(places[0].cells)
    counts = []
    for place in places:
        inside = (result.time_s >= place.begin_s) & (result.time_s <= place.end_s)
        counts.append(int((wrong & inside).sum()))
        assert place.cells[2] == f"{counts[-1]} of {inside.sum()}"
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > 0


def test_without_truth_the_least_sure_stretches_are_listed_and_nothing_is_scored() -> None:
    result = without_truth()
    said, _, places = lists.worst_stretches(replace(result, run={**result.run}))
    assert said.startswith("the belief is below 0.9 in 5 frames")
    assert places[0].begin_s == 10.1


def test_lane_changes_are_right_false_or_missed() -> None:
    result = run_experiment(simulated())
    found = lists.changes_of(result)
    within = result.scores["events"]["within"]["2"]
    outcomes = [change.outcome for change in found.told]
    assert outcomes.count(lists.RIGHT) == within["right"] > 0
    assert outcomes.count(lists.FALSE) == within["false"]
    assert sum(change.outcome == lists.MISSED for change in found.true) == within["missed"]
    assert len(found.true) == result.scores["events"]["changes"]
    listed = found.listed
    assert [c.begin_s for c in listed] == sorted(c.begin_s for c in listed)


def test_the_page_of_a_result_without_truth_has_no_scores_and_says_so() -> None:
    result = run_experiment(simulated())
    nothing = np.zeros(len(result.frame_id), dtype=np.int64)
    bare = replace(
        result,
        true_lane=nothing,
        is_crossing=nothing.astype(bool),
        scores={k: v for k, v in result.scores.items() if k not in ("model", "detector")}
        | {"events": {"told": 3}},
    )
    page, lacking = page_of([bare])
    assert "There is no ground truth, so there are beliefs and no scores." in page
    assert "Least sure stretches" in page
    assert lacking == []
    with_truth, _ = page_of([result])
    assert "There is no ground truth" not in with_truth
    assert f"{result.scores['model']['accuracy']:.3f}" in with_truth


def test_a_page_of_pictures_that_are_gone_says_so(tmp_path: Path) -> None:
    result = run_experiment(simulated())
    recording = {"detector": "ml", "path": str(tmp_path / "gone.mp4")}
    page, lacking = page_of([replace(result, config={"recording": recording})])
    assert lacking == [
        f"no pictures of the recording: {tmp_path / 'gone.mp4'}: no such video, folder or pictures"
    ]
    assert "no such video" in page

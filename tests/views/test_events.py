"""Lane changes as tables and lines of text."""

from __future__ import annotations

import numpy as np

from egolane_pgm.scoring.events import event_scores
from egolane_pgm.types import LaneEvents, LaneTruth
from egolane_pgm.views.events import (
    LISTED,
    event_comparison_rows,
    event_lines,
    event_rows,
    event_runs_rows,
    lane_words,
    sure_words,
)


def some(n: int, delay_s: np.ndarray | None = None) -> LaneEvents:
    frame = np.arange(n) * 100 + 50
    left = np.arange(n) % 2 + 1
    told = frame + 3
    return LaneEvents(
        told, told / 10, frame, frame / 10, left, 3 - left, 3 - 2 * left, np.full(n, 0.75), delay_s
    )


def test_a_change_is_a_row_and_long_drives_are_cut() -> None:
    header, rows = event_rows(some(2))
    assert header == ["time, s", "frame", "from", "to", "probability", "told, s", "late, s"]
    assert rows[1] == ["15.0", "150", "2", "1", "0.750", "15.3", "0.3"]
    assert len(event_rows(some(30))[1]) == LISTED


def test_with_truth_a_row_says_how_late_it_was_or_that_there_was_no_such_change() -> None:
    header, rows = event_rows(some(2, np.array([-0.4, np.nan])))
    assert header[-1] == "delay, s"
    assert [row[-1] for row in rows] == ["-0.4", "no change"]


def test_the_lane_over_time_is_said_in_words_and_long_drives_are_cut() -> None:
    lanes = [(3, 0.0, 71.6), (2, 71.6, 3700.2)]
    said = {"lanes": lanes, "sure": 0.9312}
    assert lane_words(said) == "lane 3 from 0:00 to 1:12, lane 2 from 1:12 to 1:01:40"
    assert sure_words(said) == "sure (a belief of at least 0.9) in 93.1 % of the frames"
    assert lane_words({"lanes": [(1, 0.04, 59.98)]}) == "lane 1 from 0:00.0 to 1:00.0"
    many = lane_words({"lanes": [(1, k, k + 1.0) for k in range(30)]})
    assert many.count("lane 1") == LISTED
    assert many.endswith(", and 20 more in events.csv")
    assert lane_words({"lanes": []}) == "no lane is believed (at least 0.67) in any frame"


def test_scores_are_said_in_words_and_a_row() -> None:
    lane = np.repeat([1, 2], [55, 60])
    crossing = (np.arange(115) >= 45) & (np.arange(115) < 65)
    truth = LaneTruth(np.arange(115), lane, crossing)
    scores = event_scores(some(1), crossing * 0.9, truth, 10.0)
    said = "\n".join(event_lines(scores))
    assert "1 true lane changes, 1 told" in said
    assert "within 0.5 s: precision 1.000, recall 1.000, 0.0 false an hour" in said
    assert "delay from the end of the crossing: -1.2 s (median)" in said
    assert "1 of 1 changes warned of, 1.0 s (median) before the label changes" in said
    unseen = event_scores(some(1), None, truth, 10.0)
    assert "on a line" not in "\n".join(event_lines(unseen))
    runs = [{"name": "a", "events": scores}, {"name": "b", "events": unseen}]
    header, rows = event_runs_rows([*runs, {"name": "c", "events": {"told": 7}}])
    assert {len(row) for row in rows} == {len(header)}
    assert dict(zip(header, rows[0], strict=True))["lead median"] == "1.0"
    assert rows[1][-1] == "-"
    assert rows[2][1:4] == ["", "7", ""]


def test_an_experiment_on_one_recording_has_no_row_for_all() -> None:
    truth = LaneTruth(np.arange(9), np.ones(9, dtype=int), np.zeros(9, dtype=bool))
    entry = {"name": "x", "events": {"all_frames": event_scores(some(0), None, truth, 10.0)}}
    _, rows = event_comparison_rows({"recordings": [{"title": "a", "experiments": [entry]}]})
    assert [row[0] for row in rows] == ["a"]

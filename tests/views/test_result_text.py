"""The texts of results, of tables of runs, and of comparisons."""

from __future__ import annotations

import pandas as pd
import pytest

from egolane_pgm.comparing import compare
from egolane_pgm.result import Result, score
from egolane_pgm.runs import open_input, run_input, run_table, table_inputs
from egolane_pgm.views.comparisons import comparison_text
from egolane_pgm.views.events import LISTED, clock, event_table, segments_text
from egolane_pgm.views.result_text import runs_text
from tests.kits.drives import simulated
from tests.kits.tiny_result import RUN, a_result, without_truth


@pytest.fixture(scope="module")
def result() -> Result:
    return run_input(open_input("quickstart", overrides={"recording.frames": [0, 300]}))


def test_the_text_of_a_result_starts_with_the_score(result: Result) -> None:
    lines = result.to_text().splitlines()
    assert lines[0] == "quickstart: right in 87.7 % of 260 frames, detector alone 55.8 %"
    assert lines[1] == "300 frames, 4 lanes, causal; parameters: not tuned"
    assert lines[2].startswith("lane changes: 2 annotated, 2 reported; within 1 s recall 1.00")
    assert lines[-1] == "all scores and confusion matrices: scores.json or --format wide"
    assert len(lines) < 25
    assert max(map(len, lines)) <= 80
    wide = result.to_text(style="wide")
    for words in ("| accuracy ", "| support ", "2 true lane changes, 2 reported:", "of the frames"):
        assert words in wide
    assert result.to_text(style="csv").splitlines()[0] == "score,detector,model"
    assert result.to_text(style="latex").count(r"\begin{tabular}") == 4


def test_without_ground_truth_it_has_the_lane_over_time(result: Result) -> None:
    text = run_input(open_input(result.experiment, ground_truth="none")).to_text()
    assert text.startswith("quickstart: lane 4 from 0:00")
    assert "most probable at the end: lane " in text
    assert "; no ground truth, no scores" in text
    assert "--format wide" not in text


def event_frame(n: int) -> pd.DataFrame:
    frame = range(50, 50 + 100 * n, 100)
    events = pd.DataFrame({"frame_id": frame, "from_lane": 2, "to_lane": 1, "direction": -1})
    events["time_s"], events["probability"] = events["frame_id"] / 10, 0.75
    events["detected_time_s"] = events["time_s"] + 0.3
    return events


def test_a_lane_change_is_a_row() -> None:
    found = event_table(event_frame(2))
    assert found.header == ["time, s", "frame", "from", "to", "probability", "detected, s"]
    assert found.rows[1] == ["15.0", "150", "2", "1", "0.750", "15.3"]
    found = event_table(event_frame(2).assign(delay_s=[-0.4, None], from_lane=[2, 0]))
    assert [row[-1] for row in found.rows] == ["-0.4", "no change"]
    assert found.rows[1][2:5] == ["?", "left", "-"]


def test_the_lane_over_time_in_words() -> None:
    segments = [(3, 0.0, 71.6), (0, 71.6, 3700.2)]
    assert segments_text(segments) == (
        "lane 3 from 0:00.0 to 1:11.6, lane unknown from 1:11.6 to 1:01:40.2"
    )
    assert segments_text([(1, k, k + 1.0) for k in range(30)]).endswith(f", and {30 - LISTED} more")
    assert segments_text([]) == "no lane has a probability of at least 0.67 in any frame"
    assert clock(59.98) == "1:00.0"
    assert clock(1.5e9 + 1) == "2:40:01.0"


def test_a_table_of_runs_and_a_comparison_have_a_row_each(tmp_path: object) -> None:
    rows = pd.DataFrame(
        {
            "name": ["a", "b", "c"],
            "parameters.sigma1": [0.2, 0.4, -1],
            "tag.driver": ["x", "y", "y"],
        }
    )
    keys = {"simulate": "quickstart", "frames": [0, 400]}
    summary = run_table(table_inputs(simulated(recording=keys), rows), str(tmp_path))
    text = runs_text(summary, "wide")
    assert text.startswith("| name | driver |")
    assert "sigma1" in text, "the reason of the failure"
    assert len(runs_text(summary, "csv").splitlines()) == 4
    compared = compare(f"{tmp_path}", of="tag.driver", detector=True)
    text = comparison_text(compared, "markdown")
    for words in ("| accuracy ", "| F1 ", "| log-loss ", "| detector alone ", "lane changes"):
        assert words in text
    assert max(map(len, text.splitlines())) <= 80
    header = comparison_text(compared, "csv").splitlines()[0]
    assert header.startswith("tag.driver,recordings,accuracy,accuracy_low,accuracy_high,")


def test_several_drives_have_a_row_each() -> None:
    for tiny, column in ((a_result(), "accuracy"), (without_truth(), "lane at the end")):
        frames = pd.concat([tiny.frames.assign(drive=name) for name in ("one", "two")])
        run = {**RUN, "frames": len(frames), "is_causal": True, "why_not_causal": []}
        text = a_result(frames=frames, run=run, scores=score(frames, 10.0)).to_text()
        header = next(line for line in text.splitlines() if line.startswith("| drive | frames |"))
        assert column in header
        assert "| two   |      7 |" in text

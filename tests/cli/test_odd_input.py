"""What is odd but usable, through the command line: kept, counted, and said in one warning."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.results import read_result
from tests.kits.bags import GOOD, Line, line_bag, truth_file
from tests.kits.drives import done, write_experiment


def kept(folder: Path, recording: Path, *words: object, **changes: Any) -> tuple[list[str], Path]:
    """The warnings of a run that ends well, and its result directory."""
    experiment = write_experiment(
        folder / "e.yaml", recording__path=recording.name, ground_truth=None, **changes
    )
    out = folder / "out"
    words = ("--no-figures", "--out", out, *words)
    ran = done("run", experiment, *words, "--json", folder / "out.json")
    lines = ran.stderr.splitlines()
    assert all(line.startswith("warning: ") for line in lines)
    said = [line.removeprefix("warning: ") for line in lines]
    assert json.loads((folder / "out.json").read_text())["warnings"] == said
    assert read_result(out).run["warnings"] == said
    return said, out


def test_an_odd_reliability_is_used_as_recorded_and_clipped_on_request(tmp_path: Path) -> None:
    odd: list[list[Line]] = [
        [(True, False, 25, -5.0), (True, False, 10, 1.7)],
        [(True, False, -3, -5.0), (True, False, 10, 1.7), (False, False, -1, 0.0)],
    ]
    line_bag(tmp_path / "a.bag", [1, 2], odd)
    said, _ = kept(tmp_path, tmp_path / "a.bag")
    assert len(said) == 1
    assert "2 valid line(s) have an LRI outside 0..10, first in frame 1" in said[0]
    assert "as recorded" in said[0]
    as_recorded = sensor_ok(tmp_path)
    said, _ = kept(tmp_path, tmp_path / "a.bag", recording__lri="clip")
    assert said == []
    clipped = sensor_ok(tmp_path)
    # 25 + 10 of 40 against 10 + 10 of 40 in frame 1, 7 against 10 of 40 in frame 2.
    assert clipped[0] < as_recorded[0]
    same: list[list[Line]] = [
        [(True, False, 10, -5.0), (True, False, 10, 1.7)],
        [(True, False, 0, -5.0), (True, False, 10, 1.7)],
    ]
    line_bag(tmp_path / "b.bag", [1, 2], same)
    kept(tmp_path, tmp_path / "b.bag")
    np.testing.assert_array_equal(sensor_ok(tmp_path), clipped)


def sensor_ok(folder: Path) -> np.ndarray:
    return read_result(folder / "out").marginals["SensorState"][:, 0]


def test_absurd_offsets_of_invalid_lines_change_nothing(tmp_path: Path) -> None:
    absurd: list[Line] = [(False, True, 5, 3e32), (False, False, 0, float("nan"))]
    line_bag(tmp_path / "a.bag", [1, 2], [[*GOOD[0], *absurd], [*GOOD[1], absurd[0]]])
    said, out = kept(tmp_path, tmp_path / "a.bag")
    assert len(said) == 1
    assert "3 line(s) that are not valid have an offset beyond 100 m or NaN" in said[0]
    with_absurd = read_result(out).marginals["Lane"]
    line_bag(tmp_path / "b.bag", [1, 2], GOOD[:2])
    said, out = kept(tmp_path, tmp_path / "b.bag")
    assert said == []
    np.testing.assert_array_equal(read_result(out).marginals["Lane"], with_absurd)


def test_more_valid_lines_than_a_road_has_are_counted(tmp_path: Path) -> None:
    many: list[Line] = [(True, False, 2, d) for d in (-9.0, -5.0, -2.0, 2.0, 5.0)]
    line_bag(tmp_path / "a.bag", [1, 2, 3], [GOOD[0], many, GOOD[0]])
    said, out = kept(tmp_path, tmp_path / "a.bag")
    assert len(said) == 1
    assert "1 frame(s) have more valid lines than the 4 of 3 lane(s), first frame 2" in said[0]
    assert len(read_result(out).frame_id) == 3


@pytest.mark.parametrize("is_empty", [True, False])
def test_without_a_single_valid_line_the_belief_stays_what_the_model_says(
    tmp_path: Path, is_empty: bool
) -> None:
    lines: list[Line] = [] if is_empty else [(False, True, 5, -1.0)]
    line_bag(tmp_path / "a.bag", list(range(1, 9)), [lines] * 8)
    # Over three lanes the lane dynamics by themselves favour the middle one.
    wide: dict[str, Any] = {"sigma1": 2.0, "no_valid_line": "ignore"}
    said, out = kept(tmp_path, tmp_path / "a.bag", parameters=wide)
    assert len(said) == 1
    assert "not a single valid line in 8 frames" in said[0]
    result = read_result(out)
    centres = np.arange(1, 4)
    f = np.exp(-0.5 * ((centres[None] - centres[:, None]) / 2.0) ** 2)
    f /= f.sum(axis=1, keepdims=True)
    expected = np.full(3, 1 / 3)
    for belief in result.marginals["Lane"]:
        np.testing.assert_allclose(belief, expected, rtol=0, atol=1e-12)
        expected = belief @ f
    assert (result.detector_lane == 0).all()


def test_frames_of_zero_joint_likelihood_keep_their_prediction_and_are_counted(
    tmp_path: Path,
) -> None:
    # A frame that says lane 1 for certain, and one that says lane 3, where no lane ever changes
    # and the detector is never wrong.
    left: list[Line] = [(True, True, 10, -1.0)]
    right: list[Line] = [(True, True, 10, 1.0)]
    line_bag(tmp_path / "a.bag", [1, 2, 3], [left, right, left])
    certain = {"sigma1": 1e-9, "sigma2": 1e-9, "tentative_noise": 0}
    said, out = kept(tmp_path, tmp_path / "a.bag", graph="lane_only", parameters=certain)
    assert len(said) == 1
    assert "the evidence of 1 frame(s) has joint likelihood zero" in said[0]
    result = read_result(out)
    np.testing.assert_array_equal(result.is_impossible, [False, True, False])
    np.testing.assert_allclose(result.marginals["Lane"], [[1, 0, 0]] * 3)
    assert result.run["impossible_frames"] == 1
    assert result.run["mean_log_evidence"] == pytest.approx(result.log_evidence[[0, 2]].mean())


def test_frames_without_ground_truth_are_filtered_and_said(tmp_path: Path) -> None:
    line_bag(tmp_path / "a.bag", [1, 2, 3, 4])
    truth_file(tmp_path / "ground_truth.txt", [(2, 1, 0), (3, 1, 1), (9, 1, 0)])
    experiment = write_experiment(tmp_path / "e.yaml", recording__path="a.bag")
    ran = done("run", experiment, "--no-figures", "--out", tmp_path / "out")
    assert ran.stderr.count("warning") == 1
    assert "2 of 4 frames have no ground truth; filtered, not scored" in ran.stderr
    result = read_result(tmp_path / "out")
    np.testing.assert_array_equal(result.true_lane, [0, 1, 1, 0])
    np.testing.assert_array_equal(result.is_crossing, [False, False, True, False])
    assert result.run["frames"] == 4
    assert result.run["frames_scored"] == 1


def test_columns_that_are_ignored_are_said_in_one_plain_line(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("frame_id,line,offset_m,colour,speed\n1,1,1.5,red,3\n")
    ran = done("convert", tmp_path / "a.csv", tmp_path / "b.csv")
    lines = ran.stderr.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(f"warning: {tmp_path / 'a.csv'}: ignored column(s) colour, speed")


def test_one_lane_is_allowed(tmp_path: Path) -> None:
    line_bag(tmp_path / "a.bag", [1, 2], [[(True, True, 8, -1.7)], [(True, False, 8, 1.7)]])
    truth_file(tmp_path / "ground_truth.txt", [(1, 1, 0), (2, 1, 0)])
    for graph in ("sensor_failure", "wor_on_lane", "no_wor", "lane_only"):
        experiment = write_experiment(
            tmp_path / "e.yaml", recording__path="a.bag", n_lanes=1, graph=graph
        )
        ran = done("run", experiment, "--no-figures", "--out", tmp_path / "out")
        assert ran.stderr == ""
        result = read_result(tmp_path / "out")
        np.testing.assert_array_equal(result.marginals["Lane"], [[1.0], [1.0]])
        np.testing.assert_array_equal(result.assigned_lane, [1, 1])
        assert result.scores["model"]["accuracy"] == 1

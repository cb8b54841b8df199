"""Stored results side by side."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from egolane_pgm.comparing.stored import compare_results
from egolane_pgm.experiment import load_experiment
from egolane_pgm.results import Result, read_result
from egolane_pgm.running import run_experiment
from egolane_pgm.scoring.bootstrap import score_counts, score_intervals
from egolane_pgm.types import InputError
from tests.kits.drives import done, refused, simulated


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("stored")
    one = simulated()
    other = load_experiment(one, {"parameters.sigma1": 0.2})
    return [
        run_experiment(each).save(folder / name, figures=False)
        for each, name in ((one, "one"), (other, "other"))
    ]


def test_stored_results_are_scored_as_they_were_and_differ_by_paired_intervals(
    stored: list[Path],
) -> None:
    one, other = results = [read_result(each) for each in stored]
    found = compare_results(results)
    for result, entry in zip(results, found["results"], strict=True):
        assert entry["scores"] == result.scores["model"]
    assert found["results"][0]["difference"] == {}
    counts = [
        score_counts(
            r.marginals["Lane"][r.true_lane > 0],
            r.true_lane[r.true_lane > 0],
            r.is_crossing[r.true_lane > 0],
        )
        for r in (other, one)
    ]
    known = score_intervals(counts[:1], counts[1:])["accuracy"]
    assert known is not None
    difference = found["results"][1]["difference"]["accuracy"]
    assert difference == [known.estimate, known.low, known.high]
    of = [r.scores["model"]["accuracy"] for r in (other, one)]
    assert difference[0] == pytest.approx(of[0] - of[1])


def test_the_command_compares_result_directories(stored: list[Path], tmp_path: Path) -> None:
    ran = done("compare", *stored, "--wide", "--json", tmp_path / "x.json")
    assert str(stored[1]) in ran.stdout
    assert "accuracy - first" in ran.stdout
    assert len(json.loads((tmp_path / "x.json").read_text())["results"]) == 2
    assert "needs two result directories" in refused("compare", stored[0])
    assert "--runs: goes with experiments" in refused("compare", *stored, "--runs", "1")
    assert "is not a result directory" in refused("compare", stored[0], tmp_path)


def test_results_of_other_frames_are_refused_with_both_ranges(stored: list[Path]) -> None:
    one: Result = read_result(stored[0])
    late = replace(one, frame_id=one.frame_id + 5)
    first, last = one.frame_id[one.true_lane > 0][[0, -1]]
    with pytest.raises(InputError) as caught:
        compare_results([one, late])
    assert f"from {first} to {last}" in str(caught.value)
    assert f"from {first + 5} to {last + 5}" in str(caught.value)
    without = replace(one, true_lane=np.zeros_like(one.true_lane))
    with pytest.raises(InputError, match="has no ground truth"):
        compare_results([one, without])

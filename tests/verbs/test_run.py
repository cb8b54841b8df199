"""The command `egolane run`, on experiments and on lines."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from egolane_pgm.result import Result, load_result
from tests.kits.bags import Line, line_bag, truth_file
from tests.kits.drives import (
    N_FRAMES,
    command,
    contents,
    done,
    refused,
    rewritten,
    run,
    run_json,
    write_drive,
    write_experiment,
)

ROOT = Path(__file__).parents[2]


def kept(folder: Path, recording: Path, **changes: Any) -> tuple[list[str], Result]:
    """The warnings of a run of a recording without ground truth, and its result."""
    experiment = write_experiment(
        folder / "e.yaml", recording__path=recording.name, ground_truth=None, **changes
    )
    out = folder / f"out_{recording.stem}"
    ran = done("run", experiment, "--no-figures", "--out", out)
    output = [line.removeprefix("warning: ") for line in ran.stderr.splitlines()]
    found = load_result(out)
    assert found.notes == output
    return output, found


# --- what is written and printed -----------------------------------------------------------------


def test_run_writes_its_numbers_unrounded_and_prints_the_scores(
    drive: Path, tmp_path: Path
) -> None:
    output = run_json(drive, tmp_path)
    right = run(drive)
    assert output["scores"] == json.loads(json.dumps(right.scores))
    provenance = {"seconds", "created"}
    for key in right.run.keys() - provenance:
        assert output["run"][key] == json.loads(json.dumps(right.run[key])), key  # type: ignore[index]
    out = tmp_path / "out"
    assert json.loads((out / "scores.json").read_text()) == output["scores"]
    ran = done("run", drive, "--no-figures", "--out", out)
    share = f"right in {100 * right.scores['model']['accuracy']:.1f} % of"
    assert ran.stdout.startswith(f"drive: {share}")
    assert f"{N_FRAMES} frames, 3 lanes, causal; parameters: not tuned" in ran.stdout
    assert ran.stdout.endswith(f"result: {out}\n")
    assert ran.stderr.splitlines() == [f"warning: {note}" for note in right.notes]


def test_lines_are_run_with_the_model_of_an_experiment(drive: Path, tmp_path: Path) -> None:
    lines, truth = drive.with_name("lines.csv"), drive.with_name("ground_truth.txt")
    words = ("--experiment", drive, "--n-lanes", 3, "--set", "filter=exact")
    scored = run_json(lines, tmp_path, *words, "--ground-truth", truth)
    same = run(drive, {"filter": "exact"})
    assert scored["scores"] == json.loads(json.dumps(same.scores))
    shown = done("run", lines, *words, "--no-figures", "--out", tmp_path / "out").stdout
    assert "most probable at the end: lane " in shown
    assert "no ground truth, no scores" in shown
    found = load_result(tmp_path / "out")
    assert found.truth is None
    assert (found.experiment.filter, found.experiment.graph) == ("exact", "sensor_failure")
    assert found.experiment.recording.path == str(lines)


def test_a_figure_is_part_of_the_result(drive: Path, tmp_path: Path) -> None:
    done("run", drive, "--out", tmp_path / "out")
    assert [path.name for path in (tmp_path / "out" / "figures").iterdir()] == ["strips.png"]


def test_lane_changes_are_printed_with_their_scores(tmp_path: Path) -> None:
    path, out = write_drive(tmp_path, 2400), tmp_path / "out"
    shown = done("run", path, "--no-figures", "--out", out).stdout
    events = (out / "events.csv").read_text().splitlines()[1:]
    scores = load_result(out).scores["events"]
    assert scores["detected"] == len(events) > 10
    assert f"lane changes: {scores['changes']} annotated, {len(events)} reported;" in shown
    blind = done("run", path, "--ground-truth", "none", "--no-figures", "--out", out).stdout
    assert f"lane changes: {len(events)} reported" in blind
    assert len((out / "events.csv").read_text().splitlines()) == len(events) + 1


def test_chunks_and_held_out_blocks_have_options(drive: Path, tmp_path: Path) -> None:
    whole, chunked = run_json(drive, tmp_path), run_json(drive, tmp_path, "--chunk-frames", 40)
    assert chunked["scores"] == whole["scores"]
    shown = done(
        "run", drive, "--held-out", "--set", "fit.folds=3", "--no-figures", "--out", tmp_path / "o"
    )
    assert "held out, 3 blocks; fit.method: none" in shown.stdout
    assert load_result(tmp_path / "o").frames["block"].nunique() == 3


# --- a table of runs -----------------------------------------------------------------------------


def test_a_table_is_run_row_by_row_and_resumed(drive: Path, tmp_path: Path) -> None:
    table, out = tmp_path / "runs.csv", tmp_path / "out"
    table.write_text("name,parameters.sigma1,tag.driver\na,0.3,ann\nb,0.5,bob\n")
    words = ("run", drive, "--table", table, "--out", out)
    assert done(*words).stdout.endswith(f"results: 2 of 2 in {out}, 0 were there\n")
    assert (out / "summary.parquet").is_file()
    assert load_result(out / "a").run["tags"] == {"driver": "ann"}
    before = contents(out / "a")
    with table.open("a") as file:
        file.write("c,0.7,ann\n")
    # A row whose result was interrupted while it was written.
    (out / "c").mkdir()
    (out / "c" / "beliefs.parquet").touch()
    rows = json.loads(done(*words, "--json", "-").stdout)["rows"]
    assert [(row["name"], row["was_there"]) for row in rows] == [
        ("a", True), ("b", True), ("c", False),
    ]  # fmt: skip
    assert contents(out / "a") == before


def test_a_row_that_fails_does_not_stop_the_others(drive: Path, tmp_path: Path) -> None:
    table, out = tmp_path / "runs.csv", tmp_path / "out"
    lines, broken = drive.with_name("lines.csv"), tmp_path / "broken.csv"
    broken.write_text("these are no lines\n")
    table.write_text(f"name,recording.path\ngood,{lines}\nbad,{broken}\n")
    ran = command("run", drive, "--table", table, "--out", out)
    assert ran.exit_code == 1
    [line] = [line for line in ran.stderr.splitlines() if line.startswith("failed")]
    assert line.startswith(f"failed: bad: {broken}: ")
    assert f"results: 1 of 2 in {out}, 0 were there" in ran.stdout
    assert (out / "good" / "run.json").is_file()
    assert not (out / "bad").exists()


def test_a_dry_run_of_a_table_checks_each_row(drive: Path, tmp_path: Path) -> None:
    table = tmp_path / "runs.csv"
    table.write_text("name,n_lanes\na,2\nb,4\n")
    shown = done("run", drive, "--table", table, "--out", tmp_path / "out", "--dry-run").stdout
    assert ["2 lanes" in line or "4 lanes" in line for line in shown.splitlines()] == [True, True]
    assert not (tmp_path / "out").exists()


# --- what is refused -----------------------------------------------------------------------------


def bag(*ids: int, truth: Sequence[tuple[int, int, int]] = ()) -> Callable[[Path], object]:
    """Writes a.bag with these frames, and its ground truth."""

    def write(folder: Path) -> None:
        line_bag(folder / "a.bag", list(ids))
        truth_file(folder / "ground_truth.txt", list(truth) or [(k, 1, 0) for k in ids])

    return write


def half_a_bag(folder: Path) -> None:
    whole = line_bag(folder / "a.bag", [1, 2, 3]).read_bytes()
    (folder / "a.bag").write_bytes(whole[: len(whole) // 2])


@pytest.mark.parametrize(
    ("make", "name", "words", "message"),
    [
        (half_a_bag, "a.bag", "", "a.bag: cannot be read as a bag ("),
        (bag(1), "gone.bag", "", "recording.path: {folder}/gone.bag: no such file"),
        (bag(3, 4), "a.bag", "--set recording.frames=[10,20]", "no frame from 10 to before 20;"),
        (bag(1, 2, truth=[(2, 4, 0)]), "a.bag", "", "ground_truth.txt: frame 2: lane 4 is outside"),
        (bag(1, 2, truth=[(9, 1, 0)]), "a.bag", "", "no common frames: "),
        (bag(1), "a.bag", "--ground-truth gone.txt", "gone.txt: no such file"),
        (
            bag(1),
            "a.bag",
            "--held-out --set fit.folds=7",
            "folds: 7 is not between 2 and the 1 frames",
        ),
        (bag(1), "a.bag", "--chunk-frames 0", "'--chunk-frames'"),
        (bag(1), "a.bag", "--chunk-frames 9 --set filter=smoothed", "needs the whole drive"),
        (bag(1), "a.bag", "--table gone.csv", "gone.csv: cannot be read as a table"),
    ],
)
def test_what_does_not_fit_is_refused_and_nothing_is_written(
    tmp_path: Path, make: Callable[[Path], object], name: str, words: str, message: str
) -> None:
    make(tmp_path)
    experiment = write_experiment(tmp_path / "e.yaml", recording__path=name)
    line = refused("run", experiment, "--no-figures", "--out", tmp_path / "x", *words.split())
    assert message.format(folder=tmp_path) in line
    assert not (tmp_path / "x").exists()


def test_the_result_of_another_drive_is_not_replaced(tmp_path: Path) -> None:
    one, other = write_drive(tmp_path / "one", 20), write_drive(tmp_path / "other", 20)
    out = tmp_path / "out"
    done("run", one, "--no-figures", "--out", out)
    before = contents(out)
    line = refused("run", other, "--no-figures", "--out", out)
    assert line.startswith(f"--out: {out} has the result of another recording, {tmp_path}/one/")
    assert contents(out) == before
    done("run", one, "--set", "filter=exact", "--no-figures", "--out", out)
    for damaged in ("no JSON", "[]", "{}", '{"config": {"recording": "x"}}'):
        (out / "run.json").write_text(damaged)
        done("run", other, "--no-figures", "--out", out)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("n_lane=3", "unknown key 'n_lane' (did you mean 'n_lanes'?)"),
        ("parameters.p1=1.3", "parameters.p1: 1.3 is not a probability (0 to 1)"),
        ("recording.frames=[9,3]", "recording.frames: [9, 3] is an empty range"),
    ],
)
def test_a_key_that_does_not_fit_is_refused_by_dry_run_and_by_run(
    tmp_path: Path, override: str, message: str
) -> None:
    experiment = write_drive(tmp_path, 20)
    by_dry_run = refused("run", "--dry-run", experiment, "--set", override)
    assert refused("run", experiment, "--set", override, "--out", tmp_path / "x") == by_dry_run
    assert by_dry_run.startswith(f"{experiment}: ")
    assert message in by_dry_run
    # The same written in the file.
    key, _, value = override.partition("=")
    changes = {key.replace(".", "__"): yaml.safe_load(value)}
    rewritten(experiment, experiment, **changes)
    assert message in refused("run", "--dry-run", experiment)


@pytest.mark.parametrize("what", ["--out", "--json"])
def test_a_place_that_cannot_be_written_is_refused_before_anything_is_computed(
    tmp_path: Path, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = write_drive(tmp_path, 20)
    before = contents(tmp_path)
    monkeypatch.setattr("egolane_pgm.runs.run_input", lambda *a, **k: pytest.fail("computed"))
    below_a_file = experiment / "below" / "result"
    words = ("run", experiment, "--no-figures")
    if what == "--json":
        words = (*words, "--out", tmp_path / "out")
        assert refused(*words, what, experiment) == f"{experiment}: is read here; name another file"
    output = f"cannot be written, {experiment} is not a writable directory"
    assert output in refused(*words, what, below_a_file)
    assert contents(tmp_path) == before


# --- recordings with oddities --------------------------------------------------------------------


def test_a_recording_without_a_valid_line_has_a_warning(tmp_path: Path) -> None:
    line_bag(tmp_path / "a.bag", list(range(1, 9)), [[(False, True, 5, -1.0)]] * 8)
    output, found = kept(tmp_path, tmp_path / "a.bag")
    assert len(output) == 1
    assert "not a single valid line in 8 frames" in output[0]
    assert (found.frames["detector_lane"] == 0).all()


def test_frames_of_zero_joint_likelihood_have_a_warning(tmp_path: Path) -> None:
    # A frame that is lane 1 for certain, and one that is lane 3, where no lane ever changes and
    # the detector is never wrong.
    left: list[Line] = [(True, True, 10, -1.0)]
    right: list[Line] = [(True, True, 10, 1.0)]
    line_bag(tmp_path / "a.bag", [1, 2, 3], [left, right, left])
    certain = {"sigma1": 1e-9, "sigma2": 1e-9, "tentative_noise": 0}
    output, found = kept(tmp_path, tmp_path / "a.bag", graph="lane_only", parameters=certain)
    assert len(output) == 1
    assert "the evidence of 1 frame(s) has joint likelihood zero" in output[0]
    assert found.frames["is_impossible"].to_list() == [False, True, False]
    assert found.scores["impossible_frames"] == 1


def test_one_lane_is_allowed(tmp_path: Path) -> None:
    line_bag(tmp_path / "a.bag", [1, 2], [[(True, True, 8, -1.7)], [(True, False, 8, 1.7)]])
    for graph in ("sensor_failure", "wor_on_lane", "no_wor", "lane_only"):
        output, found = kept(tmp_path, tmp_path / "a.bag", n_lanes=1, graph=graph)
        assert output == []
        np.testing.assert_array_equal(found.node("Lane"), [[1.0], [1.0]])
        assert found.frames["assigned_lane"].to_list() == [1, 1]

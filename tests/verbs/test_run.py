"""The command `egolane run`."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from egolane_pgm.results import read_result

from egolane_pgm.experiment import Experiment
from egolane_pgm.running import run_experiment
from egolane_pgm.views.events import clock
from tests.kits.bags import GOOD, Line, line_bag, truth_file
from tests.kits.drives import (
    N_FRAMES,
    command,
    contents,
    done,
    refused,
    rewritten,
    run_json,
    short_drive,
    write_drive,
    write_experiment,
)

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An earlier result, which no refused command may touch."""
    folder = tmp_path_factory.mktemp("earlier")
    done("run", write_drive(folder), "--no-figures", "--out", folder / "result")
    return folder / "result"


@pytest.fixture
def earlier(result: Path) -> Iterator[Path]:
    before = contents(result.parent)
    yield result
    assert contents(result.parent) == before, "a refused command changed an earlier result"


def run_on(folder: Path, recording: Path, earlier: Path, *words: object) -> str:
    """What `egolane run` says when it refuses a recording, its result named as the earlier one."""
    experiment = write_experiment(folder / "e.yaml", recording__path=recording.name)
    return refused("run", experiment, "--no-figures", "--out", earlier, *words)


def kept(folder: Path, recording: Path, *words: object, **changes: Any) -> tuple[list[str], Path]:
    """The warnings of a run that ends well, and its result directory."""
    experiment = write_experiment(
        folder / "e.yaml", recording__path=recording.name, ground_truth=None, **changes
    )
    out = folder / "out"
    words = ("--no-figures", "--out", out, *words)
    ran = done("run", experiment, *words, "--json", folder / "out.json")
    lines = ran.stderr.splitlines()
    assert all(line.startswith(("warning: ", "note: ")) for line in lines)
    said = [line.removeprefix("warning: ") for line in lines]
    assert json.loads((folder / "out.json").read_text())["warnings"] == said
    assert read_result(out).run["warnings"] == said
    return said, out


def test_run_writes_the_documented_json_unrounded_and_prints_the_scores(
    drive: Path, tmp_path: Path
) -> None:
    said = run_json(drive, tmp_path)
    assert set(said) == {
        "schema_version",
        "name",
        "tuned_on",
        "is_causal",
        "causal",
        "why_not_causal",
        "n_lanes",
        "frames",
        "frames_scored",
        "mean_log_evidence",
        "impossible_frames",
        "warnings",
        "detector",
        "model",
        "sure",
        "lanes",
        "events",
    }
    right = run_experiment(drive)
    assert said["schema_version"] == 1
    assert said["frames"] == N_FRAMES
    assert said["mean_log_evidence"] == right.beliefs.mean_log_evidence
    for kind in ("detector", "model"):
        block = said[kind]
        assert isinstance(block, dict)
        assert {"precision", "recall", "f1", "accuracy", "log_loss", "confusion"} <= set(block)
        assert block == right.scores[kind]
        assert block["frames_scored"] == said["frames_scored"]
    saved = json.loads((tmp_path / "out" / "scores.json").read_text())
    assert saved == said
    ran = done("run", drive, "--no-figures", "--out", tmp_path / "out")
    assert f"drive: {N_FRAMES} frames, 3 lanes, graph sensor_failure" in ran.stdout
    assert f"| accuracy {'':>13} | {right.scores['detector']['accuracy']:>8.3f} |" in ran.stdout
    assert "parameters: not tuned" in ran.stdout
    assert ran.stdout.endswith(f"result: {tmp_path / 'out'}\n")
    assert ran.stderr.splitlines() == [f"warning: {note}" for note in right.notes]


def test_set_overrides_keys_of_the_yaml(drive: Path, tmp_path: Path) -> None:
    said = run_json(drive, tmp_path, "--set", "parameters.bonus_value=0", "--set", "filter=exact")
    experiment = read_result(tmp_path / "out").config
    assert experiment["parameters"]["bonus_value"] == 0
    assert experiment["filter"] == "exact"
    assert said["detector"] != run_json(drive, tmp_path)["detector"]


def test_a_recording_of_ones_own_runs_without_any_ground_truth(drive: Path, tmp_path: Path) -> None:
    recording = drive.parent / "lines.csv"
    words = ("--recording", recording, "--n-lanes", 3)
    said = run_json(EXAMPLES.parent / "experiments/quickstart.yaml", tmp_path, *words)
    assert not {"detector", "model"} & set(said)
    assert (said["frames"], said["frames_scored"]) == (N_FRAMES, 0)
    assert said["name"] == "lines"
    result = read_result(tmp_path / "out")
    np.testing.assert_array_equal(result.frame_id, short_drive().log.frame_id)
    assert (result.true_lane == 0).all()
    shown = done("run", drive, "--recording", recording, "--no-figures", "--out", tmp_path / "o2")
    assert "no ground truth: beliefs only" in shown.stdout
    scores = json.loads((tmp_path / "o2" / "scores.json").read_text())
    # A lane that is believed while the car crosses no line is no change.
    assert len(scores["lanes"]) > scores["events"]["told"]
    lane, start, end = scores["lanes"][0]
    assert f"\nlane {lane} from {clock(start, 1)} to {clock(end, 1)}" in shown.stdout
    belief = read_result(tmp_path / "o2").marginals["Lane"]
    assert scores["sure"] == np.mean(belief.max(axis=1) >= 0.9)
    assert f"in {100 * scores['sure']:.1f} % of the frames" in shown.stdout
    last = f"at the end lane {belief[-1].argmax() + 1} is the most probable"
    assert last in shown.stdout
    other = shutil.copy(recording, tmp_path / "other.csv")
    words = ["--recording", recording, "--recording", other, "--no-figures"]
    both = done("run", drive, *words, "--out", tmp_path / "o3").stdout
    for name in ("lines", "other"):
        assert f"\n{name}: lane {lane} from {clock(start, 1)}" in both
    assert "score" not in shown.stderr


def test_recording_ground_truth_and_lanes_are_taken_from_the_command_line(
    drive: Path, tmp_path: Path
) -> None:
    quickstart = EXAMPLES.parent / "experiments" / "quickstart.yaml"
    words = ("--recording", drive.parent / "lines.csv", "--n-lanes", "3")
    said = run_json(
        quickstart, tmp_path, *words, "--ground-truth", drive.parent / "ground_truth.txt"
    )
    experiment = yaml.safe_load((tmp_path / "out" / "experiment.yaml").read_text())
    assert experiment["n_lanes"] == said["n_lanes"] == 3
    parameters = yaml.safe_load(quickstart.read_text())["parameters"]
    sets = [word for k, v in parameters.items() for word in ("--set", f"parameters.{k}={v}")]
    assert run_json(drive, tmp_path, *sets)["model"] == said["model"]
    said = run_json(drive, tmp_path, "--ground-truth", "none")
    assert "model" not in said
    assert said["name"] == "drive"


def test_a_figure_is_part_of_the_result_and_plot_draws_more(drive: Path, tmp_path: Path) -> None:
    done("run", drive, "--out", tmp_path / "out")
    assert [path.name for path in (tmp_path / "out" / "figures").iterdir()] == ["strips.png"]
    done("plot", tmp_path / "out")
    names = {path.name for path in (tmp_path / "out" / "figures").iterdir()}
    assert names == {"strips.png", "confusion.png", "reliability.png", "coverage.png"}
    shown = done("plot", tmp_path / "out", "--frames", "10", "60", "--style", "svg").stdout
    figures = [Path(line) for line in shown.splitlines()]
    assert all(f.suffix == ".svg" and f.stat().st_size > 1000 for f in figures)
    assert figures[0] == tmp_path / "out" / "figures" / "strips.svg"


def test_the_examples_of_own_files_run(tmp_path: Path) -> None:
    experiment = EXAMPLES / "own_files.yaml"
    assert "ok (4 lanes, 8 joint states)" in done("run", "--dry-run", experiment).stdout
    done("run", experiment, "--no-figures", "--out", tmp_path / "out")
    result = read_result(tmp_path / "out")
    assert result.config["graph"] == "./graph_my_graph.py"
    assert (tmp_path / "out" / "graph_my_graph.py").read_bytes() == (
        EXAMPLES / "my_graph.py"
    ).read_bytes()
    assert result.scores["model"]["accuracy"] > result.scores["detector"]["accuracy"]


def test_frame_id_0_in_every_message_is_refused_and_what_is_offered_works(
    tmp_path: Path, earlier: Path
) -> None:
    line_bag(tmp_path / "a.bag", [0] * 6, GOOD)
    said = run_on(tmp_path, tmp_path / "a.bag", earlier)
    assert "a.bag: frame ids must increase, but 0 is followed by 0" in said
    out = tmp_path / "out"
    words = ("--ground-truth", "none", "--no-figures", "--out", out)
    given = ("--columns", "frame_id=header.seq")
    done("run", tmp_path / "e.yaml", *given, *words)
    np.testing.assert_array_equal(read_result(out).frame_id, np.arange(6))


def bag(*ids: int, truth: Sequence[tuple[int, int, int]] = ()) -> Callable[[Path], object]:
    """Writes a.bag with these frames, and its ground truth."""

    def write(folder: Path) -> None:
        line_bag(folder / "a.bag", list(ids))
        truth_file(folder / "ground_truth.txt", list(truth) or [(k, 1, 0) for k in ids])

    return write


def table(text: str) -> Callable[[Path], object]:
    return lambda folder: (folder / "a.csv").write_text(text)


def half_a_bag(folder: Path) -> None:
    whole = line_bag(folder / "a.bag", [1, 2, 3]).read_bytes()
    (folder / "a.bag").write_bytes(whole[: len(whole) // 2])


@pytest.mark.parametrize(
    ("make", "name", "words", "said"),
    [
        (half_a_bag, "a.bag", "", "a.bag: cannot be read as a bag ("),
        (bag(1), "gone.bag", "", "e.yaml: recording.path: gone.bag: no such file; looked for /"),
        (bag(1), "a.bag", "--recording gone.csv", "gone.csv: no such file"),
        (bag(3, 4), "a.bag", "--set recording.frames=[10,20]", "no frame from 10 to before 20;"),
        (bag(1, 2, truth=[(2, 4, 0)]), "a.bag", "", "ground_truth.txt: frame 2: lane 4 is outside"),
        (bag(1, 2, truth=[(9, 1, 0)]), "a.bag", "", "no common frames: "),
    ],
)
def test_what_does_not_fit_is_refused_and_an_earlier_result_stays(
    tmp_path: Path, earlier: Path, make: Callable[[Path], object], name: str, words: str, said: str
) -> None:
    make(tmp_path)
    assert said in run_on(tmp_path, tmp_path / name, earlier, *words.format(tmp_path).split())


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("n_lane=3", "unknown key 'n_lane' (did you mean 'n_lanes'?)"),
        ("recording.topc=x", "recording: unknown key 'topc' (did you mean 'topic'?)"),
        ("parameters.p1=1.3", "parameters.p1: 1.3 is not a probability (0 to 1)"),
        ("evidence_reading=softer", "evidence_reading: 'softer' is not one of soft, hard"),
        ("recording.frames=[9,3]", "recording: frames [9, 3] is an empty range"),
        ("recording.simulate=a4", "recording: needs either path or simulate"),
        ("recording.format=rosbg", "unknown format 'rosbg' (did you mean 'rosbag'?)"),
        ("graph=sensor_failur", "graph: unknown name 'sensor_failur' (did you mean"),
        ("graph=./no.py", "graph: no file"),
    ],
)
def test_a_key_or_value_that_does_not_fit_is_refused_by_dry_run_and_by_run(
    tmp_path: Path, earlier: Path, override: str, said: str
) -> None:
    experiment = write_drive(tmp_path, 20)
    by_run = refused("run", experiment, "--set", override, "--no-figures", "--out", earlier)
    by_dry_run = refused("run", "--dry-run", experiment, "--set", override)
    assert said in by_run
    assert said in by_dry_run
    assert by_dry_run.startswith(f"{experiment}: ")
    # The same written in the file.
    key, _, value = override.partition("=")
    changes = {key.replace(".", "__"): yaml.safe_load(value)}
    rewritten(experiment, experiment, **changes)
    assert refused("run", "--dry-run", experiment) == by_dry_run


@pytest.mark.parametrize("what", ["--out", "--json"])
def test_a_place_that_cannot_be_written_is_refused_before_anything_is_computed(
    tmp_path: Path, earlier: Path, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = write_drive(tmp_path, 20)
    before = contents(tmp_path)
    monkeypatch.setattr(
        "egolane_pgm.verbs.run.run_experiment", lambda *a, **k: pytest.fail("computed")
    )
    below_a_file = experiment / "below" / "result"
    words = ("run", experiment, "--no-figures")
    if what == "--json":
        words = (*words, "--out", earlier)
    said = refused(*words, what, below_a_file)
    assert f"{below_a_file}: cannot be written, {experiment} is not a writable directory" in said
    said = refused(*words, what, "/proc/egolane/result")  # not even root may
    assert said.startswith("/proc/egolane/result: cannot be written")
    assert contents(tmp_path) == before


def test_a_file_that_is_read_is_not_written_over(tmp_path: Path) -> None:
    path, other = write_drive(tmp_path), write_drive(tmp_path / "other", name="other")
    before = contents(tmp_path)
    for name in ("experiment.yaml", "lines.csv", "ground_truth.txt"):
        target = tmp_path / name
        for words in (("run", path), ("run", path, other)):
            said = refused(*words, "--json", target, "--no-figures", "--out", tmp_path / "out")
            assert said == f"{target}: is read here; name another file"
    assert "is read here" in refused("compare", path, "--json", path)
    assert contents(tmp_path) == before


def test_recordings_of_one_name_are_told_apart_by_their_folders(tmp_path: Path) -> None:
    path, out = write_drive(tmp_path), tmp_path / "out"
    places = [write_drive(tmp_path / day).with_name("lines.csv") for day in ("mon", "tue")]
    several = [word for place in places for word in ("--recording", place)]
    done("run", path, *several, "--no-figures", "--out", out)
    assert sorted(p.name for p in out.iterdir()) == ["mon_lines", "tue_lines"]
    again = tmp_path / "mon" / ".." / "mon" / "lines.csv"
    said = refused("run", path, *several, "--recording", again, "--out", out)
    assert said == f"--recording: {again}: is named twice"
    # One recording, several experiments.
    other = write_drive(tmp_path / "other", name="other")
    words = ["--recording", places[0], "--no-figures", "--out", tmp_path / "both"]
    done("run", path, other, *words)
    assert sorted(p.name for p in (tmp_path / "both").iterdir()) == ["lines_drive", "lines_other"]
    assert refused("run", path, path, "--out", out) == f"{path}: is named twice"


def test_ctrl_c_keeps_the_finished_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    paths = [write_drive(tmp_path / name, name=name) for name in ("fast", "b", "c")]

    def interrupted(experiment: Experiment, **options: Any) -> Any:
        if experiment.name == "b":
            raise KeyboardInterrupt
        return run_experiment(experiment, **options)

    monkeypatch.setattr("egolane_pgm.verbs.run.run_experiment", interrupted)
    ran = command("run", *paths, "--no-figures", "--out", tmp_path / "out")
    assert ran.exit_code == 130
    said = f"egolane: interrupted; 1 of 3 are in {tmp_path / 'out'}; the same command begins anew"
    assert ran.stderr.splitlines()[-1] == said
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["fast"]


def test_absurd_offsets_of_invalid_lines_change_nothing(tmp_path: Path) -> None:
    absurd: list[Line] = [(False, True, 5, 3e32), (False, False, 0, float("nan"))]
    line_bag(tmp_path / "a.bag", [1, 2], [[*GOOD[0], *absurd], [*GOOD[1], absurd[0]]])
    said, out = kept(tmp_path, tmp_path / "a.bag")
    assert said == []
    with_absurd = read_result(out).marginals["Lane"]
    line_bag(tmp_path / "b.bag", [1, 2], GOOD[:2])
    said, out = kept(tmp_path, tmp_path / "b.bag")
    assert said == []
    np.testing.assert_array_equal(read_result(out).marginals["Lane"], with_absurd)


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


def test_run_prints_the_lane_changes_and_their_scores(tmp_path: Path) -> None:
    path, out = write_drive(tmp_path, 2400), tmp_path / "out"
    shown = done("run", path, "--no-figures", "--out", out).stdout
    events = (out / "events.csv").read_text().splitlines()[1:]
    assert len(events) > 10
    assert f"and {len(events) - 10} more in events.csv" in shown
    scores = run_experiment(path).scores["events"]
    assert f"{scores['changes']} true lane changes, {scores['told']} told:" in shown
    blind = done("run", path, "--ground-truth", "none", "--no-figures", "--out", out).stdout
    assert "| time, s |" in blind
    assert "true lane changes" not in blind
    assert len((out / "events.csv").read_text().splitlines()) == len(events) + 1
    other = write_drive(tmp_path / "other", 30, name="other", ground_truth=None)
    shown = done("run", path, other, "--no-figures", "--out", tmp_path / "both").stdout
    rows = [line.split() for line in shown.splitlines() if "told" in line or "| drive" in line]
    # The second table is that of the lane changes.
    assert (rows[-2][5], rows[-1][5]) == ("told", str(scores["told"]))

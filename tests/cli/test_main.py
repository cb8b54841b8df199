"""The command line as a user meets it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from egolane_pgm import __version__
from egolane_pgm.paper import experiments_folder, paper_experiment
from egolane_pgm.recordings import catalog, read_lines
from egolane_pgm.recordings.ground_truth import read_ground_truth
from egolane_pgm.results import read_result
from egolane_pgm.run import run_experiment
from egolane_pgm.tune.recover import Recovered
from tests.conftest import needs_compiler
from tests.kits.drives import N_FRAMES, command, contents, done, refused, short_drive, write_drive

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_drive(tmp_path_factory.mktemp("drive"))


def run(drive: Path, folder: Path, *words: object) -> dict[str, object]:
    """What `--json` says of `egolane run` with these words."""
    target = folder / "run.json"
    done("run", drive, "--no-figures", "--out", folder / "out", "--json", target, *words)
    content = json.loads(target.read_text())
    assert isinstance(content, dict)
    return content


def test_run_writes_the_documented_json_unrounded(drive: Path, tmp_path: Path) -> None:
    said = run(drive, tmp_path)
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


def test_run_prints_scores_warnings_and_where_the_result_is(drive: Path, tmp_path: Path) -> None:
    ran = done("run", drive, "--no-figures", "--out", tmp_path / "out")
    right = run_experiment(drive)
    assert f"drive: {N_FRAMES} frames, 3 lanes, graph sensor_failure" in ran.stdout
    assert f"| accuracy {'':>33} | {right.scores['detector']['accuracy']:>8.3f} |" in ran.stdout
    assert "parameters: not tuned" in ran.stdout
    assert ran.stdout.endswith(f"result: {tmp_path / 'out'}\n")
    assert ran.stderr.splitlines() == [f"warning: {note}" for note in right.notes]


def test_set_overrides_keys_of_the_yaml(drive: Path, tmp_path: Path) -> None:
    said = run(drive, tmp_path, "--set", "parameters.bonus_value=0", "--set", "filter=exact")
    experiment = read_result(tmp_path / "out").experiment
    assert experiment["parameters"]["bonus_value"] == 0
    assert experiment["filter"] == "exact"
    assert said["detector"] != run(drive, tmp_path)["detector"]


def test_a_recording_of_ones_own_runs_without_any_ground_truth(drive: Path, tmp_path: Path) -> None:
    recording = drive.parent / "lines.csv"
    said = run(EXAMPLES.parent / "experiments/quickstart.yaml", tmp_path, "--recording", recording)
    assert not {"detector", "model"} & set(said)
    assert (said["frames"], said["frames_scored"]) == (N_FRAMES, 0)
    assert said["name"] == "lines"
    result = read_result(tmp_path / "out")
    np.testing.assert_array_equal(result.frame_id, short_drive().log.frame_id)
    assert (result.true_lane == 0).all()
    shown = done("run", drive, "--recording", recording, "--no-figures", "--out", tmp_path / "o2")
    assert "no ground truth: beliefs only" in shown.stdout
    assert "score" not in shown.stderr


def test_recording_ground_truth_and_lanes_are_taken_from_the_command_line(
    drive: Path, tmp_path: Path
) -> None:
    quickstart = EXAMPLES.parent / "experiments" / "quickstart.yaml"
    words = ("--recording", drive.parent / "lines.csv", "--n-lanes", "3")
    said = run(quickstart, tmp_path, *words, "--ground-truth", drive.parent / "ground_truth.txt")
    experiment = yaml.safe_load((tmp_path / "out" / "experiment.yaml").read_text())
    assert experiment["n_lanes"] == said["n_lanes"] == 3
    parameters = yaml.safe_load(quickstart.read_text())["parameters"]
    sets = [word for k, v in parameters.items() for word in ("--set", f"parameters.{k}={v}")]
    assert run(drive, tmp_path, *sets)["model"] == said["model"]
    said = run(drive, tmp_path, "--ground-truth", "none")
    assert "model" not in said
    assert said["name"] == "drive"


def test_figures_are_part_of_the_result(drive: Path, tmp_path: Path) -> None:
    done("run", drive, "--out", tmp_path / "out")
    names = {path.name for path in (tmp_path / "out" / "figures").iterdir()}
    assert names == {"strips.png", "confusion.png", "reliability.png", "coverage.png"}
    shown = done("plot", tmp_path / "out", "--frames", "10", "60", "--style", "svg").stdout
    figures = [Path(line) for line in shown.splitlines()]
    assert all(f.suffix == ".svg" and f.stat().st_size > 1000 for f in figures)
    assert figures[0] == tmp_path / "out" / "figures" / "strips.svg"


def test_several_results_make_one_sheet(drive: Path, tmp_path: Path) -> None:
    run(drive, tmp_path / "a")
    run(drive, tmp_path / "b", "--set", "parameters.bonus_value=0", "--set", "name=b")
    (tmp_path / "b" / "out").rename(tmp_path / "b" / "none")
    shown = done("plot", tmp_path / "a/out", tmp_path / "b/none", "--out", tmp_path / "figures")
    figures = {str(Path(line).relative_to(tmp_path / "figures")) for line in shown.stdout.split()}
    assert {"dispersion.png", "bonus_ablation.png", "out/strips.png", "none/strips.png"} <= figures
    assert all((tmp_path / "figures" / name).is_file() for name in figures)


def test_the_examples_of_own_files_run(tmp_path: Path) -> None:
    experiment = EXAMPLES / "own_files.yaml"
    assert "ok (4 lanes, 8 joint states)" in done("validate", experiment).stdout
    done("run", experiment, "--no-figures", "--out", tmp_path / "out")
    result = read_result(tmp_path / "out")
    assert result.experiment["graph"] == "./graph_my_graph.py"
    assert (tmp_path / "out" / "graph_my_graph.py").read_bytes() == (
        EXAMPLES / "my_graph.py"
    ).read_bytes()
    assert result.scores["model"]["accuracy"] > result.scores["detector"]["accuracy"]


def test_every_experiment_of_the_paper_validates(recordings: Path) -> None:
    paths = [paper_experiment(number) for number in range(1, 11)]
    lines = done("validate", *paths).stdout.splitlines()
    assert [line.partition(":")[0] for line in lines] == [str(path) for path in paths]
    assert lines[0].endswith("ok (4 lanes, 8 joint states)")
    assert lines[9].endswith("ok (3 lanes, 6 joint states)")


def test_validate_says_which_recording_is_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("EGOLANE_DATA", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert "recording.path: rle/special" in refused("validate", paper_experiment(1))


def test_ls_lists_what_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(experiments_folder().parent)
    shown = done("ls").stdout
    assert "sensor_failure, three_sensor_states, wor_direct, wor_levels, wor_on_lane" in shown
    assert "simulations: a2, a4, quickstart" in shown
    assert "experiments/quickstart.yaml  simulated drive of two minutes" in shown
    assert len([line for line in shown.splitlines() if "paper/run" in line]) == 10
    assert "published" not in shown


def test_help_names_every_command_and_version_the_version() -> None:
    shown = done("--help").stdout
    for name in ("ls", "validate", "run", "reproduce", "recover", "plot", "data", "convert"):
        assert f"\n  {name} " in shown
    assert __version__ in done("--version").stdout
    for name in ("run", "reproduce", "data", "simulate"):
        assert "Usage: " in done(name, "--help").stdout
    assert "Usage: " in command("data").stderr  # as click does: the help, exit code 2


def test_conversions_keep_every_line(tmp_path: Path, drive: Path) -> None:
    source = drive.parent / "lines.csv"
    shown = done("convert", source, tmp_path / "a.parquet").stdout
    assert shown == f"{tmp_path / 'a.parquet'}: {N_FRAMES} frames, ids 0 to {N_FRAMES - 1}\n"
    done("convert", tmp_path / "a.parquet", tmp_path / "b.csv")
    assert (tmp_path / "b.csv").read_bytes() == source.read_bytes()
    one, other = read_lines(tmp_path / "a.parquet"), short_drive().log
    np.testing.assert_array_equal(one.offset_m, other.offset_m)


def test_a_simulated_drive_is_written_and_runs(tmp_path: Path) -> None:
    words = ("simulate", "a2", "--frames", "120", "--seed", "4", "--set", "miss=0.5")
    shown = done(*words, "--out", tmp_path / "one").stdout
    experiment = tmp_path / "one" / "experiment.yaml"
    assert shown == f"120 frames; try: egolane run {experiment}\n"
    done("run", experiment, "--no-figures", "--out", tmp_path / "result")
    assert read_result(tmp_path / "result").run["frames"] == 120
    done(*words, "--out", tmp_path / "other")
    assert contents(tmp_path / "one") == contents(tmp_path / "other")  # seeded
    truth = read_ground_truth(tmp_path / "one" / "ground_truth.txt")
    assert (truth.lane >= 1).all()
    assert (truth.lane <= 3).all()
    done("simulate", "--frames", "20", "--n-lanes", "2", "--out", tmp_path / "two")
    assert yaml.safe_load((tmp_path / "two" / "experiment.yaml").read_text())["n_lanes"] == 2


def test_data_list_shows_the_files_where_a_run_would_find_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("EGOLANE_DATA", str(tmp_path / "data"))
    (tmp_path / "data" / "rle").mkdir(parents=True)
    (tmp_path / "data" / "rle" / "ISIS_01.txt").write_text("1;1;0\n")
    lines = done("data", "list").stdout.splitlines()
    assert lines[0] == f"looked in: {tmp_path / 'data'}"
    assert lines[1] == f"looked in: {catalog.download_folder()}"
    assert len(lines) == 2 + 12
    state = {line.rpartition("/")[2]: line.split()[0] for line in lines[2:]}
    assert state.pop("ISIS_01.txt") == "bad"
    assert set(state.values()) == {"missing"}


def test_data_verify_names_every_file_that_is_not_good(tmp_path: Path) -> None:
    result = command("data", "verify", "--folder", tmp_path)
    assert result.exit_code == 2
    assert result.stdout == "0 of 12 files are there and good\n"
    assert len(result.stderr.splitlines()) == 12
    assert all(
        "no such file; `egolane data fetch` gets it" in x for x in result.stderr.split("\n")[:-1]
    )


def test_data_verify_knows_the_papers_files(recordings: Path) -> None:
    assert done("data", "verify", "--folder", recordings).stdout.startswith("12 of 12 files")


@pytest.mark.parametrize("graph", ["wor_on_lane", str(EXAMPLES / "my_graph.py")])
def test_a_graph_is_drawn_by_name_or_file(tmp_path: Path, graph: str) -> None:
    target = tmp_path / "graph.svg"
    assert done("network", graph, target, "--n-lanes", "2").stdout == f"{target}\n"
    assert "SensorState" in target.read_text()


def test_a_graph_that_cannot_be_built_is_refused(tmp_path: Path) -> None:
    (tmp_path / "g.py").write_text("HIDDEN = OBSERVED = ()\ndef build(n, p):\n    return n.x\n")
    said = refused("network", tmp_path / "g.py", tmp_path / "g.svg")
    assert "g.py, line 3: AttributeError" in said
    assert "a figure ends in .png, .svg, .pdf" in refused("network", "no_wor", tmp_path / "g.txt")


@needs_compiler
def test_graphs_are_compared_on_a_run_of_the_paper(recordings: Path, tmp_path: Path) -> None:
    target = tmp_path / "compared.json"
    words = ("--runs", "6", "--graphs", "sensor_failure,lane_only", "--json", target)
    shown = done("compare", *words).stdout
    document = json.loads(target.read_text())
    scores = document["runs"][0]["scores"]
    assert set(scores) == {"detector", "sensor_failure", "lane_only"}
    row = next(line for line in shown.splitlines() if line.startswith("| 6 "))
    for name in scores:
        assert f"{scores[name]['accuracy']:.3f}" in row


@needs_compiler
def test_recover_writes_into_the_published_file_on_request_only(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored: list[tuple[int, Recovered, str]] = []

    def store(number: int, found: Recovered, how: str) -> None:
        stored.append((number, found, how))

    monkeypatch.setattr("egolane_pgm.tune.recover.store_recovered", store)
    words = ("recover", "--run", "9", "--evaluations", "2", "--seed", "3")
    done(*words)
    assert stored == []
    shown = done(*words, "--write").stdout
    assert [(number, how[-6:]) for number, _, how in stored] == [(9, "seed 3")]
    assert "published.yaml" in shown


def test_whoever_stops_reading_gets_no_traceback(drive: Path, tmp_path: Path) -> None:
    program = "from egolane_pgm.cli.main import main; main()"
    reader, writer = os.pipe()
    os.close(reader)  # every write is a broken pipe
    try:
        ran = subprocess.run(
            [sys.executable, "-c", program, "ls"], stdout=writer, stderr=subprocess.PIPE, timeout=60
        )
    finally:
        os.close(writer)
    assert ran.returncode == 1
    assert ran.stderr == b""


def answer(text: str) -> Callable[..., bool]:
    def confirm(question: str) -> bool:
        assert question.startswith("Download the paper's recordings (18 MB) to ")
        return text == "y"

    return confirm


@pytest.mark.parametrize("reply", ["y", "n"])
def test_the_download_is_offered_where_somebody_can_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reply: str
) -> None:
    fetched: list[bool] = []

    def fetch() -> list[catalog.Outcome]:
        fetched.append(True)
        file = catalog.list_files()[0]
        return [catalog.Outcome(file, tmp_path / "x", "failed", "the server is down")]

    monkeypatch.delenv("EGOLANE_DATA", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("egolane_pgm.cli.recordings.sys.stdin", Terminal())
    monkeypatch.setattr("egolane_pgm.cli.recordings.click.confirm", answer(reply))
    monkeypatch.setattr(catalog, "fetch", fetch)
    from egolane_pgm.cli.recordings import have_recordings

    assert not have_recordings()
    assert len(fetched) == (reply == "y")


class Terminal:
    def isatty(self) -> bool:
        return True


def test_a_road_of_more_lanes_than_there_are_is_refused_at_once(labels: Path) -> None:
    said = refused(
        "video", labels.parent / "pics", "--camera", labels.with_name("cam.yaml"),
        "--n-lanes", 300, "-o", labels.with_name("out"),
    )  # fmt: skip
    assert said.endswith("n_lanes: input should be less than or equal to 50 (got 300)")
    words = (write_drive(labels.parent / "x", 30), "--set", "n_lanes=1000000000")
    for name in ("run", "validate", "learn", "compare", "tune"):
        assert "n_lanes: input should be less than or equal to 50" in refused(name, *words)
    said = refused("network", "lane_only", labels.with_name("n.png"), "--n-lanes", 51)
    assert said == "--n-lanes: 51 is more than 50"

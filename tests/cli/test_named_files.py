"""Experiments whose files lie beside their YAML, learned and compared from somewhere else; and two
recordings of one name."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
import yaml

from egolane_pgm.camera.model import Camera, road_to_image, write_camera
from egolane_pgm.compare.comparing import by_recording
from egolane_pgm.compare.placing import load_for_scoring, on_recording, recording_key
from egolane_pgm.experiment import load_experiment
from egolane_pgm.files import write_yaml
from egolane_pgm.learn import output
from egolane_pgm.loading import load_recording
from egolane_pgm.model import prepare_model
from egolane_pgm.paper import experiments_folder
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.run import run_experiment
from egolane_pgm.tune.plan import load_plan, make_problem
from egolane_pgm.tune.study_directory import tuned_experiment
from egolane_pgm.types import LaneTruth
from tests.kits.drives import command, contents, done, refused, write_drive, write_experiment
from tests.kits.synthetic_road import write_place

CAMERA = Camera(width=480, height=270, fx=390, fy=390, cx=240, cy=135, height_m=1.4, pitch_deg=-4)
N_FRAMES = 12


@pytest.fixture
def labelled(tmp_path: Path) -> Path:
    """An experiment on a folder of CULane's files, its camera beside it."""
    folder = tmp_path / "drive"
    (folder / "labels").mkdir(parents=True)
    x = np.linspace(5, 40, 20)
    text = ""
    for offset in (-5.2, -1.7, 1.8, 5.3):
        u, v = road_to_image(CAMERA, x, np.full_like(x, offset))
        text += " ".join(f"{a:.2f} {b:.2f}" for a, b in zip(u, v, strict=True)) + "\n"
    for k in range(N_FRAMES):
        (folder / "labels" / f"{k:05d}.lines.txt").write_text(text)
    write_camera(folder / "cam.yaml", CAMERA)
    lane, is_crossing = np.full(N_FRAMES, 2), np.zeros(N_FRAMES, dtype=bool)
    write_ground_truth(folder / "t.txt", LaneTruth(np.arange(N_FRAMES), lane, is_crossing))
    return write_experiment(
        folder / "x.yaml",
        recording={"path": "labels", "camera": "cam.yaml", "options": {"valid": "always"}},
        ground_truth={"path": "t.txt"},
        graph="lane_only",
    )


def test_what_is_learned_elsewhere_reads_the_same_folder_and_camera(
    labelled: Path, tmp_path: Path
) -> None:
    target = tmp_path / "new" / "folder" / "learned.yaml"
    done("learn", labelled, "--out", target)
    content = yaml.safe_load(target.read_text())
    assert content["recording"]["path"] == "../../drive/labels"
    assert content["recording"]["camera"] == "../../drive/cam.yaml"
    assert content["ground_truth"]["path"] == "../../drive/t.txt"
    found = load_recording(load_experiment(target)).log
    np.testing.assert_array_equal(
        found.offset_m, load_recording(load_experiment(labelled)).log.offset_m
    )


def test_a_model_from_elsewhere_reads_a_recordings_own_folder_and_camera(
    labelled: Path, tmp_path: Path
) -> None:
    place, model = load_experiment(labelled), load_experiment(write_drive(tmp_path / "m", 30))
    placed = on_recording(model, place)
    assert len(load_recording(placed).log) == N_FRAMES
    assert recording_key(placed) == recording_key(place) != recording_key(model)


def test_a_comparison_of_a_folder_of_lines_is_kept(labelled: Path, tmp_path: Path) -> None:
    done("compare", labelled, "--blocks", 2, "--out", tmp_path / "out")
    run = json.loads((tmp_path / "out" / "labels" / "drive" / "run.json").read_text())
    assert run["data"][0]["files"] == N_FRAMES
    names = [Path(entry["path"]).name for entry in run["data"]]
    assert names == ["labels", "cam.yaml", "t.txt"]
    kept = tmp_path / "out" / "labels" / "drive" / "experiment.yaml"
    assert len(load_recording(load_experiment(kept)).log) == N_FRAMES


def test_recordings_of_one_name_are_told_apart(tmp_path: Path) -> None:
    paths = [tmp_path / "a", tmp_path / "b", tmp_path / "c" / "a", tmp_path / "c"]
    experiments = [load_experiment(write_drive(path, 30)) for path in paths]
    titles = [group.title for group in by_recording(experiments)]
    assert titles == ["a lines", "b lines", "a lines (2)", "c lines"]
    assert [group.title for group in by_recording(experiments[:1])] == ["lines"]
    done("compare", *(path / "experiment.yaml" for path in paths[:2]), "--out", tmp_path / "out")
    parts = [tmp_path / "out" / name / "comparison.json" for name in ("a_lines", "b_lines")]
    assert [json.loads(part.read_text())["title"] for part in parts] == titles[:2]


def test_learning_does_not_write_over_what_the_experiment_reads(tmp_path: Path) -> None:
    done("learn", write_drive(tmp_path, graph="lane_only"), "--out", tmp_path / "one.yaml")
    done("learn", tmp_path / "one.yaml", "--out", tmp_path / "two.yaml")
    before = contents(tmp_path)
    graph = tmp_path / "one.graph.yaml"
    said = refused("learn", tmp_path / "one.yaml", "--out", graph)
    assert said == f"{graph}: is read by {tmp_path / 'one.yaml'}; name another with --out"
    graph = tmp_path / "two.graph.yaml"
    said = refused(
        "learn", tmp_path / "one.yaml", "--set", f"graph={graph}", "--out", tmp_path / "two.yaml"
    )
    assert said.startswith(f"{graph}: is read by ")
    assert contents(tmp_path) == before


def test_learning_no_table_at_all_is_refused(tmp_path: Path) -> None:
    experiment = write_drive(tmp_path, 30, learning={"tables": []})
    assert "learning.tables: names no table; leave it out to learn all of " in refused(
        "learn", experiment
    )


def test_what_was_learned_is_said_where_its_files_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, *_: object) -> None:
        raise output.InputError(f"{path}: cannot be written: No space left on device")

    monkeypatch.setattr(output, "write_yaml", full)
    result = command(
        "learn", write_drive(tmp_path, graph="lane_only"), "--out", tmp_path / "one.yaml"
    )
    assert result.exit_code == 2
    assert "held out, 5 blocks" in result.stdout
    assert "No space left on device" in result.stderr


# --- tuning --------------------------------------------------------------------------------------


def test_a_tuned_experiment_runs_from_its_own_folder(labelled: Path, tmp_path: Path) -> None:
    problem = make_problem(load_plan(write_own_graph(labelled)))
    target = tmp_path / "study" / "best.yaml"
    target.parent.mkdir()
    (drive,) = problem.drives
    write_yaml(target, tuned_experiment(drive.experiment, drive.model.parameters, problem))
    tuned = load_experiment(target)
    assert tuned.recording.path == str(labelled.parent / "labels")
    assert tuned.recording.camera == str(labelled.parent / "cam.yaml")
    assert len(load_recording(tuned).log) == N_FRAMES
    assert prepare_model(tuned).compiled.n_states == 3


def write_own_graph(experiment: Path) -> Path:
    """The experiment with a graph of its own, YAML, that has one parameter."""
    (experiment.parent / "g.py").write_text(
        "from egolane_pgm.graphs.lane_only import *\nfrom egolane_pgm.graphs.lane_only import"
        " build, HIDDEN, OBSERVED, PARAMETERS\n"
    )
    content = yaml.safe_load(experiment.read_text())
    experiment.write_text(yaml.safe_dump({**content, "graph": "g.py"}))
    return experiment


def test_a_tuned_experiment_names_the_files_of_its_detector_in_full(tmp_path: Path) -> None:
    path = write_experiment(
        tmp_path / "x.yaml",
        recording={
            "path": "left*.png", "right": "right*.png", "camera": "cam.yaml",
            "detector": "own.py", "detector_parameters": {"matcher": "m.py", "n": 3, "kind": "a"},
        },
    )  # fmt: skip
    (tmp_path / "cam.yaml").touch()
    problem = make_problem(load_plan(write_drive(tmp_path / "other", 60)))
    recording = tuned_experiment(load_experiment(path), {}, problem)["recording"]
    assert [recording[key] for key in ("path", "right", "camera", "detector")] == [
        str(tmp_path / name) for name in ("left*.png", "right*.png", "cam.yaml", "own.py")
    ]
    given = {"matcher": str(tmp_path / "m.py"), "n": 3, "kind": "a"}
    assert recording["detector_parameters"] == given


def test_a_study_scores_the_reject_option_as_a_run_does(tmp_path: Path) -> None:
    path = write_drive(tmp_path, unassigned_below=0.9)
    out = ("--trials", 12, "--in-sample-only", "--jobs", 1, "--no-figures")
    for name in ("accuracy", "false_switches_per_minute"):
        done("tune", path, "--objective", name, *out, "--out", tmp_path / name)
        study = json.loads((tmp_path / name / "drive" / "study.json").read_text())
        run = run_experiment(tmp_path / name / "drive" / "best.yaml")
        scores = run.scores["model"]
        assert scores["coverage"] < 1
        assert study["best"]["values"][name] == pytest.approx(scores[name])
        assert study["in_sample"]["all_frames"]["accuracy"] == pytest.approx(scores["accuracy"])
    said = refused("tune", path, "--set", "unassigned_below=0.5", *out, "--out", tmp_path / name)
    assert "unassigned_below" in said


def test_a_search_refuses_a_filter_that_looks_ahead(tmp_path: Path) -> None:
    path = write_drive(tmp_path, 60, filter="fixed_lag", lag=3)
    said = refused("tune", path, "--out", tmp_path / "out")
    assert said.startswith(
        f"{path}: filter: a search takes assumed_density or exact, not fixed_lag"
    )


def test_tuning_files_are_listed_and_checked(tmp_path: Path) -> None:
    said = done("ls").stdout
    assert "tuning files" in said
    assert "all_italy.yaml" in said.partition("tuning files")[2]
    assert "all_italy.yaml" not in said.partition("tuning files")[0]
    write_drive(tmp_path, 60)
    path = tmp_path / "tuning.yaml"

    def write(**tuning: object) -> None:
        content = {"name": "both", "experiments": ["experiment.yaml"], "tuning": tuning}
        path.write_text(yaml.safe_dump(content))

    write(parameters={"p1": 0.9})
    assert f"{path}: ok (1 experiment(s), " in done("validate", path).stdout
    write(parameters={"p11": 0.9})
    assert f"{path}: tuning.parameters" in refused("validate", path)
    write(objective="acuracy")
    assert "did you mean 'accuracy'" in refused("validate", path)
    write(parameters={"p1": 0.9})
    (tmp_path / "lines.csv").unlink()
    assert "recording.path: lines.csv: no such file" in refused("validate", path)


def test_every_tuning_file_that_comes_along_can_be_read() -> None:
    files = sorted((experiments_folder() / "tuning").glob("*.yaml"))
    assert all(load_plan(file).experiments for file in files)


# --- learning ------------------------------------------------------------------------------------


def test_learning_from_evidence_that_cannot_be_is_one_line(tmp_path: Path) -> None:
    path = write_drive(tmp_path, graph="lane_only", evidence="never.py")
    (tmp_path / "never.py").write_text(
        "import numpy as np\nfrom egolane_pgm.types import Evidence\n"
        "def evidence(log, n_lanes, parameters):\n"
        "    return Evidence({'DetectorOutput': np.zeros((len(log), n_lanes))})\n"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        said = refused("learn", path, "--out", tmp_path / "new.yaml")
    assert "frames to learn from can be under graph lane_only" in said
    assert not (tmp_path / "new.yaml").exists()


def test_learn_and_compare_agree_on_what_is_found_beside_a_choice(tmp_path: Path) -> None:
    choice = {"grid": {"bonus_value": [0, 3]}}
    path = write_drive(tmp_path, graph="lane_only", fit="choose", choice=choice)
    said = done("learn", path, "--out", tmp_path / "new.yaml", "--json", tmp_path / "a.json").stdout
    assert "chosen on all blocks: bonus_value" in said
    assert "nothing else is learned" in said
    new = load_experiment(tmp_path / "new.yaml")
    assert new.graph == "lane_only"
    assert new.parameters["bonus_value"] in (0, 3)
    assert not (tmp_path / "new.graph.yaml").exists()
    assert json.loads((tmp_path / "a.json").read_text())["held_out"] is None
    done("run", tmp_path / "new.yaml", "--no-figures", "--out", tmp_path / "out")
    said = done(
        "learn", path, "--set", "learning.strength=100", "--out", tmp_path / "t.yaml"
    ).stdout
    assert "held out, 5 blocks" in said
    assert (tmp_path / "t.graph.yaml").exists()
    said = done("learn", path, "--set", "fit=learn", "--out", tmp_path / "u.yaml").stdout
    assert "held out, 5 blocks" in said


# --- pictures ------------------------------------------------------------------------------------


def test_a_videos_own_frame_rate_counts_wherever_it_is_scored(tmp_path: Path) -> None:
    folder = write_place(tmp_path, 12)
    lane, is_crossing = np.full(12, 2), np.zeros(12, dtype=bool)
    write_ground_truth(folder / "t.txt", LaneTruth(np.arange(12), lane, is_crossing))
    path = folder / "run.yaml"
    truth = {"ground_truth": {"path": "t.txt"}, "graph": "lane_only"}
    path.write_text(yaml.safe_dump({**yaml.safe_load(path.read_text()), **truth}))
    own = load_experiment(path)
    placed = on_recording(load_experiment(write_drive(tmp_path / "m", 30)), own)
    for drive in (load_for_scoring(own), load_for_scoring(placed)):
        assert drive.experiment.recording.frame_rate == 12.5
        assert not any("frames per second" in note for note in drive.recorded.notes)
    done("learn", path, "--blocks", 2, "--out", folder / "new.yaml")
    assert load_experiment(folder / "new.yaml").recording.frame_rate == 12.5
    told = on_recording(own, load_experiment(path, ["recording.frame_rate=25"]))
    assert load_for_scoring(told).experiment.recording.frame_rate == 25


def test_only_a_recording_that_is_missing_is_said_to_be_fetched(tmp_path: Path) -> None:
    path = write_place(tmp_path, 2) / "run.yaml"
    said = refused("validate", path, "--set", "recording.camera=none.yaml")
    assert "recording.camera: none.yaml: no such file" in said
    assert "data fetch" not in said
    assert "data fetch" not in refused("validate", path, "--set", "recording.path=none.mp4")
    bare = write_drive(tmp_path / "x", 30)
    assert "run `egolane data fetch`" in refused("validate", bare, "--set", "recording.path=no.csv")

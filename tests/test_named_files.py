"""Experiments whose files lie beside their YAML, learned and compared from somewhere else; and two
recordings of one name."""

from __future__ import annotations

import json
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml
from drives import command, contents, done, refused, write_drive, write_experiment

from egolane_pgm.camera import Camera, road_to_image, write_camera
from egolane_pgm.compare.comparing import by_recording
from egolane_pgm.compare.drives import on_recording, recording_key
from egolane_pgm.experiment import load_experiment
from egolane_pgm.learn import output
from egolane_pgm.loading import load_recording
from egolane_pgm.processes import in_processes
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.types import LaneTruth

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

    monkeypatch.setattr(output, "_write", full)
    result = command(
        "learn", write_drive(tmp_path, graph="lane_only"), "--out", tmp_path / "one.yaml"
    )
    assert result.exit_code == 2
    assert "held out, 5 blocks" in result.stdout
    assert "No space left on device" in result.stderr


def leave_a_file(folder: Path, k: int) -> int:
    time.sleep(0.1)
    (folder / str(k)).touch()
    return k


def test_nothing_is_begun_after_the_work_is_left(tmp_path: Path) -> None:
    results = in_processes(partial(leave_a_file, tmp_path), range(60), 2)
    assert next(iter(results)) == 0
    results.close()  # type: ignore[attr-defined]
    assert len(list(tmp_path.iterdir())) < 30

"""The command `egolane learn`."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import yaml
from egolane_pgm.comparing.placing import on_recording
from egolane_pgm.drive import load_drive, load_recording

from egolane_pgm.experiment import load_experiment
from egolane_pgm.recordings.ground_truth import write_ground_truth
from egolane_pgm.types import LaneTruth
from tests.kits.drives import contents, done, refused, rewritten, write_drive
from tests.kits.synthetic_road import write_place


def test_what_is_learned_elsewhere_reads_the_same_labels_and_camera(
    labelled: Path, tmp_path: Path
) -> None:
    target = tmp_path / "new" / "folder" / "learned.yaml"
    done("learn", labelled, "--out", target)
    content = yaml.safe_load(target.read_text())
    assert content["recording"]["path"] == "../../drive/labels.json"
    assert content["recording"]["camera"] == "../../drive/cam.yaml"
    assert content["ground_truth"]["path"] == "../../drive/t.txt"
    found = load_recording(load_experiment(target)).log
    np.testing.assert_array_equal(
        found.offset_m, load_recording(load_experiment(labelled)).log.offset_m
    )


def test_learning_does_not_write_over_what_the_experiment_reads(tmp_path: Path) -> None:
    done("learn", write_drive(tmp_path, graph="lane_only"), "--out", tmp_path / "one.yaml")
    done("learn", tmp_path / "one.yaml", "--out", tmp_path / "two.yaml")
    before = contents(tmp_path)
    assert "is the experiment itself" in refused(
        "learn", tmp_path / "one.yaml", "--out", tmp_path / "one.yaml"
    )
    said = refused("learn", tmp_path / "one.yaml", "--out", tmp_path / "lines.csv")
    assert said.endswith("name another file")
    graph = tmp_path / "one.graph.yaml"
    said = refused("learn", tmp_path / "one.yaml", "--out", graph)
    assert said == f"{graph}: is read by {tmp_path / 'one.yaml'}; name another file"
    graph = tmp_path / "two.graph.yaml"
    said = refused(
        "learn", tmp_path / "one.yaml", "--set", f"graph={graph}", "--out", tmp_path / "two.yaml"
    )
    assert said.startswith(f"{graph}: is read by ")
    assert contents(tmp_path) == before


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


def test_a_videos_own_frame_rate_counts_wherever_it_is_scored(tmp_path: Path) -> None:
    folder = write_place(tmp_path, 12)
    lane, is_crossing = np.full(12, 2), np.zeros(12, dtype=bool)
    write_ground_truth(folder / "t.txt", LaneTruth(np.arange(12), lane, is_crossing))
    path = folder / "run.yaml"
    rewritten(path, path, ground_truth__path="t.txt", graph="lane_only")
    own = load_experiment(path)
    placed = on_recording(load_experiment(write_drive(tmp_path / "m", 30)), own)
    for drive in (load_drive(each, needs_truth="") for each in (own, placed)):
        assert drive.experiment.recording.frame_rate == 12.5
        assert not any("frames per second" in note for note in drive.recorded.notes)
    done("learn", path, "--blocks", 2, "--out", folder / "new.yaml")
    assert load_experiment(folder / "new.yaml").recording.frame_rate == 12.5
    told = on_recording(own, load_experiment(path, ["recording.frame_rate=25"]))
    assert load_drive(told, needs_truth="").experiment.recording.frame_rate == 25

"""Which recordings are of one drive, so that they are held out together."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from egolane_pgm.drive import drive_key
from egolane_pgm.experiment import Experiment, load_experiment
from tests.kits.drives import refused, rewritten, write_drive


def on_truth(folder: Path, truth: str) -> Experiment:
    keys = {"name": "other", "ground_truth__path": truth}
    return load_experiment(rewritten(folder / "experiment.yaml", folder / "other.yaml", **keys))


def test_a_copy_of_the_ground_truth_is_of_the_same_drive(tmp_path: Path) -> None:
    own = load_experiment(write_drive(tmp_path))
    text = (tmp_path / "ground_truth.txt").read_text()
    shutil.copy(tmp_path / "ground_truth.txt", tmp_path / "copy.txt")
    (tmp_path / "windows.csv").write_text(
        "frame,lane,crossing\n" + text.replace(";", ",").replace("\n", "\r\n"), newline=""
    )
    os.link(tmp_path / "ground_truth.txt", tmp_path / "link.txt")
    frame, lane, crossing = text.splitlines()[0].split(";")
    changed = f"{frame};{int(lane) % 3 + 1};{crossing}\n" + text.split("\n", 1)[1]
    (tmp_path / "changed.txt").write_text(changed)
    for name in ("copy.txt", "windows.csv", "link.txt"):
        assert drive_key(on_truth(tmp_path, name)) == drive_key(own)
    assert drive_key(on_truth(tmp_path, "changed.txt")) != drive_key(own)
    # Written anew under its name, it is another one.
    (tmp_path / "copy.txt").write_text(changed + "999999;1;0\n")
    assert drive_key(on_truth(tmp_path, "copy.txt")) != drive_key(own)


def test_a_ground_truth_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    path = write_drive(tmp_path)
    (tmp_path / "ground_truth.txt").unlink()
    said = refused("compare", path)
    assert f"{path}: ground_truth.path: ground_truth.txt: no such file" in said

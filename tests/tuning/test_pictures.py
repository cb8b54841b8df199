"""The parameters of a detector are searched on pictures whose lines are labelled."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from pyarrow import parquet

import egolane_pgm as ego
from egolane_pgm.experiment import load_experiment
from egolane_pgm.tuning import study as studies
from egolane_pgm.tuning.plan import load_plan
from egolane_pgm.vision import picture_task
from egolane_pgm.vision.picture_task import counts_of, load_labelled
from tests.kits.drives import done, refused
from tests.kits.labelled_pictures import BOUNDS, write_picture_plan, write_stills


@pytest.fixture(scope="module")
def stills(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_stills(tmp_path_factory.mktemp("stills"))


def tuned(plan: Path, *words: object) -> dict:
    out = plan.parent / "out"
    done("tune", plan, "--no-figures", "--out", out, "--jobs", 1, *words)
    return json.loads((out / plan.stem / "study.json").read_text())


def test_each_block_is_scored_with_what_was_found_without_it(stills: Path) -> None:
    document = tuned(stills)
    rows = parquet.read_table(stills.parent / "out" / "stills" / "trials.parquet").to_pylist()
    scores = [row["line_f1_in_sample"] for row in rows]
    assert min(scores) < max(scores) == document["best"]["values"]["line_f1"]
    held_out, seen = document["held_out"], load_labelled(load_plan(stills))
    counts = np.concatenate(
        [
            counts_of(seen, study["point"], part)
            for study, part in zip(held_out["studies"], ([0, 1, 2], [3, 4, 5]), strict=True)
        ]
    )
    found, labels, right, lines = counts.sum(axis=0)
    assert held_out["all_frames"]["line_recall"] == pytest.approx(found / labels)
    assert held_out["all_frames"]["line_precision"] == pytest.approx(right / lines)


def test_the_block_that_is_held_out_is_not_looked_at(
    stills: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = studies.prepare(load_plan(stills), tmp_path)
    seen: list[str] = []
    read = picture_task.read_image
    monkeypatch.setattr(picture_task, "read_image", lambda p: (seen.append(p.name), read(p))[1])
    studies.run_share(made, 1)
    assert {int(name[6:12]) for name in seen} == {0, 1, 2}


def test_what_was_found_is_taken_by_an_experiment(stills: Path) -> None:
    document = tuned(stills)
    best = stills.parent / "out" / "stills" / "best.yaml"
    experiment = stills.parent / "seen.yaml"
    experiment.write_text(
        yaml.safe_dump(
            {
                "include": str(best),
                "name": "seen",
                "recording": {"path": "pics", "camera": "cam.yaml"},
                "n_lanes": 2,
            }
        )
    )
    recording = load_experiment(experiment).recording
    assert recording.detector == "ml"
    point = document["best"]["point"]
    assert {f"detector.{k}": v for k, v in recording.detector_parameters.items()} == point


def test_pictures_beside_a_labelled_one_are_a_clip_whose_valid_lines_count(
    stills: Path, tmp_path: Path
) -> None:
    clip = tmp_path / "clips" / "one"
    clip.mkdir(parents=True)
    still = cv2.imread(str(stills.parent / "pics" / "frame_000000.png"))
    for k in range(12):
        # A little brighter each time: the same picture again would be a frozen camera.
        cv2.imwrite(str(clip / f"{k + 1}.png"), cv2.add(still, np.full_like(still, k)))
    first = json.loads((stills.parent / "labels.jsonl").read_text().splitlines()[0])
    shutil.copy(stills.parent / "cam.yaml", tmp_path)
    for last, valid in ((12, 3), (2, 0)):
        named = {**first, "raw_file": f"clips/one/{last}.png"}
        (tmp_path / "labels.jsonl").write_text(json.dumps(named) + "\n")
        seen = load_labelled(load_plan(write_picture_plan(tmp_path / "clip.yaml")))
        assert len(seen.clips[0].pictures) == last
        point = {"detector.least_score": 0.12, "detector.least_contrast": 0.02}
        [counts] = counts_of(seen, point)
        assert counts.tolist() == [valid, 3, valid, valid]


def test_the_verb_of_python_takes_the_same_file(stills: Path) -> None:
    found = ego.tune(str(stills), trials=3, in_sample_only=True, seed=3)
    assert set(found.best) == set(BOUNDS)
    assert "line_f1" in repr(found)


def test_validate_counts_what_there_is(stills: Path) -> None:
    said = done("validate", stills).stdout
    assert "6 labelled pictures, 2 numbers searched" in said


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pictures": {"labels": "no.jsonl"}}, "pictures.labels: no file"),
        ({"pictures": {"camera": "no.yaml"}}, "pictures.camera: no file"),
        ({"pictures": {"detector": "sl"}}, "detector sl needs the pictures of a second camera"),
        ({"pictures": {"detectr": "ml"}}, "did you mean 'detector'?"),
        ({"pictures": {"frames": [4, 7]}}, "has 6 labelled pictures"),
        ({"pictures": {"frames": [4, 4]}}, "[4, 4] is an empty range"),
        ({"tuning": {"objective": "line_f2"}}, "did you mean 'line_f1'?"),
        ({"tuning": {"parameters": {}}}, "name what is searched, with bounds"),
        ({"tuning": {"blocks": 7}}, "7 blocks are more than the 6 frames"),
    ],
)
def test_bad_plans_are_refused_in_one_line(
    stills: Path, changes: dict[str, dict[str, object]], message: str
) -> None:
    content = yaml.safe_load(stills.read_text())
    for section, keys in changes.items():
        content[section] |= keys
    path = stills.with_name("bad.yaml")
    path.write_text(yaml.safe_dump(content))
    assert message in refused("tune", path, "--out", stills.parent / "bad")


@pytest.mark.parametrize("option", ["--together", "--whole-recordings"])
def test_what_goes_with_recordings_only_is_refused(stills: Path, option: str) -> None:
    said = refused("tune", stills, "--out", stills.parent / "bad", option)
    assert f": {option.strip('-').replace('-', '_')}: " in said


def test_a_missing_picture_is_named(stills: Path, tmp_path: Path) -> None:
    shutil.copytree(stills.parent, tmp_path / "copy")
    (tmp_path / "copy" / "pics" / "frame_000003.png").unlink()
    said = refused("tune", tmp_path / "copy" / "stills.yaml", "--out", tmp_path / "out")
    assert "frame_000003.png" in said

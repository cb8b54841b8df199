"""The parameters of a detector are searched on pictures whose lines are labelled."""

from __future__ import annotations

import json
import pickle
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from pyarrow import parquet

import egolane_pgm as ego
from egolane_pgm.experiment import load_experiment
from egolane_pgm.tuning import pictures as on_pictures
from egolane_pgm.tuning.plan import read_plan
from tests.kits.drives import done, refused
from tests.kits.labelled_pictures import write_labelled

FAINT = (1.0, 0.2, 0.1, 0.07, 0.04, 0.02)
BOUNDS = {"detector.least_contrast": [0.005, 0.5], "detector.least_score": [0.02, 0.9]}


@pytest.fixture(scope="module")
def stills(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan for six labelled stills whose marking is fainter from one to the next."""
    folder = tmp_path_factory.mktemp("stills")
    labels = write_labelled(folder)
    first = json.loads(labels.read_text().splitlines()[0])
    image = cv2.imread(str(folder / first["raw_file"])).astype(np.float64)
    with labels.open("w") as file:
        for k, share in enumerate(FAINT):
            name = f"pics/frame_{k:06d}.png"
            grey = np.median(image) + share * (image - np.median(image))
            cv2.imwrite(str(folder / name), grey.astype(np.uint8))
            file.write(json.dumps({**first, "raw_file": name}) + "\n")
    return write_plan(folder / "stills.yaml")


def write_plan(path: Path, **tuning: object) -> Path:
    content = {
        "name": path.stem,
        "pictures": {"labels": "labels.jsonl", "camera": "cam.yaml", "detector": "ml"},
        "tuning": {"trials": 8, "blocks": 2, "parameters": BOUNDS, **tuning},
    }
    path.write_text(yaml.safe_dump(content))
    return path


def tuned(plan: Path, *words: object) -> dict:
    out = plan.parent / "out"
    done("tune", plan, "--no-figures", "--out", out, "--jobs", 1, *words)
    return json.loads((out / plan.stem / "study.json").read_text())


def test_a_study_finds_better_values_and_says_what_they_are_worth_held_out(stills: Path) -> None:
    document = tuned(stills)
    rows = parquet.read_table(stills.parent / "out" / "stills" / "trials.parquet").to_pylist()
    scores = [row["line_f1_in_sample"] for row in rows]
    assert len(rows) == 8
    assert max(scores) > min(scores)
    assert document["best"]["values"]["line_f1"] == max(scores)
    assert document["in_sample"]["all_frames"]["line_f1"] == max(scores)
    held_out = document["held_out"]
    assert held_out["tuned_on"] == "other_frames"
    assert [study["part"] for study in held_out["studies"]] == [1, 2]
    # Each block is scored with what was found without it.
    problem = on_pictures.make_problem(read_plan(stills))
    counts = np.concatenate(
        [
            on_pictures.counts_of(problem, study["point"], part)
            for study, part in zip(held_out["studies"], ([0, 1, 2], [3, 4, 5]), strict=True)
        ]
    )
    found, labels, right, lines = counts.sum(axis=0)
    assert held_out["all_frames"]["line_recall"] == pytest.approx(found / labels)
    assert held_out["all_frames"]["line_precision"] == pytest.approx(right / lines)


def test_the_block_that_is_held_out_is_not_looked_at(
    stills: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[str] = []
    read = on_pictures.read_image
    monkeypatch.setattr(on_pictures, "read_image", lambda p: (seen.append(p.name), read(p))[1])
    on_pictures._without(pickle.dumps(read_plan(stills)), 1)
    assert {int(name[6:12]) for name in seen} == {0, 1, 2}


def test_the_same_command_goes_on_and_another_search_is_told_apart(stills: Path) -> None:
    tuned(stills)
    assert tuned(stills, "--trials", 10)["best"]["trials"] == 10
    said = refused("tune", stills, "--out", stills.parent / "out", "--seed", 5)
    assert "the storage holds another study of this name (seed: 0, now 5)" in said


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
        problem = on_pictures.make_problem(read_plan(write_plan(tmp_path / "clip.yaml")))
        assert len(problem.clips[0].pictures) == last
        point = {"detector.least_score": 0.12, "detector.least_contrast": 0.02}
        [counts] = on_pictures.counts_of(problem, point)
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


@pytest.mark.parametrize("words", [("--workers", 2), ("--together",), ("--whole-recordings",)])
def test_what_goes_with_recordings_only_is_refused(stills: Path, words: tuple[object]) -> None:
    said = refused("tune", stills, "--out", stills.parent / "bad", *words)
    assert f": {str(words[0]).strip('-').replace('-', '_')}: " in said


def test_a_missing_picture_is_named(stills: Path, tmp_path: Path) -> None:
    shutil.copytree(stills.parent, tmp_path / "copy")
    (tmp_path / "copy" / "pics" / "frame_000003.png").unlink()
    said = refused("tune", tmp_path / "copy" / "stills.yaml", "--out", tmp_path / "out")
    assert "frame_000003.png" in said

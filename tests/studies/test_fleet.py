"""One parameter set for the drives of a fleet: all frames alike, and drives held out whole."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

import egolane_pgm as ego
from egolane_pgm.drive import Drive, belief_of
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.confusion import accuracy, confusion, macro_f1
from egolane_pgm.scoring.probabilistic import brier, log_loss
from egolane_pgm.tuning.assess import assess, difference
from egolane_pgm.tuning.objective import all_used, scores_of
from egolane_pgm.tuning.plan import Problem, load_plan, make_problem, with_options
from egolane_pgm.tuning.recording_task import beliefs_at, without_part
from egolane_pgm.types import InputError
from egolane_pgm.verbs.tune import on_fleet
from tests.kits.drives import done, refused
from tests.kits.tuning_kit import QUICKSTART

ROWS = ("a,1,150,sun", "b,2,250,rain", "c,3,200,sun", "d,4,160,rain")
NAMES = ["a", "b", "c", "d"]
SCRATCH = ("--set", "tuning.from_scratch=true")


def table(folder: Path, rows: tuple[str, ...] = ROWS, lanes: str = "4") -> Path:
    path = folder / "drives.csv"
    named = [row.split(",") for row in rows]
    cells = [f'{n},{seed},"[0, {stop}]",{lanes},{tag}' for n, seed, stop, tag in named]
    head = "name,recording.seed,recording.frames,n_lanes,tag.weather"
    path.write_text("\n".join([head, *cells]))
    return path


def problem(folder: Path, by_tag: str | None = None, **options: object) -> Problem:
    plan = with_options(load_plan(QUICKSTART), options)
    return make_problem(on_fleet(plan, table(folder), by_tag, ()))


def test_all_frames_of_a_fleet_count_alike(tmp_path: Path) -> None:
    drives = problem(tmp_path).drives
    sets = [dict(drive.model.parameters) for drive in drives]
    names = ("accuracy", "f1", "log_loss", "brier", "false_switches_per_minute")
    used = [np.arange(len(drive)) > 20 for drive in drives]
    found = scores_of(drives, sets, used, names, together=True)
    beliefs = [belief_of(drive, drive.model.parameters) for drive in drives]
    belief = np.concatenate([b[u] for b, u in zip(beliefs, used, strict=True)])
    lane = np.concatenate([d.truth.lane[u] for d, u in zip(drives, used, strict=True)])
    crossing = np.concatenate([d.truth.is_crossing[u] for d, u in zip(drives, used, strict=True)])
    matrix = confusion(assigned_lane(belief), lane, crossing, 4)
    right = [float(accuracy(matrix)), float(macro_f1(matrix)), log_loss(belief, lane)]
    assert found[:4] == pytest.approx([*right, brier(belief, lane, crossing)], rel=1e-12)
    apart = scores_of(drives, sets, used, names)
    assert np.abs(np.subtract(apart, found)).min() > 1e-6
    alone = scores_of(drives[:1], sets[:1], used[:1], names)
    assert scores_of(drives[:1], sets[:1], used[:1], names, together=True) == alone


def believed(drives: tuple[Drive, ...]) -> list[np.ndarray]:
    return [belief_of(drive, drive.model.parameters) for drive in drives]


def test_scores_of_a_fleet_are_those_of_all_its_frames(tmp_path: Path) -> None:
    drives = problem(tmp_path).drives
    beliefs, keep = believed(drives), all_used(drives)
    found = assess(drives, beliefs, keep, drive_of=NAMES)
    sets = [dict(drive.model.parameters) for drive in drives]
    names = ("accuracy", "precision", "recall", "f1", "log_loss", "brier")
    right = scores_of(drives, sets, keep, names, together=True)
    assert [found[name] for name in names] == pytest.approx(right, rel=1e-12)
    assert [each["name"] for each in found["recordings"]] == NAMES
    worse = [np.roll(belief, 1, axis=1) for belief in beliefs]
    less = difference(drives, beliefs, worse, keep, drive_of=NAMES)
    other = assess(drives, worse, keep, drive_of=NAMES)
    for name in ("accuracy", "f1", "log_loss"):
        low, high = less["intervals"][name]
        assert low <= less[name] <= high
        assert less[name] == pytest.approx(found[name] - other[name], rel=1e-9)
        low, high = found["intervals"][name]
        assert low < found[name] < high
    twice = assess(drives * 2, beliefs * 2, keep * 2, drive_of=NAMES * 2)
    assert twice["intervals"]["f1"] == pytest.approx(found["intervals"]["f1"])
    each = [one["accuracy"] for one in found["recordings"]]
    low, high = found["intervals"]["accuracy"]
    assert min(each) <= low < high <= max(each)


def test_a_part_is_searched_for_without_its_drives(tmp_path: Path) -> None:
    whole = problem(tmp_path, by_tag="weather")
    assert [list(part) for part in whole.parts] == [[0, 2], [1, 3]]
    smaller, _ = without_part(whole, 0)
    assert [drive.experiment.name for drive in smaller.drives] == ["b", "d"]
    assert len(smaller.spaces) == 2
    three = problem(tmp_path, blocks=3)
    assert [list(part) for part in three.parts] == [[0, 1], [2], [3]]


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_fleet_is_searched_and_goes_on(tmp_path: Path, jobs: int) -> None:
    words = ("tune", QUICKSTART, "--fleet", table(tmp_path), "--by-tag", "weather")
    options = ("--sampler", "random", *SCRATCH, "--no-figures", "--jobs", jobs)
    place = tmp_path / "out"
    said = done(*words, *options, "--trials", "3", "--out", place).stdout
    assert "weather rain" in said
    assert "with parameters found without it" in said
    assert "over drives, which are drawn whole" in said.replace("\n", " ")
    found = json.loads((place / "quickstart_drives" / "study.json").read_text())
    assert found["fleet"]["parts"] == [["a", "c"], ["b", "d"]]
    assert [each["left_out"] for each in found["held_out"]["studies"]] == ["a, c", "b, d"]
    # Drives are scored with what was found without them.
    whole = problem(tmp_path, by_tag="weather")
    for part, study in enumerate(found["held_out"]["studies"]):
        beliefs = beliefs_at(whole, [study["point"]])
        for k in whole.parts[part]:
            drive = whole.drives[k]
            right = assess([drive], [beliefs[k]], all_used([drive]))["accuracy"]
            assert found["held_out"]["all_frames"]["recordings"][k]["accuracy"] == right
    values = [float(v) for v in found["best"]["values"].values()]
    assert values == [found["in_sample"]["all_frames"]["accuracy"]]
    best = yaml.safe_load((place / "quickstart_drives" / "best.yaml").read_text())
    assert best["tuned_on"] == "unknown"
    assert best["recording"]["seed"] == 0
    assert "tuned for accuracy: 3 trials on 4 recordings" in best["description"]
    if jobs == 1:
        nested = (place / "quickstart_drives" / "nested.json").read_bytes()
        again = ego.tune(
            QUICKSTART,
            fleet=table(tmp_path),
            by_tag="weather",
            trials=3,
            sampler="random",
            overrides={"tuning.from_scratch": True},
            out=place,
        )
        assert again.studies[0].study["best"]["trials"] == 3
        assert (place / "quickstart_drives" / "nested.json").read_bytes() == nested
        assert "held out" in again._repr_html_()


def test_a_fleet_of_one_drive_is_searched_on_as_its_recording(tmp_path: Path) -> None:
    options = {"sampler": "random", "trials": 3}
    scratch = {"tuning.from_scratch": True}
    fleet = table(tmp_path, ("a,0,2400,sun",))
    one = ego.tune(QUICKSTART, fleet=fleet, overrides=scratch, **options)  # type: ignore[arg-type]
    keys = {"recording.frames": [0, 2400], **scratch}
    plain = ego.tune(QUICKSTART, overrides=keys, **options)  # type: ignore[arg-type]
    assert one.names == ["quickstart_drives"]
    for key in ("best", "in_sample", "held_out"):
        first, second = (dict(each.studies[0].study[key]) for each in (one, plain))
        for each in (first, second):
            each.pop("seconds", None)
            each.pop("parameters", None)
        assert first == second


def test_what_does_not_go_with_a_fleet_is_refused(tmp_path: Path) -> None:
    words = ("tune", QUICKSTART, "--fleet", table(tmp_path))
    assert refused(*words, "--together").startswith("--fleet: its drives are tuned together")
    assert refused("tune", QUICKSTART, "--by-tag", "road") == "--by-tag: goes with a fleet"
    assert "has no tag.road" in refused(*words, "--by-tag", "road")
    missing = tmp_path / "missing.csv"
    missing.write_text("name,recording,ground_truth,n_lanes\na,x.csv,t.txt,4\nb,x.csv,t.txt,4\n")
    with pytest.raises(InputError) as wrong:
        ego.tune(QUICKSTART, fleet=missing)
    assert "x.csv" in str(wrong.value) or "t.txt" in str(wrong.value)
    several = tmp_path / "several.yaml"
    several.write_text(f"name: s\nexperiments: [{QUICKSTART}, {QUICKSTART}]\n")
    assert "fleet: goes with one experiment" in refused("tune", several, *words[2:])

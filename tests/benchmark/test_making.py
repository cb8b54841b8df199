"""Drives made of real ones: what a donor's detector saw, in lanes that another car drove."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import egolane_pgm as ego
from egolane_pgm.benchmark import uah
from egolane_pgm.benchmark.entries import by_experiment
from egolane_pgm.benchmark.making import (
    DONORS,
    checksum,
    donor,
    driven,
    make_tracks,
    make_uah,
    paper_log,
    stretches_of,
)
from egolane_pgm.benchmark.scored import score_recording
from egolane_pgm.benchmark.tracks import Recording, read_tracks
from egolane_pgm.paper import paper_experiment
from egolane_pgm.simulation.transplanting import Donor, donor_of, transplanted
from egolane_pgm.simulation.transplanting import Path as Driven
from egolane_pgm.types import LaneTruth, LineLog

ANNOTATIONS = Path(ego.__file__).parent / "benchmark" / "rotterdam" / "annotations.csv"


def tidy_log(across: np.ndarray, n_lanes: int, width_m: float) -> LineLog:
    """Every line of the road that is within 9 m, where it is, the edges continuous."""
    lines = np.arange(n_lanes + 1)
    offset = (lines - across[:, None]) * width_m
    edge = np.isin(lines, (0, n_lanes))
    seen = np.abs(offset) < 9
    return LineLog(
        np.arange(len(across)),
        np.arange(len(across)) / 10,
        np.where(seen, offset, np.nan),
        seen,
        seen & edge,
        np.where(seen, 10.0, np.nan),
    )


def tidy_donor() -> Donor:
    across = np.clip(0.5 + np.repeat(np.arange(3), 600) + 0.1 * np.sin(np.arange(1800) / 40), 0, 3)
    # Two changes to the right and two back, each of three seconds.
    across = np.concatenate([across, across[::-1]])
    across = np.convolve(np.pad(across, 15, mode="edge"), np.ones(31) / 31, mode="valid")
    path = Driven(across, 3)
    return donor_of(tidy_log(across, 3, 3.5), path.truth(), 3, 3.5)


def test_a_donor_knows_where_its_car_was_and_which_line_is_which() -> None:
    found = tidy_donor()
    truth = found.path.truth()
    assert (found.path.lane() == truth.lane).all()
    assert len(found.change_at) == 4
    assert np.abs(found.place[found.number >= 0]).max() < 0.1
    assert found.continuous.tolist() == [1.0, 0.0, 1.0]


def test_lines_stand_where_the_new_road_has_them() -> None:
    path = driven([(20.0, 1, 2), (40.0, 2, 1)], 600, 2, np.random.default_rng(0))
    log = transplanted(tidy_donor(), path, np.random.default_rng(1))
    lattice, where = log.is_valid, path.across[:, None] + log.offset_m / 3.5
    assert np.abs(where - np.round(where))[lattice].max() < 0.15
    # The road has two lanes: no line of the third is left.
    assert np.round(where[lattice]).max() == 2
    # The donor's inner lines stand at the edge now, and are drawn as its edges were.
    assert log.is_continuous[lattice & (np.round(where) == 2)].all()
    assert not log.is_continuous[lattice & (np.round(where) == 1)].any()


def test_a_path_makes_the_changes_that_were_annotated() -> None:
    path = driven([(20.0, 3, 1), (40.0, 1, 2)], 600, 4, np.random.default_rng(0))
    truth = path.truth()
    assert truth.lane[[0, 300, 599]].tolist() == [3, 1, 2]
    spread = path.across[450:] - np.floor(path.across[450:])
    assert 0.02 < spread.std() < 0.3
    assert truth.is_crossing.sum() == pytest.approx(60, abs=25)


def test_a_stretch_has_one_number_of_lanes_and_changes_that_follow() -> None:
    found = stretches_of(ANNOTATIONS)
    assert len(found) == 26
    for begin_s, end_s, n_lanes, changes in found:
        assert 2 <= n_lanes <= 5
        assert end_s - begin_s >= 15
        assert all(begin_s < when < end_s for when, _, _ in changes)
        assert all(a[2] == b[1] for a, b in pairwise(changes))


@pytest.mark.parametrize("run", [1, 6])
def test_on_its_own_drive_a_donors_lines_score_as_they_did(run: int, recordings: Path) -> None:
    log, truth, n_lanes = paper_log(run)
    name = DONORS[run][0]
    own = Recording("own", name, name, name, name, n_lanes, log, truth)
    again = replace(own, log=transplanted(donor(run), donor(run).path, np.random.default_rng(0)))
    rule = ego.experiments_folder() / "benchmark" / "rule.yaml"
    for experiment, tolerance in (
        ("zero_label", 0.02),
        (paper_experiment(run), 0.06),
        (rule, 0.08),
    ):
        loaded = ego.load_experiment(experiment)
        shares = [
            found["right"] / found["scored"]
            for each in (own, again)
            for found in [score_recording(each, by_experiment(loaded, each))]
        ]
        assert shares[1] == pytest.approx(shares[0], abs=tolerance)


def test_the_tracks_are_made_byte_for_byte(tmp_path: Path, recordings: Path) -> None:
    said = make_tracks(tmp_path, None)
    assert [line.split(":")[0] for line in said] == ["paper", "rotterdam"]
    assert all("(as published)" in line for line in said)
    (tmp_path / "paper" / "italy-n4-italy_ml.txt").write_text("0;1;0\n")
    assert checksum(tmp_path / "paper") not in said[0]
    with pytest.raises(ego.InputError, match="is not empty"):
        make_tracks(tmp_path, None)


# --- UAH-DriveSet ------------------------------------------------------------------------------


def write_uah(copy: Path, kinds: list[int], jumps: list[int]) -> Path:
    """A drive of a minute, thirty frames a second; its car goes right (1) or left (-1) as `jumps`
    say at 20 and 40 s, and its list says `kinds`."""
    folder = copy / "D1" / "20151111123124-24km-D1-NORMAL1-MOTORWAY"
    folder.mkdir(parents=True)
    time_s = np.arange(0, 60, 1 / 30)
    across = sum(
        way * np.clip((time_s - when) / 4 + 0.5, 0, 1)
        for when, way in zip((20, 40), jumps, strict=True)
    )
    place = across - np.round(across)
    state = np.where((time_s > 5) & (time_s < 6), 1, 2)
    columns = [time_s, 3.6 * place, 0 * time_s, np.full(len(time_s), 3.6), state]
    np.savetxt(folder / "PROC_LANE_DETECTION.txt", np.column_stack(columns), fmt="%.3f")
    rows = [f"{when} {kind} 0 0 0 0" for when, kind in zip((20, 40), kinds, strict=True)]
    (folder / "EVENTS_LIST_LANE_CHANGES.txt").write_text("\n".join(rows) + "\n")
    return copy


def test_two_lines_of_the_cars_own_lane_are_read(tmp_path: Path) -> None:
    [(name, (log, path))] = uah.drives_of(write_uah(tmp_path, [-1, 2], [-1, 1])).items()
    assert name == "24km-d1-normal-0"
    assert path.lane()[[10, 300, 590]].tolist() == [3, 2, 3]
    assert np.flatnonzero(np.diff(path.lane())).tolist() == pytest.approx([200, 400], abs=1)
    seen = log.is_valid.all(axis=1)
    assert not seen[52:59].any()
    assert np.ptp(log.offset_m[seen], axis=1) == pytest.approx(3.6)
    assert seen.mean() == pytest.approx(59 / 60, abs=0.01)


@pytest.mark.parametrize(
    ("kinds", "jumps"),
    [([1, 1], [1, 1]), ([-1, -1], [1, 1])],
    ids=["right of the rightmost lane", "against the list"],
)
def test_a_drive_that_does_not_confirm_its_list_is_left_out(
    tmp_path: Path, kinds: list[int], jumps: list[int]
) -> None:
    with pytest.raises(ego.InputError, match="no folder"):
        uah.drives_of(write_uah(tmp_path, kinds, jumps))


def test_a_file_that_is_no_table_is_named(tmp_path: Path) -> None:
    write_uah(tmp_path, [-1, 1], [-1, 1])
    [file] = tmp_path.glob("**/PROC_LANE_DETECTION.txt")
    for text, said in (("a b c\n", "is no table of numbers"), ("1 2 3\n", "has 3 columns")):
        file.write_text(text)
        with pytest.raises(ego.InputError, match=said):
            uah.drives_of(tmp_path)


def test_a_copy_of_uah_makes_two_tracks(tmp_path: Path, recordings: Path) -> None:
    folders = [tmp_path / name for name in ("two_lines", "motion")]
    for folder in folders:
        folder.mkdir()
    make_uah(write_uah(tmp_path / "copy", [-1, 1], [-1, 1]), *folders)
    found = read_tracks(folders)
    assert sorted({(each.track, each.n_lanes) for each in found}) == [
        ("motion, 3 lanes", 3),
        ("motion, 4 lanes", 4),
        ("motion, 5 lanes", 5),
        ("two_lines", 3),
    ]
    assert all(isinstance(each.truth, LaneTruth) and each.driver == "d1" for each in found)

"""The benchmark: its tracks are made byte for byte, entries are scored and set side by side."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import numpy as np
import pytest

import egolane_pgm as ego
from egolane_pgm.types import LineLog, lane_truth
from makers.benchmark.board import board, resamples, run_on, score_entry, score_recording
from makers.benchmark.tracks import (
    HERE,
    Recording,
    driven,
    make_tracks,
    read_tracks,
    uah_drives,
    write_recording,
)
from makers.benchmark.transplanting import Donor, donor_of, transplanted
from makers.benchmark.transplanting import Path as Driven
from tests.kits.drives import short_drive

#: The sha256 of the tracks, of what the recordings and tiny inputs give.
PAPER = "53104958f0b653da015a5ded07f71affc1e94fea2676ba8cb3b942368a65629d"
ROTTERDAM = "915ce4a75b634d7473d6cdebe6ac13f43c344241242c30912e28994ac4d6e529"
MOTION = "a58cdcd4150dd95f4032e0eee0ebd41bc283760d5c6362d6539a252f9aa80a08"
TIDY = "e7f80feaa6c945887fc80f12472e764b8719629190271816b09f0c96ab778983"
TINY_UAH = "989555e11847331ca5ef04cc0f6c1962888cf977a6b3f66a45aaedf93b1a7d8f"

#: A car that drives in lane 1 for ten seconds, crosses for two and drives in lane 2 for eight.
LANE = np.repeat([1, 1, 2, 2], [100, 10, 10, 80])
CROSSING = np.repeat([False, True, False], [100, 20, 80])


def checksum(folder: Path) -> str:
    found = hashlib.sha256()
    for file in sorted(folder.iterdir()):
        found.update(file.name.encode() + b"\0" + file.read_bytes())
    return found.hexdigest()


# --- tracks ------------------------------------------------------------------------------------


def tidy_donor() -> Donor:
    """Every line of a road of three lanes that is within 9 m, the edges continuous."""
    across = np.clip(0.5 + np.repeat(np.arange(3), 600) + 0.1 * np.sin(np.arange(1800) / 40), 0, 3)
    # Two changes to the right and two back, each of three seconds.
    across = np.concatenate([across, across[::-1]])
    across = np.convolve(np.pad(across, 15, mode="edge"), np.ones(31) / 31, mode="valid")
    lines, frame = np.arange(4), np.arange(len(across))
    offset = (lines - across[:, None]) * 3.5
    seen = np.abs(offset) < 9
    unknown, edge = np.where(seen, 10.0, np.nan), np.isin(lines, (0, 3))
    log = LineLog(frame, frame / 10, np.where(seen, offset, np.nan), seen, seen & edge, unknown)
    return donor_of(log, Driven(across, 3).truth(), 3, 3.5)


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


def test_lines_stand_in_the_new_road_byte_for_byte(tmp_path: Path) -> None:
    for n_lanes in (2, 4):
        path = driven([(20.0, 1, 2), (40.0, 2, 1)], 600, n_lanes, np.random.default_rng(0))
        log = transplanted(tidy_donor(), path, np.random.default_rng(1))
        where = (path.across[:, None] + log.offset_m / 3.5)[log.is_valid]
        assert np.abs(where - np.round(where)).max() < 0.15
        # A road of two lanes has no line of the donor's third.
        assert np.round(where).max() <= n_lanes
        assert path.truth()["true_lane"].to_numpy()[[0, 300, 599]].tolist() == [1, 2, 1]
        write_recording(tmp_path / f"trip1-n{n_lanes}-tidy", log, path.truth())
    assert checksum(tmp_path) == TIDY


def test_two_lines_of_uah_are_read_byte_for_byte(tmp_path: Path) -> None:
    [(name, (log, path))] = uah_drives(write_uah(tmp_path / "copy", [-1, 2], [-1, 1])).items()
    assert path.lane()[[10, 300, 590]].tolist() == [3, 2, 3]
    (tmp_path / "track").mkdir()
    write_recording(tmp_path / "track" / f"{name}-n3", log, path.truth())
    assert checksum(tmp_path / "track") == TINY_UAH


@pytest.mark.parametrize(("kinds", "jumps"), [([1, 1], [1, 1]), ([-1, -1], [1, 1])])
def test_a_drive_that_does_not_confirm_its_list_is_left_out(
    tmp_path: Path, kinds: list[int], jumps: list[int]
) -> None:
    with pytest.raises(ego.InputError, match="no folder"):
        uah_drives(write_uah(tmp_path, kinds, jumps))


def test_the_tracks_are_made_byte_for_byte(tmp_path: Path, recordings: Path) -> None:
    make_tracks(tmp_path / "tracks", write_uah(tmp_path / "copy", [-1, 1], [-1, 1]))
    made = {folder.name: checksum(folder) for folder in (tmp_path / "tracks").iterdir()}
    expected = {"paper": PAPER, "rotterdam": ROTTERDAM, "two_lines": TINY_UAH, "motion": MOTION}
    assert made == expected
    found = read_tracks([tmp_path / "tracks" / "motion"])
    assert {each.track for each in found} == {f"motion, {n} lanes" for n in (3, 4, 5)}
    assert {(each.driver, each.drive) for each in found} == {("d1", "24km-d1-normal-0")}


# --- scores ------------------------------------------------------------------------------------


def recording(name: str = "d1-a", n_lanes: int = 3) -> Recording:
    frame = np.arange(200)
    truth = lane_truth(frame, LANE, CROSSING)
    log = short_drive(200).log
    return Recording("track", name, name.split("-")[0], name, "", n_lanes, log, truth)


def test_ties_and_silence_are_wrong_and_each_lane_counts_alike() -> None:
    always_1 = np.eye(3)[np.zeros(200, dtype=int)]
    found = score_recording(recording(), always_1)
    # Lane 1 always right, lane 2 never, lane 3 not driven; 100 of 180 frames.
    assert (found["recalls"], found["lanes_driven"]) == (1.0, 2.0)
    assert (found["right"], found["scored"], found["sure_right"]) == (100.0, 180.0, 100.0)
    belief = np.where(np.arange(200)[:, None] < 100, 1 / 3, 0.0) * np.ones(3)
    found = score_recording(recording(), belief)
    assert (found["right"], found["recalls"], found["sure"]) == (0.0, 0.0, 0.0)


def test_a_folder_of_beliefs_is_scored_beside_experiments(tmp_path: Path) -> None:
    drives = [recording("d1-a"), recording("d2-b")]
    folder = tmp_path / "mine"
    folder.mkdir()
    for each in drives:
        rows = [f"{t};{int(lane == 1)};{int(lane == 2)};0" for t, lane in enumerate(LANE) if t > 49]
        (folder / f"{each.name}.csv").write_text("\n".join(["frame_id;p1;p2;p3", *rows]) + "\n")
    entry = HERE / "entries" / "7_rule.yaml"
    scored = dict(score_entry(drives, place) for place in (folder, entry))
    # Silent for half of lane 1, right after that.
    assert scored["mine"]["recalls"].tolist() == [1.5, 1.5]
    assert scored["mine"]["sure"].tolist() == [130, 130]
    text = board(drives, scored)
    assert re.search(r"\| mine +\| 0.750 \[0.750, 0.750\] \|", text)
    assert re.search(r"\| paper's rule, frame by frame \| \+0.312 ", text)
    (folder / "d1-a.csv").write_text("frame_id;p1;p2;p3\n0;.5;.1;0\n")
    with pytest.raises(ego.InputError, match=r"d1-a\.csv: needs p1 to p3"):
        score_entry(drives, folder)


@pytest.mark.parametrize("entry", sorted((HERE / "entries").glob("*.yaml")), ids=lambda p: p.stem)
def test_every_entry_but_one_is_causal(entry: Path) -> None:
    found = run_on(recording(), ego.load_experiment(entry)).run
    # With a given lane width the flags are read from the whole recording.
    assert found["is_causal"] == (entry.stem != "3_width_not_estimated")


def test_resamples_draw_drivers_then_all_recordings_of_a_drive() -> None:
    weights = resamples([recording(name) for name in ("a-0", "a-0", "a-1", "b-0")])
    assert (weights[0] == 1).all()
    assert (weights[:, 0] == weights[:, 1]).all()
    # Of two drivers two are drawn: a has two drives, so a draw of it gives two of them.
    assert (weights[:, 0] + weights[:, 2] + 2 * weights[:, 3] == 4)[1:].all()

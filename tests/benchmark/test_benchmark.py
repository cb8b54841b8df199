"""The benchmark: entries are read, scored, checked to be causal, and set side by side."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import egolane_pgm as ego
from egolane_pgm.benchmark.board import Board, kind_of, read_board
from egolane_pgm.benchmark.causality import check_causality
from egolane_pgm.benchmark.entries import (
    Answer,
    by_command,
    by_experiment,
    by_folder,
    command_words,
)
from egolane_pgm.benchmark.scored import Entry, resamples, score_entry, score_recording
from egolane_pgm.benchmark.tracks import Recording, read_tracks, write_recording
from egolane_pgm.simulation import simulate
from egolane_pgm.types import LaneTruth
from egolane_pgm.verbs.benchmark import board, score
from tests.kits.drives import done, short_drive

EXAMPLE = Path(__file__).parents[2] / "examples" / "benchmark_entry.py"

#: A car that drives in lane 1 for ten seconds, crosses for two and drives in lane 2 for eight.
LANE = np.repeat([1, 1, 2, 2], [100, 10, 10, 80])
CROSSING = np.repeat([False, True, False], [100, 20, 80])


def recording(name: str = "d1-a", track: str = "track", n_lanes: int = 3) -> Recording:
    drive = short_drive(200)
    frame = np.arange(200)
    log = replace(drive.log, frame_id=frame, time_s=frame / 10)
    truth = LaneTruth(frame, LANE, CROSSING)
    return Recording(track, name, name.split("-")[0], name, "", n_lanes, log, truth)


def sure_of(lane: np.ndarray, n_lanes: int = 3) -> np.ndarray:
    return (lane[:, None] == np.arange(1, n_lanes + 1)).astype(float)


def write_answer(folder: Path, name: str, belief: np.ndarray, events: str = "") -> None:
    header = ";".join(["frame_id", *(f"p{k + 1}" for k in range(belief.shape[1]))])
    rows = [";".join(map(str, [t, *row])) for t, row in enumerate(belief)]
    (folder / f"{name}.csv").write_text("\n".join([header, *rows]) + "\n")
    (folder / f"{name}.events.csv").write_text(f"told_frame;from;to\n{events}")


@pytest.fixture
def tracks(tmp_path: Path) -> Path:
    folder = tmp_path / "bench" / "track"
    folder.mkdir(parents=True)
    for name in ("d1-a-n3-x", "d2-b-n3-y"):
        write_recording(folder, name, recording().log, recording().truth)
    return folder


def test_balanced_accuracy_counts_each_lane_of_a_drive_alike() -> None:
    found = score_recording(recording(), Answer(sure_of(np.ones(200, dtype=int))))
    # Lane 1 always right, lane 2 never, lane 3 not driven; 100 of 180 frames.
    assert (found["recalls"], found["lanes_driven"]) == (1.0, 2.0)
    assert (found["right"], found["scored"], found["sure_right"]) == (100.0, 180.0, 100.0)
    assert (found["wrong_s"], found["beginning"]) == (8.0, 180.0)


def test_ties_and_silence_are_wrong() -> None:
    belief = np.where(np.arange(200)[:, None] < 100, 1 / 3, 0.0) * np.ones(3)
    found = score_recording(recording(), Answer(belief))
    assert (found["right"], found["recalls"], found["sure"]) == (0.0, 0.0, 0.0)


def test_a_reported_change_is_right_within_two_seconds(tmp_path: Path) -> None:
    write_answer(tmp_path, "d1-a", sure_of(LANE), "130;1;2\n170;2;3\n")
    found = score_recording(recording(), by_folder(tmp_path, recording()))
    assert [found[f"changes{k}"] for k in ("", "_right", "_false")] == [1.0, 1.0, 1.0]
    assert found["delays_s"] == [1.0]


def test_an_entry_that_finds_the_number_of_lanes_may_find_another_one(tmp_path: Path) -> None:
    write_answer(tmp_path, "d1-a", sure_of(LANE, 2))
    answer = by_folder(tmp_path, replace(recording(), n_lanes=0))
    found = score_recording(recording(), answer)
    assert (found["lanes_found"], found["right"]) == (0.0, 180.0)


@pytest.mark.parametrize(
    ("belief", "events", "said"),
    [
        ("frame_id;p1;p2\n0;1;0\n", None, "not frame_id;p1;p2;p3"),
        ("frame_id;p1;p2;p3\n0;.5;.1;0\n", None, "frame 0 has numbers that do not sum to 1"),
        ("frame_id;p1;p2;p3\n999;1;0;0\n", None, "frame 999 is not in the recording"),
        ("frame_id;p1;p2;p3\n5;1;0;0\n4;1;0;0\n", None, "frame 4 does not come in order"),
        ("frame_id;p1;p2;p3\n0;x;0;0\n", None, "is no table of numbers with semicolons"),
        ("frame_id;p1;p2;p3\n0;1;0;0\n", "frame;from;to\n", "not told_frame;from;to"),
        ("frame_id;p1;p2;p3\n0;1;0;0\n", "told_frame;from;to\n999;1;2\n", "frame 999 is not in"),
    ],
)
def test_an_answer_that_is_none_is_refused(
    tmp_path: Path, belief: str, events: str | None, said: str
) -> None:
    (tmp_path / "d1-a.csv").write_text(belief)
    if events is not None:
        (tmp_path / "d1-a.events.csv").write_text(events)
    with pytest.raises(ego.InputError, match=said):
        by_folder(tmp_path, recording())


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({}, "has no NAME.csv with its lanes in NAME.txt"),
        ({"a-n3.txt": "0;1;0\n"}, "no such file"),
        ({"a.txt": "0;1;0\n", "a.csv": "frame_id,offset_m\n0,1\n"}, "how many lanes there are"),
        ({"a-n3.txt": "0;4;0\n", "a-n3.csv": "frame_id,offset_m\n0,1\n"}, "lane 4 is outside"),
        ({"a-n3.txt": "0;1;0\n", "a-n3.csv": "frame_id,offset_m\n1,1\n"}, "has other frames"),
    ],
)
def test_a_track_that_is_none_is_refused(tmp_path: Path, files: dict[str, str], said: str) -> None:
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(ego.InputError, match=said):
        read_tracks([tmp_path])


def test_a_drive_with_several_numbers_of_lanes_is_on_several_tracks(tracks: Path) -> None:
    write_recording(tracks, "d1-a-n4-z", recording().log, recording().truth)
    found = read_tracks([tracks.parent])
    assert [each.track for each in found] == ["track, 3 lanes", "track, 4 lanes", "track, 3 lanes"]
    assert [(r.driver, r.drive, r.donor) for r in found[1:]] == [
        ("d1", "d1-a", "z"),
        ("d2", "d2-b", "y"),
    ]


# --- causality ---------------------------------------------------------------------------------


def test_an_experiment_that_filters_is_causal_and_one_that_smooths_is_not() -> None:
    experiment = ego.load_experiment("quickstart")
    cases = (("exact", 0, 0), ("fixed_lag", 0.5, 1.5), ("smoothed", 0.5, 20))
    for method, least_s, most_s in cases:
        changes = {"filter": method, **({"lag": 15} if method == "fixed_lag" else {})}
        answering = partial(by_experiment, ego.load_experiment(experiment, changes))
        found = check_causality(answering, [recording()], cuts=6)
        assert (found.cuts, found.is_causal) == (6, method == "exact")
        assert least_s <= found.ahead_s <= most_s


def test_a_change_that_is_reported_too_early_is_found() -> None:
    def answering(part: Recording) -> Answer:
        whole = by_experiment(ego.load_experiment("quickstart"), part)
        assert whole.told is not None
        late = whole.told.told_frame_id + 5 < len(part.log)
        told = replace(
            whole.told, **{k: v[late] for k, v in vars(whole.told).items() if v is not None}
        )
        return replace(whole, told=told)

    # Four lane changes are told of this drive.
    drive = replace(recording(), log=simulate("quickstart", seed=9, frames=200).log)
    found = check_causality(answering, [drive], cuts=150)
    assert found.changed
    assert not found.is_causal


def test_twenty_lines_of_pandas_are_an_entry_and_a_smoothed_one_is_caught(
    tracks: Path, tmp_path: Path
) -> None:
    cheat = tmp_path / "cheat.py"
    text = EXAMPLE.read_text()
    assert "share.ewm(halflife=20).mean()" in text
    cheat.write_text(
        text.replace("share.ewm(halflife=20).mean()", "share.rolling(41, 1, True).mean()")
    )
    checks = []
    for entry in (EXAMPLE, cheat):
        file = tmp_path / f"{entry.stem}.json"
        found = score(str(entry), [tracks], out=file, checked=1, cuts=2)
        assert 0 < found.place(str(entry), "track")[0] < 1  # type: ignore[index]
        checks.append(json.loads(file.read_text())["check"]["is_causal"])
    assert checks == [True, False]


def test_a_python_file_with_fit_is_given_the_drives_of_others(tracks: Path, tmp_path: Path) -> None:
    entry = tmp_path / "entry.py"
    entry.write_text(
        "import numpy as np\n"
        "from egolane_pgm.benchmark.entries import Answer\n"
        "def fit(recordings):\n"
        "    lane = int(recordings[0].truth.lane[0])\n"
        "    return lambda each: Answer(np.tile(np.arange(1, each.n_lanes + 1) == lane, "
        "(len(each.log), 1)) * 1.0)\n"
    )
    found = score(str(entry), [tracks], checked=1, cuts=3, jobs=2)
    assert found.place(str(entry), "track") == (0.5, None, 1)
    assert kind_of(found.entries[0]) == "Causal, as checked"


def test_a_command_that_fails_says_why() -> None:
    words = command_words("python -c 'raise SystemExit(\"no idea\")' {lines}")
    assert words is not None
    with pytest.raises(ego.InputError, match=r"d1-a: fails: no idea"):
        by_command(words, recording())


# --- entries that are fitted, and the board ----------------------------------------------------


def test_a_fitted_entry_never_saw_the_driver_that_it_answers_for() -> None:
    seen: list[set[str]] = []

    def fit(others: Any) -> Callable[[Recording], Answer]:
        drivers = {each.driver for each in others}
        seen.append(drivers)

        def answering(each: Recording) -> Answer:
            assert each.driver not in drivers
            return Answer(sure_of(LANE))

        return answering

    recordings = [recording(name) for name in ("d1-a", "d2-b", "d2-c", "d3-d")]
    recordings.append(recording("italy", track="paper"))
    found = score_entry(Entry("x", None, fit), recordings, checked=0)
    assert len(found["recordings"]) == 5
    assert seen == [{"d2", "d3"}, {"d1", "d3"}, {"d1", "d2"}, {"d1", "d2", "d3"}]
    with pytest.raises(ego.InputError, match="to the drives of others"):
        score_entry(Entry("x", None, fit), recordings[:1], checked=0)


def test_resamples_draw_drivers_then_all_recordings_of_a_drive() -> None:
    rows = [{"driver": d, "drive": f"{d}{k}"} for d, k in (("a", 0), ("a", 0), ("a", 1), ("b", 0))]
    weights = resamples(rows)
    assert (weights[0] == 1).all()
    assert (weights[:, 0] == weights[:, 1]).all()
    # Of two drivers two are drawn: a has two drives, so a draw of it gives two of them.
    assert (weights[:, 0] + weights[:, 2] + 2 * weights[:, 3] == 4)[1:].all()


def scored(title: str, right: dict[str, float], checked: bool | None = True) -> dict[str, Any]:
    """Scores of an entry that is right in a share of each recording."""
    rows = []
    for name, share in right.items():
        row = score_recording(recording(name), Answer(sure_of(LANE)))
        rows.append({**row, "recalls": share * row["lanes_driven"]})
    return {
        "version": 1,
        "title": title,
        "lanes": "given",
        "check": {"is_causal": checked},
        "recordings": rows,
    }


def test_entries_tie_unless_the_paired_difference_leaves_out_zero() -> None:
    drives = [f"d{k}-x" for k in range(6)]
    best = {name: 0.9 - 0.1 * (k % 2) for k, name in enumerate(drives)}
    worse = {name: share - 0.05 for name, share in best.items()}
    tied = {name: share + (0.3 if name == "d0-x" else -0.05) for name, share in best.items()}
    offline = dict.fromkeys(drives, 1.0)
    entries = [scored("best", best), scored("worse", worse), scored("tied", tied)]
    found = Board((*entries, scored("offline", offline, False)))
    ranks = {title: found.place(title, "track")[2] for title in ("best", "worse", "tied")}  # type: ignore[index]
    assert ranks == {"best": 1, "worse": 2, "tied": 1}
    value, interval = found.difference("best", "worse", "track")
    assert value == pytest.approx(0.05)
    assert interval == pytest.approx((0.05, 0.05))
    assert found.place("offline", "track")[2] == 1  # type: ignore[index]
    assert "ranked apart" in kind_of(found.entries[3])
    assert "ranked apart" in found.to_text()


@pytest.mark.parametrize(
    ("second", "said"),
    [
        (scored("a", {"d1-x": 1.0}), "its title, a, occurs twice"),
        (scored("b", {"d2-x": 1.0}), "has other recordings of track"),
        ({"version": 0}, "holds no scores"),
    ],
)
def test_scores_that_do_not_fit_are_refused(
    tmp_path: Path, second: dict[str, Any], said: str
) -> None:
    for name, content in (("1", scored("a", {"d1-x": 1.0})), ("2", second)):
        (tmp_path / f"{name}.json").write_text(json.dumps(content))
    with pytest.raises(ego.InputError, match=said):
        read_board([tmp_path / "1.json", tmp_path / "2.json"])


def test_the_command_scores_folders_of_answers_and_draws_the_board(
    tracks: Path, tmp_path: Path
) -> None:
    for name in ("good", "bad"):
        (tmp_path / name).mkdir()
        for each in read_tracks([tracks]):
            lane = LANE if name == "good" else 3 - LANE
            write_answer(tmp_path / name, each.name, sure_of(lane))
        file = str(tmp_path / f"{name}.json")
        shown = done(
            "benchmark", "score", str(tmp_path / name), str(tracks), "--title", name, "-o", file
        )
        assert "Causality not checked" in shown.stdout
    files = [str(tmp_path / f"{name}.json") for name in ("bad", "good")]
    drawn = tmp_path / "drawn"
    shown = done("benchmark", "board", *files, "--figures", str(drawn))
    lines = [line.split("|")[1].strip() for line in shown.stdout.splitlines() if "|" in line]
    assert lines[2:4] == ["good", "bad"]
    assert {file.name for file in drawn.iterdir()} == {"board.png", "calibration.png", "lanes.png"}
    assert repr(board(files)) == "Board(2 entries on track)"

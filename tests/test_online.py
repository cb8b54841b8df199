"""The filter as it runs in a car: messages in, the answers of a run out, at once."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm.experiment import Experiment
from egolane_pgm.loading import load_experiment
from egolane_pgm.maps.road_table import save
from egolane_pgm.online import online, read_messages
from egolane_pgm.recordings.select import MAX_FILLED
from egolane_pgm.recordings.table import write_table
from egolane_pgm.types import InputError
from tests.kits.drives import log_with_gaps, run, short_drive, write_drive
from tests.kits.lane_maps import road_rows
from tests.kits.streams import messages

LINE = {"offset_m": -1.8, "is_valid": True, "is_continuous": False, "lri": 10}
POSITION = {"evidence": "line_geometry", "graph": "position_in_lane", "filter": "exact"}


def answers_of(experiment: Experiment, sent: Any, nodes: Any = ()) -> list[dict[str, Any]]:
    return list(online(experiment, read_messages(experiment, sent), nodes))


@pytest.fixture(scope="module")
def experiment(drive: Path) -> Experiment:
    return load_experiment(drive)


@pytest.mark.parametrize(
    ("policy", "changes"),
    [
        ("skip", {}),
        ("hold", {"filter": "exact"}),
        ("predict", {"evidence_mode": "hard"}),
        ("hold", {"filter": "fixed_lag", "lag": 3}),
        ("predict", {"filter": "fixed_lag", "lag": 500}),
        ("predict", POSITION),
    ],
)
def test_answers_are_the_frames_of_a_run(
    tmp_path: Path, policy: str, changes: dict[str, Any]
) -> None:
    path = write_drive(tmp_path, recording__missing_frames=policy, **changes)
    log = log_with_gaps()
    write_table(tmp_path / "lines.csv", log)
    found = run(path)
    nodes = ["Lane", "RoadPosition" if changes is POSITION else "SensorState"]
    answers = answers_of(load_experiment(path), messages(log), nodes)
    assert [a["frame_id"] for a in answers] == log.frame_id.tolist()
    frames = found.frames.loc[log.frame_id]
    for node in nodes:
        beliefs = np.array([[*a["beliefs"][node].values()] for a in answers])
        columns = [f"{node}_{value}" for value in found.run["values"][node]]
        np.testing.assert_allclose(beliefs, frames[columns], rtol=0, atol=1e-12)
    names = {"lane": "assigned_lane", "time_s": "time_s", "is_impossible": "is_impossible"}
    for name, column in names.items():
        np.testing.assert_array_equal([a[name] for a in answers], frames[column])
    events = [event for answer in answers for event in answer["events"]]
    kept = ["from_lane", "to_lane", "direction", "time_s"]
    assert [[e[key] for key in kept] for e in events] == found.events[kept].values.tolist()


def test_an_answer_is_short_unless_nodes_are_wanted(tmp_path: Path) -> None:
    experiment = load_experiment(write_drive(tmp_path, 40, **POSITION))
    sent = list(messages(short_drive(40).log))
    first, *_ = answers = answers_of(experiment, sent)
    assert [*first] == [
        *("frame_id", "time_s", "lane", "probability", "line_crossing_probability"),
        *("is_impossible", "events", "beliefs"),
    ]
    assert 0 <= first["line_crossing_probability"] <= 1
    assert max(len(json.dumps(answer)) for answer in answers if not answer["events"]) < 250
    asked, *_ = answers_of(experiment, sent, ["Lane"])
    assert asked["beliefs"]["Lane"][str(asked["lane"])] == asked["probability"]
    with pytest.raises(InputError, match=r"nodes: 'Lanes' is not one of .*did you mean 'Lane'"):
        answers_of(experiment, sent, ["Lanes"])


def test_where_the_lanes_of_the_road_change_the_filter_begins_anew(tmp_path: Path) -> None:
    log = short_drive(100).log
    save(road_rows([3] * 4 + [4] * 3 + [3] * 3), tmp_path / "road.parquet")
    write_drive(tmp_path, 100)
    changes = {"road": tmp_path / "road.parquet", "n_lanes": "map", "ground_truth": None}
    mapped = load_experiment(tmp_path / "experiment.yaml", changes)
    answers = answers_of(mapped, messages(log), ["Lane"])
    for first, stop, n_lanes in ((0, 40, 3), (40, 70, 4), (70, 100, 3)):
        own = {"n_lanes": n_lanes, "recording.frames": [first, stop]}
        alone = run(tmp_path / "experiment.yaml", own, ground_truth="none")
        beliefs = [[*a["beliefs"]["Lane"].values()] for a in answers[first:stop]]
        np.testing.assert_allclose(beliefs, alone.node("Lane"), rtol=0, atol=1e-12)


def test_what_needs_the_whole_drive_is_refused(tmp_path: Path) -> None:
    experiment = load_experiment(write_drive(tmp_path, 20, filter="smoothed"))
    with pytest.raises(InputError, match=r"smoothed: not causal.*needs the whole drive"):
        answers_of(experiment, messages(short_drive(20).log))


# --- messages ------------------------------------------------------------------------------------


def frame(frame_id: object = 7, **line: object) -> str:
    return json.dumps({"frame_id": frame_id, "lines": [{**LINE, **line}]})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "message 3: is not JSON"),
        ("[]", "message 3: needs keys and values"),
        ('{"frame_id": 7, "line": []}', "unknown key 'line' (did you mean 'lines'?)"),
        ('{"lines": []}', "message 3: frame_id: is missing, as is time_s"),
        ('{"frame_id": 7}', "message 3: lines: is missing"),
        (frame(ofset_m=1), "message 3: lines.0: unknown key 'ofset_m' (did you mean 'offset_m'?)"),
        (frame(offset_m="x"), "message 3: lines.0.offset_m: input should be a valid number"),
        (frame(offset_m=None), "message 3: frame 7: line 1 is valid but its offset is nan"),
        (frame(6), "message 3: frame id 6 does not come after 6"),
        ('{"time_s": NaN, "lines": []}', "message 3: time_s: input should be a finite number"),
        ('{"time_s": -1, "frame_id": 9, "lines": []}', "time_s: -1 is not after that of the last"),
    ],
)
def test_a_message_that_cannot_be_used_is_named_after_the_answers_before_it(
    experiment: Experiment, text: str, message: str
) -> None:
    answers = online(experiment, read_messages(experiment, [frame(5), frame(6), text]))
    assert [next(answers)["frame_id"] for _ in range(2)] == [5, 6]
    with pytest.raises(InputError) as info:
        next(answers)
    assert message in str(info.value)
    assert "\n" not in str(info.value)


def test_a_time_stamp_takes_the_place_of_a_frame_id(experiment: Experiment) -> None:
    sent = [json.dumps({"time_s": 100 + t / 25, "lines": [LINE]}) for t in range(3)]
    answers = answers_of(experiment, ["\n", *sent])
    assert [a["time_s"] for a in answers] == [100.0, 100.04, 100.08]
    assert [a["frame_id"] for a in answers] == [0, 1, 2]


@pytest.mark.parametrize("policy", ["hold", "predict"])
def test_a_jump_of_frame_ids_is_refused_where_the_gap_would_be_filled(
    drive: Path, policy: str
) -> None:
    filling = load_experiment(drive, [f"recording.missing_frames={policy}"])
    sent = [frame(1), frame(MAX_FILLED + 3)]
    with pytest.raises(InputError, match=r"message 2: .*are these ids frame numbers"):
        answers_of(filling, sent)
    assert len(answers_of(load_experiment(drive), sent)) == 2


def test_a_line_is_valid_dashed_and_of_unknown_reliability_by_default(
    experiment: Experiment,
) -> None:
    sent = [
        '{"frame_id": 4, "lines": [{"offset_m": 1}, {"offset_m": -2}]}',
        '{"frame_id": 5, "lines": []}',
    ]
    log, empty = read_messages(experiment, sent)
    np.testing.assert_array_equal(log.offset_m, [[1, -2]])
    assert log.is_valid.all()
    assert not log.is_continuous.any()
    assert np.isnan(log.lri).all()
    assert log.time_s[0] == 0.4
    assert empty.offset_m.shape == (1, 0)

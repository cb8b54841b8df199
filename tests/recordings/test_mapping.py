"""One mapping reads tables and messages: fields, times, units and signs, and what it refuses."""

from __future__ import annotations

import shlex
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import egolane_pgm as ego
from egolane_pgm.experiment import LinesMapping
from egolane_pgm.online import filter_stream
from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.inspecting import look_into
from egolane_pgm.recordings.mapping import Message, lines_of, mapping_keys, presets
from egolane_pgm.recordings.select import sign_warning
from egolane_pgm.types import InputError, LaneTruth, LineLog
from tests.kits.drives import done
from tests.kits.sensor_files import N_FRAMES, offsets_m, openpilot, write_bags, write_tables

TRUE_M = np.array([offsets_m(t) for t in range(N_FRAMES)])

#: Each file, what reads it, which of the four lines it has, and its frames per second.
KINDS: dict[str, tuple[Any, slice, float]] = {
    "seconds.csv": ({"time": "timestamp", "line": "id", "offset": "lateral"}, slice(4), 10),
    "iso8855.csv": (
        {"time": "when", "offset": "lateral_mm", "unit": "mm", "left_positive": True},
        slice(4),
        10,
    ),
    "semicolons.csv": ({"separator": ";", "decimal": ","}, slice(4), 10),
    "tabs.tsv": (None, slice(4), 10),
    "mobileye.csv": (["mobileye_table", "time=time"], slice(1, 3), 10),
    "openpilot.jsonl": ("openpilot", slice(4), 20),
    "openpilot.parquet": ("openpilot", slice(4), 20),
    "own.jsonl": (
        {"time": "header.stamp", "offset": "lanes[].c0", "left_positive": True},
        slice(4),
        10,
    ),
    "lka": ("mobileye", slice(1, 3), 10),
    "paths": ("path", slice(1, 3), 10),
}


@pytest.fixture(scope="module")
def sensors(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sensors")
    write_tables(folder)
    write_bags(folder)
    return folder


def rate(log: LineLog) -> float:
    return float(1 / np.median(np.diff(log.time_s)))


@pytest.mark.parametrize("name", KINDS)
def test_each_kind_has_the_lines_and_the_rate_that_went_in(sensors: Path, name: str) -> None:
    lines, which, per_second = KINDS[name]
    log = read_lines(sensors / name, **({} if lines is None else {"lines": lines}))
    # Paths are looked at between their points, and millimetres are whole.
    np.testing.assert_allclose(log.offset_m[:, : TRUE_M[:, which].shape[1]], TRUE_M[:, which])
    assert rate(log) == pytest.approx(per_second)
    assert set(np.diff(log.frame_id)) == {1}


@pytest.mark.parametrize("name", [*KINDS, "nanoseconds.csv", "markers", "models"])
def test_the_command_that_inspect_prints_finds_the_lines(sensors: Path, name: str) -> None:
    found = look_into(sensors / name)
    assert found["lines"] is not None
    log = read_lines(sensors / name, lines=found["lines"])
    valid = log.offset_m[:, :4][log.is_valid[:, :4]]
    assert valid.min() < -1.4
    assert valid.max() > 1.4
    if name in KINDS:
        np.testing.assert_allclose(log.offset_m[:, :2], TRUE_M[:, KINDS[name][1]][:, :2])
    shown = done("inspect", sensors / name).stdout
    assert f"egolane run {sensors / name} --n-lanes N" in shown


@pytest.mark.parametrize("name", ["own.jsonl", "iso8855.csv", "markers"])
def test_that_command_goes_from_the_file_to_the_lane(
    sensors: Path, name: str, tmp_path: Path
) -> None:
    words = shlex.split(look_into_command(sensors / name).replace(" N", " 3"))
    done(*words[1:], "--no-figures", "--out", tmp_path / "out")
    result = ego.load_result(tmp_path / "out")
    assert np.mean(result.assigned_lane[20:] == 2) > 0.9


def look_into_command(path: Path) -> str:
    return done("inspect", path).stdout.splitlines()[-1].strip()


def test_nanoseconds_with_a_lost_second_have_the_right_rate_and_gap(sensors: Path) -> None:
    found = look_into(sensors / "nanoseconds.csv")
    assert found["lines"] == {"time": "stamp", "time_unit": "ns", "offset": "offset_m"}
    assert (found["frames"], found["frame_rate"], found["gaps"]) == (90, 10.0, 1)
    assert found["longest_gap_s"] == pytest.approx(1.1)
    log = read_lines(sensors / "nanoseconds.csv", lines=found["lines"])
    np.testing.assert_array_equal(log.frame_id, np.r_[0:50, 60:100])
    assert log.time_s[0] == 1.7e9
    run = ego.run(str(sensors / "nanoseconds.csv"), n_lanes=3, lines=found["lines"])
    assert run.run["frame_rate"] == 10.0


def test_steps_that_are_no_multiple_are_said_and_kept() -> None:
    time_s = np.cumsum(np.tile([0.1, 0.1, 0.14, 0.1, 0.3], 10))
    with pytest.warns(UserWarning, match="20% of the steps"):
        log = lines_of([Message(t, "/a", {"offset_m": 1.0}) for t in time_s], None, "x.mcap")
    np.testing.assert_array_equal(np.diff(log.frame_id)[:5], [1, 1, 1, 3, 1])
    np.testing.assert_array_equal(log.time_s, time_s)


def one(value: dict[str, Any], **keys: Any) -> LineLog:
    return lines_of([Message(1.0, "/lanes", value)], LinesMapping(**keys), "x.mcap")


LANES = {"lanes": [{"c0": 1.5, "q": 3, "kind": "solid"}, {"c0": -2.0, "q": 0, "kind": "dashed"}]}


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ("q >= 2", [True, False]),
        ("q in [0, 1]", [False, True]),
        ("q not in [0]", [True, False]),
        ("q != 3", [False, True]),
        ("kind == solid", [True, False]),
        ("kind in [solid, double] and q < 3", [False, False]),
        ("lanes[].q > 0", [True, False]),
        ("good == true", [True, True]),
        (False, [False, False]),
    ],
)
def test_a_condition_holds_of_the_line_or_of_its_message(
    said: str | bool, expected: Sequence[bool]
) -> None:
    log = one({**LANES, "good": True}, offset="lanes[].c0", is_valid=said)
    assert log.is_valid.tolist() == [expected]


def test_polynomials_and_points_are_looked_at_where_it_is_said() -> None:
    value = {"left": {"c0": -1.0, "c1": 0.1, "c2": 0.01}}
    log = one(value, offset=("left.c0", "c1", "c2"), at_m=10.0)
    assert log.offset_m.tolist() == [[1.0]]
    points = {"lines": [{"x": [3.0, -1.0], "y": [4.0, 0.0]}, {"x": [], "y": []}]}
    log = one(points, offset="lines[].y[]", along="lines[].x[]", at_m=1.0)
    np.testing.assert_array_equal(log.offset_m, [[2.0, np.nan]])
    assert one(points, offset="lines[].y[1]", is_valid=False).offset_m[0, 0] == 0.0


def test_topics_of_one_frame_come_together_and_a_lost_message_leaves_its_line_out() -> None:
    messages = [
        Message(t / 10 + late, f"/{side}", {"c0": c0})
        for t in range(9)
        for side, c0, late in (("left", -1.8, 0.0), ("right", 1.7, 0.02))
        if (t, side) != (4, "left")
    ]
    keys = LinesMapping(topic="/{}", each=("left", "right"), offset="c0")
    log = lines_of(messages, keys, "x.mcap")
    np.testing.assert_array_equal(log.frame_id, np.arange(9))
    np.testing.assert_array_equal(np.isnan(log.offset_m).nonzero(), [[4], [0]])


def test_lines_that_also_are_there_follow_and_edges_are_continuous() -> None:
    message = Message(0.0, "modelV2", openpilot(0)["modelV2"])
    log = lines_of([message], LinesMapping(preset="openpilot"), "x.mcap")
    np.testing.assert_array_equal(log.offset_m[0], [*TRUE_M[0], -8.0, 5.4])
    assert log.is_valid[0].tolist() == [True, True, True, False, False, True]
    assert log.is_continuous[0].tolist() == [False] * 4 + [True] * 2


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"offset": "lanes[].c1"}, "offset: there is no 'c1' in lanes[].c1; there are c0, q, kind"),
        ({"offset": "lane[].c0"}, "there is no 'lane' in lane[].c0 (did you mean 'lanes'?)"),
        ({"offset": "lanes[].c0", "is_valid": "q ~ 2"}, "is_valid: there is no 'q ~ 2'"),
        ({"offset": "lanes[].c0", "is_valid": "q > kind"}, "is_valid: 'kind' is not a number"),
        ({"offset": "lanes[].c0", "is_valid": "q"}, "lanes[].q (is_valid) is 3, not true"),
        ({"offset": "lanes[].c0", "is_valid": "other[]"}, "has not a value for each offset"),
        ({"offset": "lanes[].kind"}, "lanes[].kind (offset_m) is 'solid', not a number"),
        ({"offset": "lanes[].c0", "time": "lanes"}, "column lanes (time_s) has type list"),
        ({"offset": "{}_c0", "each": ()}, "each: is missing"),
        ({"preset": "mobilye"}, "unknown preset 'mobilye' (did you mean 'mobileye'?)"),
        ({"topic": "/lane"}, "there is no topic /lane (did you mean '/lanes'?)"),
        ({"also": ({"ofset": "x"},)}, "lines: also: unknown key 'ofset' (did you mean 'offset'?)"),
    ],
)
def test_what_does_not_fit_names_the_key_and_the_cure(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as info:
        one({**LANES, "other": [True]}, **{"offset": "lanes[].c0", **keys})
    assert said in str(info.value)
    assert str(info.value).startswith("x.mcap")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("frame_id;line;offset_m\n0;1;-1,5\n", 'semicolons: `lines: {separator: ";"}`'),
        ("frame_id\tline\n0\t1\n", r'tabs: `lines: {separator: "\t"}`'),
        ("stamp,offset_m\n1.7e18,2\n", "`lines: {frame_id: NAME}` or `{time: NAME"),
        ("time_s,offset_m\n1700000000000000000,2\n", "{time: time_s, time_unit: ns}"),
        ('frame_id,offset_m\n1,"-1,5"\n2,x\n', "decimal commas: `lines: {decimal: ','}`"),
        ("frame_id,offset_m\n1,--\n", "empty cell: `lines: {null_values: ['--']}`"),
        ("frame_id,offset_m,is_valid\n1,2,0.9\n", "`lines: {is_valid: is_valid > 0.5}`"),
        ("frame,offset_m\n1,2\n", "no column frame_id (did you mean 'frame'?)"),
        ("frame_id,offset_m\n0.05,2\n", "time stamps: `lines: {time: NAME"),
        ("time_s,offset_m\n2,1\n1,1\n", "line 3: time goes back; sort by time"),
    ],
)
def test_a_table_says_what_would_read_it(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(InputError) as info:
        read_lines(tmp_path / "a.csv")
    assert said in str(info.value)


@pytest.mark.parametrize(
    ("keys", "cure"),
    [
        ({"left_positive": True}, "from right to left"),
        ({"each": ("left", "right"), "offset": "{}_m"}, "on one side of the car"),
    ],
)
def test_a_sign_that_contradicts_itself_is_said(keys: dict[str, Any], cure: str) -> None:
    table = pd.DataFrame(TRUE_M, columns=[f"offset_{k}" for k in range(1, 5)])
    table["left_m"], table["right_m"] = -TRUE_M[:, 1], TRUE_M[:, 2]
    table["frame_id"] = np.arange(N_FRAMES)
    with pytest.warns(UserWarning, match=cure):
        ego.run(table, n_lanes=3, lines=keys)


def test_lines_that_move_against_the_annotated_changes_are_said() -> None:
    drive = ego.simulate("quickstart", frames=3000)
    assert drive.truth is not None
    assert sign_warning(drive.log, drive.truth) == []
    mirrored = replace(drive.log, offset_m=-drive.log.offset_m)
    assert "left_positive: true" in sign_warning(mirrored, drive.truth)[0]
    still = LaneTruth(drive.truth.frame_id, drive.truth.lane * 0 + 1, drive.truth.is_crossing)
    assert sign_warning(mirrored, still) == []


def test_a_left_positive_copy_has_the_same_beliefs_to_the_bit(tmp_path: Path) -> None:
    drive = ego.simulate("quickstart", frames=300)
    lines = drive.log.to_pandas()
    turned = lines.assign(offset_m=-lines["offset_m"])
    runs = [ego.run(lines, n_lanes=3), ego.run(turned, n_lanes=3, lines=["left_positive=true"])]
    np.testing.assert_array_equal(*(run.beliefs.lane for run in runs))


def test_a_key_that_is_null_takes_that_of_a_preset_away_and_stays() -> None:
    lines = {"preset": "openpilot", "frame_id": None}
    recording = {"path": "in memory", "lines": lines}
    experiment = ego.load_experiment({"name": "a", "n_lanes": 3, "recording": recording})
    again = ego.load_experiment(experiment, {"n_lanes": 4})
    assert again.model_dump()["recording"]["lines"] == lines
    message = Message(0.0, "modelV2", openpilot(0)["modelV2"])
    assert lines_of([message], again.recording.lines, "x.mcap").frame_id.tolist() == [0]


def test_messages_on_standard_input_are_mapped_alike() -> None:
    import json

    experiment = ego.load_experiment("quickstart", {"recording.lines": {"preset": "openpilot"}})
    given = [json.dumps(openpilot(t)) for t in range(3)]
    answers = [*filter_stream(experiment, given)]
    assert [a["frame_id"] for a in answers] == [500, 501, 502]
    usual = ego.load_experiment("quickstart")
    lines = [{"offset_m": y, "is_valid": k < 3} for k, y in enumerate([*offsets_m(0), -8.0, 5.4])]
    lines[5] |= {"is_valid": True, "is_continuous": True}
    same = [*filter_stream(usual, [json.dumps({"frame_id": 500, "lines": lines})])]
    assert same[0]["probability"] == answers[0]["probability"]


def test_a_caller_gives_a_preset_keys_or_a_file(tmp_path: Path) -> None:
    (tmp_path / "lines.yaml").write_text("offset: lateral\nunit: mm\n")
    given = ["openpilot", str(tmp_path / "lines.yaml"), "offset={}_c0", "decimal=,"]
    assert mapping_keys(given) == {
        "preset": "openpilot",
        "offset": "{}_c0",
        "unit": "mm",
        "decimal": ",",
    }
    with pytest.raises(InputError, match=r"no preset, .* \(did you mean 'openpilot'\?\)"):
        mapping_keys("opnpilot")


@pytest.mark.parametrize("name", presets())
def test_a_preset_has_keys_that_exist(name: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        LinesMapping(**presets()[name])

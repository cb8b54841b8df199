"""The filter frame by frame: the same beliefs as `run`, at once, and messages that are refused."""

from __future__ import annotations

import gc
import json
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from egolane_pgm import paper
from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.online import filter_logs, filter_stream, parse_message
from egolane_pgm.recordings.select import MAX_FILLED
from egolane_pgm.recordings.table import write_table
from egolane_pgm.running import run_experiment
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.types import InputError, LineLog
from tests.evidence.line_geometry.test_rule import line_log
from tests.kits.drives import command, short_drive, write_drive
from tests.kits.processes import started
from tests.kits.streams import messages, over_and_over

ZERO_LABEL = paper.experiments_folder() / "zero_label.yaml"
GAPS = (20, 21, 22, 60)
LINE = {"offset_m": -1.8, "is_valid": True, "is_continuous": False, "lri": 10}


@pytest.mark.parametrize(
    ("policy", "choice", "changes"),
    [
        ("skip", "assumed_density", {}),
        ("hold", "exact", {}),
        ("predict", "assumed_density", {"evidence_reading": "hard"}),
        ("predict", "exact", {}),
        ("skip", "exact", {"recording__lri": "clip"}),
    ],
)
def test_online_beliefs_equal_those_of_a_run_frame_by_frame(
    tmp_path: Path, policy: str, choice: str, changes: dict[str, Any]
) -> None:
    path = write_drive(tmp_path, filter=choice, recording__missing_frames=policy, **changes)
    log = short_drive().log
    log = log.take(~np.isin(log.frame_id, GAPS))
    write_table(tmp_path / "lines.csv", log)
    run = run_experiment(path)
    answers = list(filter_stream(load_experiment(path), messages(log), ["Lane", "SensorState"]))
    assert [a["frame_id"] for a in answers] == log.frame_id.tolist()
    at = np.searchsorted(run.beliefs.frame_id, log.frame_id)
    for node, names in (("Lane", "123"), ("SensorState", ("OK", "BAD"))):
        beliefs = np.array([[a["beliefs"][node][n] for n in names] for a in answers])
        np.testing.assert_allclose(beliefs, run.beliefs.marginals[node][at], rtol=0, atol=1e-12)
    np.testing.assert_array_equal([a["lane"] for a in answers], assigned_lane(run.beliefs.lane)[at])
    np.testing.assert_array_equal([a["time_s"] for a in answers], run.lines.time_s[at])
    told = [event for answer in answers for event in answer["events"]]
    assert [event["to_lane"] for event in told] == run.told.to_lane.tolist()
    assert [event["time_s"] for event in told] == run.told.time_s.tolist()


@pytest.mark.parametrize("policy", ["skip", "hold", "predict"])
@pytest.mark.parametrize("lag", [0, 3, 500])
def test_fixed_lag_online_answers_late_and_as_the_run(
    tmp_path: Path, policy: str, lag: int
) -> None:
    path = write_drive(tmp_path, 70, filter="fixed_lag", lag=lag, recording__missing_frames=policy)
    log = short_drive(70).log
    log = log.take(~np.isin(log.frame_id, GAPS))
    write_table(tmp_path / "lines.csv", log)
    run = run_experiment(path)
    sent: list[int] = []

    def send() -> Iterator[str]:
        for message in messages(log):
            sent.append(json.loads(message)["frame_id"])
            yield message

    answers = []
    for answer in filter_stream(load_experiment(path), send(), ["Lane"]):
        waited = sent[-1] - answer["frame_id"]
        assert waited >= lag or len(sent) == len(log)
        answers.append(answer)
    assert [a["frame_id"] for a in answers] == log.frame_id.tolist()
    at = np.searchsorted(run.beliefs.frame_id, log.frame_id)
    lane = np.array([[a["beliefs"]["Lane"][n] for n in "123"] for a in answers])
    np.testing.assert_allclose(lane, run.beliefs.lane[at], rtol=0, atol=1e-12)


def test_an_answer_is_short_unless_nodes_are_asked_for(tmp_path: Path) -> None:
    words = {"evidence": "line_geometry", "graph": "position_in_lane", "filter": "exact"}
    experiment = load_experiment(write_drive(tmp_path, 40, **words))
    sent = list(messages(short_drive(40).log))
    first, *_ = answers = list(filter_stream(experiment, sent))
    assert [*first] == [
        *("frame_id", "time_s", "lane", "probability", "crossing", "is_impossible"),
        *("events", "beliefs"),
    ]
    assert 0 <= first["crossing"] <= 1
    assert max(len(json.dumps(answer)) for answer in answers if not answer["events"]) < 250
    (asked, *_) = filter_stream(experiment, sent, ["Lane"])
    assert asked["beliefs"]["Lane"][str(asked["lane"])] == asked["probability"]
    with pytest.raises(InputError, match=r"nodes: 'Lanes' is not one of .*did you mean 'Lane'"):
        next(filter_stream(experiment, sent, ["Lanes"]))


def test_a_camera_of_its_own_lane_s_lines_is_noted_once() -> None:
    sent = "".join(messages(line_log([-1.75, 1.75] * np.ones((900, 1)))))
    ran = command("online", ZERO_LABEL, given=sent)
    assert ran.exit_code == 0
    assert len(ran.stdout.splitlines()) == 900
    [said] = ran.stderr.splitlines()
    assert said.startswith("note: message 601: shows the lines of its own lane only:")
    assert said.endswith("lane changes are followed")


def test_a_time_stamp_says_when_a_frame_was_and_stands_for_its_id(experiment: Experiment) -> None:
    sent = [json.dumps({"time_s": 100 + t / 25, "lines": [LINE]}) for t in range(3)]
    answers = list(filter_stream(experiment, sent))
    assert [a["time_s"] for a in answers] == [100.0, 100.04, 100.08]
    assert [a["frame_id"] for a in answers] == [0, 1, 2]


def test_what_needs_the_whole_drive_is_refused_online(tmp_path: Path) -> None:
    experiment = load_experiment(write_drive(tmp_path, 20, filter="smoothed"))
    with pytest.raises(InputError, match="smoothed needs the whole drive; online use fixed_lag"):
        list(filter_stream(experiment, messages(short_drive(20).log)))


def test_memory_does_not_grow_with_the_frames(tmp_path: Path) -> None:
    path = write_drive(
        tmp_path,
        evidence="line_geometry",
        graph="position_in_lane",
        filter="fixed_lag",
        lag=5,
        parameters={"lane_width_m": "causal"},
    )
    # In a process of its own, whose memory no other test has used.
    code = f"from tests.test_online import held; print(*held({str(path)!r}))"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    # What each frame leaves, it leaves in every part; what kernels free is not seen, now and then.
    # A number for each frame would be 32,000 bytes, with its place in a list 40,000.
    assert min(np.diff([int(n_bytes) for n_bytes in ran.stdout.split()])) < 16_000


def held(path: str) -> list[int]:
    """The bytes that an online filter holds after 2,000 frames, and after each 1,000 more."""
    experiment = load_experiment(path)
    log = with_clutter(short_drive(500).log)
    answers = filter_logs(experiment, over_and_over(log, 5500, experiment.recording.frame_rate))

    def after(n_frames: int) -> int:
        for _ in range(n_frames):
            next(answers)
        # It empties Python's lists of objects to be used again, too.
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    next(answers)
    tracemalloc.start()
    # In the first of them the rule gets to know as many lines as it remembers.
    return [after(n_frames) for n_frames in (2000, 1000, 1000, 1000)]


def with_clutter(log: LineLog) -> LineLog:
    """The log with 20 lines more in each frame, at random places, half of which are valid."""
    rng = np.random.default_rng(0)
    shape = (len(log), 20)
    return replace(
        log,
        offset_m=np.hstack([log.offset_m, rng.normal(0, 5, shape)]),
        is_valid=np.hstack([log.is_valid, rng.random(shape) < 0.5]),
        is_continuous=np.hstack([log.is_continuous, np.zeros(shape, dtype=bool)]),
        lri=np.hstack([log.lri, rng.integers(0, 10, shape)]),
    )


@pytest.fixture(scope="module")
def experiment(drive: Path) -> Experiment:
    return load_experiment(drive)


def test_each_line_is_answered_before_the_next_is_sent(drive: Path) -> None:
    process = started("online", drive, stdin=subprocess.PIPE, bufsize=1)
    assert process.stdin is not None
    assert process.stdout is not None
    expected = list(filter_stream(load_experiment(drive), list(messages(short_drive().log))[:5]))
    for message, answer in zip(messages(short_drive().log), expected, strict=False):
        process.stdin.write(message)
        process.stdin.flush()
        said = json.loads(process.stdout.readline())
        assert said == answer
    _, error = process.communicate(timeout=120)
    assert process.returncode == 0
    assert error == ""


def test_a_bad_line_ends_the_stream_after_the_answers_before_it(drive: Path) -> None:
    text = "".join(list(messages(short_drive().log))[:2]) + "\n" + "oops\n"
    ran = command("online", drive, given=text)
    assert ran.exit_code == 2
    assert len(ran.stdout.splitlines()) == 2
    assert ran.stderr.startswith("egolane: message 4: is not JSON")
    assert len(ran.stderr.splitlines()) == 1


def test_nothing_in_nothing_out(drive: Path) -> None:
    ran = command("online", drive, given="\n  \n")
    assert (ran.exit_code, ran.output) == (0, "")


def test_an_override_holds_online_too(drive: Path) -> None:
    text = "".join(list(messages(short_drive().log))[:3])
    ran = command("online", drive, "--set", "parameters.sigma1=2", given=text)
    changed = load_experiment(drive, ["parameters.sigma1=2"])
    assert [json.loads(line) for line in ran.stdout.splitlines()] == list(
        filter_stream(changed, text.splitlines())
    )


def frame(frame_id: object = 7, **line: object) -> str:
    return json.dumps({"frame_id": frame_id, "lines": [{**LINE, **line}]})


@pytest.mark.parametrize(
    ("text", "said"),
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
    ],
)
def test_a_message_that_cannot_be_used_is_named(
    experiment: Experiment, text: str, said: str
) -> None:
    stream = filter_stream(experiment, [frame(5), frame(6), text])
    assert [next(stream)["frame_id"] for _ in range(2)] == [5, 6]
    with pytest.raises(InputError) as info:
        next(stream)
    assert said in str(info.value)
    assert "\n" not in str(info.value)
    assert len(str(info.value)) < 200


@pytest.mark.parametrize("policy", ["hold", "predict"])
def test_a_jump_of_frame_ids_is_refused_where_the_gap_would_be_filled(
    drive: Path, policy: str
) -> None:
    experiment = load_experiment(drive, [f"recording.missing_frames={policy}"])
    with pytest.raises(InputError, match=r"message 2: .*are these ids frame numbers"):
        list(filter_stream(experiment, [frame(1), frame(MAX_FILLED + 3)]))
    skipping = load_experiment(drive)
    assert len(list(filter_stream(skipping, [frame(1), frame(MAX_FILLED + 3)]))) == 2


def test_what_a_line_leaves_out_is_valid_dashed_and_of_unknown_reliability() -> None:
    log = parse_message('{"frame_id": 4, "lines": [{"offset_m": 1}, {"offset_m": -2}]}', "m", 5.0)
    np.testing.assert_array_equal(log.offset_m, [[1, -2]])
    assert log.is_valid.all()
    assert not log.is_continuous.any()
    assert np.isnan(log.lri).all()
    assert log.time_s[0] == 0.8
    assert parse_message('{"frame_id": 4, "lines": []}', "m", 5.0).offset_m.shape == (1, 0)

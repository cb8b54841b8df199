"""The filter as it runs in a car: lines of a frame in, its lane out, at once."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from egolane_pgm.experiment import Experiment
from egolane_pgm.inference.events import NO_EVENTS, crossing_probability, next_events
from egolane_pgm.inference.filtering import step
from egolane_pgm.inference.layout import FilterState
from egolane_pgm.inference.smoothing import LagState, lag_rest, lag_step
from egolane_pgm.model import online_output, prepare_model, value_names
from egolane_pgm.recordings.select import clip_lri, fill_after
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.types import Beliefs, InputError, LaneEvents, LineLog, not_one_of, suggestion

#: Whole numbers up to here are exact as floating-point times.
MAX_FRAME_ID = 2**53

_KEYS = {"frame_id", "time_s", "lines"}
_LINE_KEYS = {"offset_m", "is_valid", "is_continuous", "lri"}


def filter_stream(
    experiment: Experiment, messages: Iterable[str], nodes: Sequence[str] = ()
) -> Iterator[dict[str, Any]]:
    """Filter messages as they come, and yield an answer after each of them.

    - messages: one frame each, a JSON line such as `{"frame_id": 7, "lines": [{"offset_m": -1.8,
      "is_valid": true, "is_continuous": false, "lri": 10}, ...]}`. `is_valid` is true by default,
      `is_continuous` false, `lri` unknown. `time_s`, seconds, says when the frame was; without it
      that is the frame id over the frame rate. A message with `time_s` may lack the frame id: it is
      then the frame after the last. Blank lines are skipped.
    - nodes: hidden nodes whose whole belief is part of the answer.

    Yields `{frame_id, time_s, lane (0: Unassigned), probability (of that lane, or of the most
    probable one), crossing (the probability that the car is on a line; null where the graph cannot
    tell), is_impossible, events: [{from_lane, to_lane, time_s (since when), probability}], beliefs:
    {node: {value: probability}}}`. With filter fixed_lag the answer about a frame comes `lag`
    frames later, those about the last frames at the end.

    Raises InputError, naming the message, for one that cannot be used, for a node that the graph
    does not have, and for filter smoothed, which needs the whole drive.
    """
    frame_rate = experiment.recording.frame_rate

    def logs() -> Iterator[LineLog]:
        after = 0
        for number, text in enumerate(messages, start=1):
            if text.strip():
                log = parse_message(text, f"message {number}", frame_rate, after)
                after = int(log.frame_id[0]) + 1
                yield log

    yield from filter_logs(experiment, logs(), nodes)


def filter_logs(
    experiment: Experiment, logs: Iterable[LineLog], nodes: Sequence[str] = ()
) -> Iterator[dict[str, Any]]:
    """Filter frames as they come, and yield an answer for each, as `filter_stream` does.

    - logs: one frame each; the `source` of each names it in messages.
    """
    if experiment.filter == "smoothed":
        raise InputError(
            f"{experiment.source}: filter: smoothed needs the whole drive; online use fixed_lag,"
            " exact or assumed_density"
        )
    model = prepare_model(experiment)
    names = value_names(model)
    for node in nodes:
        if node not in names:
            raise InputError(f"nodes: {not_one_of(node, [*names])}")
    output_of = online_output(model, experiment.evidence_reading)
    recording, below = experiment.recording, experiment.unassigned_below
    max_lri = float(model.parameters.get("max_lri", 10))  # type: ignore[arg-type]
    state: FilterState | None = None
    late: LagState | None = None
    so_far = NO_EVENTS
    # Frames that wait for their answer; None stands for one that the recording lacks.
    waiting: deque[LineLog | None] = deque()
    last: LineLog | None = None

    def answers(beliefs: Beliefs) -> Iterator[dict[str, Any]]:
        """Answers to the first frames that wait, one for each belief."""
        nonlocal so_far
        for t in range(len(beliefs)):
            log = waiting.popleft()
            if log is not None:
                frame = replace(beliefs.take(slice(t, t + 1)), frame_id=log.frame_id)
                so_far, _, events = next_events(so_far, frame, log.time_s)
                yield _answer(log, frame, events, below, {node: names[node] for node in nodes})

    for log in logs:
        if recording.lri == "clip":
            log = clip_lri(log, max_lri)
        due = fill_after(last, log, recording.missing_frames, recording.frame_rate)
        evidence = output_of(due).filtered
        last = log
        waiting.extend([*[None] * (len(due) - 1), log])
        if experiment.lag is None:
            state, beliefs = step(model.compiled, state, evidence, experiment.filter)
            yield from answers(beliefs)
            continue
        for t in range(len(due)):
            frame = evidence.take(slice(t, t + 1))
            late, beliefs = lag_step(model.compiled, late, frame, experiment.lag)
            yield from answers(beliefs)
    if late is not None:
        yield from answers(lag_rest(model.compiled, late))


def _answer(
    log: LineLog,
    beliefs: Beliefs,
    events: LaneEvents,
    below: float,
    nodes: Mapping[str, Sequence[str]],
) -> dict[str, Any]:
    """The answer to a frame. nodes: the names of the values of each node in the answer."""
    lane = beliefs.lane[0]
    assigned = int(assigned_lane(beliefs.lane, below)[0])
    crossing = crossing_probability(beliefs.marginals)
    columns = (events.from_lane, events.to_lane, events.time_s, events.probability)
    names = ("from_lane", "to_lane", "time_s", "probability")
    return {
        "frame_id": int(log.frame_id[0]),
        "time_s": float(log.time_s[0]),
        "lane": assigned,
        "probability": float(lane[assigned - 1] if assigned else lane.max()),
        "crossing": None if crossing is None else float(crossing[0]),
        "is_impossible": bool(beliefs.is_impossible[0]),
        "events": [
            dict(zip(names, event, strict=True))
            for event in zip(*(column.tolist() for column in columns), strict=True)
        ],
        "beliefs": {
            node: dict(zip(values, beliefs.marginals[node][0].tolist(), strict=True))
            for node, values in nodes.items()
        },
    }


def parse_message(text: str, where: str, frame_rate: float, after: int = 0) -> LineLog:
    """One message as a LineLog of one frame; see `filter_stream`.

    - after: the id of a frame without one.
    """
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: is not JSON: {error}") from error
    if not isinstance(content, dict):
        raise InputError(f"{where}: needs an object with frame_id and lines")
    _check_keys(content, _KEYS, where)
    time_s = _number(content, "time_s", where)
    frame_id, lines = content.get("frame_id"), content.get("lines")
    if frame_id is None and not math.isnan(time_s):
        frame_id = after
    if isinstance(frame_id, bool) or not isinstance(frame_id, int):
        raise InputError(f"{where}: frame_id {frame_id!r} is not a whole number")
    if abs(frame_id) > MAX_FRAME_ID:
        raise InputError(f"{where}: frame_id {str(frame_id)[:30]} is too large for a frame count")
    if not isinstance(lines, list) or not all(isinstance(line, dict) for line in lines):
        raise InputError(f"{where}: lines must be a list of objects")
    rows = [_line(line, f"{where}: line {k}") for k, line in enumerate(lines, start=1)]
    columns = zip(*rows, strict=True) if rows else [()] * 4
    log = LineLog.of_frame(frame_id, frame_rate, *columns, source=where)
    return log if math.isnan(time_s) else replace(log, time_s=np.array([time_s]))


def _check_keys(content: dict[str, Any], known: set[str], where: str) -> None:
    if not content.keys() <= known:
        key = next(key for key in content if key not in known)
        raise InputError(f"{where}: unknown key '{key}'{suggestion(key, known)}")


def _line(line: dict[str, Any], where: str) -> tuple[float, bool, bool, float]:
    """The offset, both flags and the LRI of a line; NaN for a number that it lacks."""
    _check_keys(line, _LINE_KEYS, where)
    valid, continuous = line.get("is_valid", True), line.get("is_continuous", False)
    for key, flag in (("is_valid", valid), ("is_continuous", continuous)):
        if not isinstance(flag, bool):
            raise InputError(f"{where}: {key} {flag!r} is not true or false")
    return _number(line, "offset_m", where), valid, continuous, _number(line, "lri", where)


def _number(line: dict[str, Any], key: str, where: str) -> float:
    value = line.get(key)
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"{where}: {key} {value!r} is not a number")
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{where}: {key} is too large a number") from None

"""The filter as it runs in a car: lines of a frame in, its lane out, at once."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field
from pydantic_core import from_json

from egolane_pgm.experiment import Columns, Experiment, Section, validated
from egolane_pgm.inference.events import NO_EVENTS, across_lanes, next_events
from egolane_pgm.inference.filtering import step
from egolane_pgm.inference.layout import FilterState
from egolane_pgm.inference.smoothing import LagState, lag_rest, lag_step
from egolane_pgm.model import online_output, place_by_lines, prepare_model, value_names
from egolane_pgm.recordings.select import clip_lri, fill_after
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.types import Beliefs, FloatArray, InputError, LaneEvents, LineLog, not_one_of


class _Strict(Section):
    model_config = ConfigDict(strict=True)


class _Line(_Strict):
    """A line of a message."""

    offset_m: float | None = None
    is_valid: bool = True
    is_continuous: bool = False
    lri: float | None = None


class _Message(_Strict):
    """The lines of a frame. Whole numbers up to 2**53 are exact as floating-point times."""

    frame_id: Annotated[int, Field(ge=-(2**53), le=2**53)] | None = None
    time_s: float | None = None
    lines: list[_Line]


def filter_stream(
    experiment: Experiment, messages: Iterable[str], nodes: Sequence[str] = ()
) -> Iterator[dict[str, Any]]:
    """Filter messages as they come, and yield an answer after each of them.

    - messages: one frame each, a JSON line such as `{"frame_id": 7, "lines": [{"offset_m": -1.8,
      "is_valid": true, "is_continuous": false, "lri": 10}, ...]}`. `is_valid` is true by default,
      `is_continuous` false, `lri` unknown. `time_s`, seconds, says when the frame was; without it
      that is the frame id over the frame rate. A message with `time_s` may lack the frame id: it is
      then the frame after the last. Blank lines are skipped. `recording.columns` says what other
      messages call these fields.
    - nodes: hidden nodes whose whole belief is part of the answer.

    Yields `{frame_id, time_s, lane (0: Unassigned), probability (of that lane, or of the most
    probable one), crossing (the probability that the car is on a line; null where the graph cannot
    tell), is_impossible, events: [{from_lane, to_lane (both 0 where the lane is not known),
    direction (-1 left, 1 right), time_s (since when), probability}], beliefs: {node: {value:
    probability}}}`. With filter fixed_lag the answer about a frame comes `lag`
    frames later, those about the last frames at the end.

    Raises InputError, naming the message, for one that cannot be used, for a node that the graph
    does not have, and for filter smoothed, which needs the whole drive.
    """
    frame_rate = experiment.recording.frame_rate

    def logs() -> Iterator[LineLog]:
        after = 0
        for number, text in enumerate(messages, start=1):
            if text.strip():
                where = f"message {number}"
                log = parse_message(text, where, frame_rate, after, experiment.recording.columns)
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
    place_of = place_by_lines(model)
    # Frames that wait for their answer: the k-th of a log, and the places in it by its lines. The
    # recording lacks all but a log's last frame: what they tell is said in the next answer.
    waiting: deque[tuple[LineLog, int, FloatArray | None]] = deque()
    untold: list[LaneEvents] = []
    last: LineLog | None = None

    def answers(beliefs: Beliefs) -> Iterator[dict[str, Any]]:
        """Answers to the first frames that wait, one for each belief."""
        nonlocal so_far
        for t in range(len(beliefs)):
            log, k, places = waiting.popleft()
            here, frame = slice(k, k + 1), beliefs.take(slice(t, t + 1))
            across = across_lanes(frame.marginals, None if places is None else places[here])
            frame_id, time_s, place = log.frame_id[here], log.time_s[here], across["place_in_lane"]
            so_far, _, events = next_events(so_far, frame.lane, frame_id, time_s, place)
            untold.append(events)
            if k == len(log) - 1:
                named, events = {node: names[node] for node in nodes}, LaneEvents.joined(untold)
                untold.clear()
                yield _answer(log, frame, across["crossing"], events, below, named)

    for log in logs:
        if recording.lri == "clip":
            log = clip_lri(log, max_lri)
        due = fill_after(last, log, recording.missing_frames, recording.frame_rate)
        evidence = output_of(due).filtered
        last, places = log, place_of(due)
        waiting.extend((due, k, places) for k in range(len(due)))
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
    crossing: FloatArray | None,
    events: LaneEvents,
    below: float,
    nodes: Mapping[str, Sequence[str]],
) -> dict[str, Any]:
    """The answer to the last frame of a log. nodes: the names of the values of each node in it."""
    lane = beliefs.lane[0]
    assigned = int(assigned_lane(beliefs.lane, below)[0])
    names = ("from_lane", "to_lane", "direction", "time_s", "probability")
    columns = [getattr(events, name) for name in names]
    return {
        "frame_id": int(log.frame_id[-1]),
        "time_s": float(log.time_s[-1]),
        "lane": assigned,
        "probability": float(lane[assigned - 1] if assigned else lane.max()),
        "crossing": None if crossing is None else float(crossing[0]),
        "is_impossible": bool(beliefs.is_impossible[0]),
        "events": [
            # What is no number is not known.
            {name: each if each == each else None for name, each in zip(names, row, strict=True)}
            for row in zip(*(column.tolist() for column in columns), strict=True)
        ],
        "beliefs": {
            node: dict(zip(values, beliefs.marginals[node][0].tolist(), strict=True))
            for node, values in nodes.items()
        },
    }


def parse_message(
    text: str, where: str, frame_rate: float, after: int = 0, said: Columns | None = None
) -> LineLog:
    """One message as a LineLog of one frame; see `filter_stream`.

    - after: the id of a frame without one.
    - said: what other messages call our fields.
    """
    try:
        content = from_json(text)
    except ValueError as error:
        raise InputError(f"{where}: is not JSON: {error}") from error
    if said is not None:
        # Bags are read with it, too, which takes long to load.
        from egolane_pgm.recordings.topics import lines_of_messages

        if not isinstance(content, dict):
            raise InputError(f"{where}: is no JSON object")
        return lines_of_messages([content], said, where, frame_rate, after)
    message = validated(_Message, content, where)
    lines, time_s = message.lines, message.time_s
    frame_id = after if message.frame_id is None and time_s is not None else message.frame_id
    if frame_id is None:
        raise InputError(f"{where}: frame_id: is missing, as is time_s")
    log = LineLog.of_frame(
        frame_id,
        frame_rate,
        # None becomes NaN.
        np.array([line.offset_m for line in lines], dtype=np.float64),
        [line.is_valid for line in lines],
        [line.is_continuous for line in lines],
        np.array([line.lri for line in lines], dtype=np.float64),
        source=where,
    )
    return log if time_s is None else replace(log, time_s=np.array([time_s]))

"""The online filter: lines of a frame in, its lane out."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, FiniteFloat
from pydantic_core import from_json

from egolane_pgm.drives import changed
from egolane_pgm.experiment import FROM_MAP, Experiment, Recording, Section, validated
from egolane_pgm.inference.events import NO_EVENTS, next_events
from egolane_pgm.loading import existing
from egolane_pgm.maps.road_table import lanes_at
from egolane_pgm.maps.road_table import load as load_road
from egolane_pgm.model import Model, compile_model, with_inputs
from egolane_pgm.running import infer
from egolane_pgm.types import FloatArray, InputError, LineLog, not_one_of


class _Strict(Section):
    model_config = ConfigDict(strict=True)


class _Line(_Strict):
    """A line of a message."""

    offset_m: float | None = None
    is_valid: bool = True
    is_continuous: bool = False
    lri: float | None = None


class _Message(_Strict):
    """The lines of a frame. Frame ids are exact as floating-point times up to 2**53."""

    frame_id: Annotated[int, Field(ge=-(2**53), le=2**53)] | None = None
    time_s: FiniteFloat | None = None
    lines: list[_Line]


def online(
    experiment: Experiment, logs: Iterable[LineLog], nodes: Sequence[str] = ()
) -> Iterator[dict[str, Any]]:
    """Yield an answer for each frame as it comes.

    - logs: one frame each.
    - nodes: hidden nodes whose posterior is part of the answer.

    An answer has frame_id, time_s, lane (0: unassigned), probability (of that lane, or of the most
    probable one), line_crossing_probability (None without RoadPosition), is_impossible, events
    (lane changes since the last answer) and beliefs (by node and value). With filter fixed_lag it
    comes `lag` frames late. With `n_lanes: map` the filter starts from the prior if the number of
    lanes changes.

    Raises InputError for an unknown node, for frames that do not follow each other, and for a
    model that needs the whole drive.
    """
    if experiment.n_lanes != FROM_MAP:
        yield from _online(compile_model(experiment), logs, nodes)
        return
    road = load_road(existing(experiment, "road"))
    for n_lanes, drive in groupby(logs, lambda log: int(lanes_at(road, log.time_s)[-1])):
        model = compile_model(changed(experiment, road=None, n_lanes=n_lanes))
        yield from _online(model, drive, nodes)


def _online(
    model: Model, logs: Iterable[LineLog], nodes: Sequence[str]
) -> Iterator[dict[str, Any]]:
    for node in nodes:
        if node not in model.values:
            raise InputError(f"nodes: {not_one_of(node, [*model.values])}")
    recorded: deque[int] = deque()

    def noted() -> Iterator[LineLog]:
        for log in logs:
            recorded.append(int(log.frame_id[-1]))
            yield log

    lanes = [f"Lane_{k}" for k in range(1, model.n_lanes + 1)]
    state = NO_EVENTS
    events = []
    for columns in infer(model, noted()):
        posterior = np.stack([columns[name] for name in lanes], axis=1)
        offset = columns.get("lateral_offset")
        begin = 0
        for t, frame_id in enumerate(columns["frame_id"].tolist()):
            # Filled-in frames have no answer. A long gap has many, so they are searched at once.
            is_due = frame_id == recorded[0]
            if not is_due and t < len(posterior) - 1:
                continue
            here = slice(begin, t + 1)
            begin = t + 1
            place = None if offset is None else offset[here]
            when = columns["frame_id"][here], columns["time_s"][here]
            state, _, found = next_events(state, posterior[here], *when, place)
            events += _event_rows(found)
            if is_due:
                recorded.popleft()
                yield _answer(model, columns, t, posterior[t], events, nodes)
                events = []


def _answer(
    model: Model,
    columns: Mapping[str, Any],
    t: int,
    lane: FloatArray,
    events: list[dict[str, Any]],
    nodes: Sequence[str],
) -> dict[str, Any]:
    """Return the answer for row t of the columns; lane (n,) is its posterior over lanes."""
    assigned = int(columns["assigned_lane"][t])
    crossing = columns.get("line_crossing_probability")
    return {
        "frame_id": int(columns["frame_id"][t]),
        "time_s": float(columns["time_s"][t]),
        "lane": assigned,
        "probability": float(lane[assigned - 1] if assigned else lane.max()),
        "line_crossing_probability": None if crossing is None else float(crossing[t]),
        "is_impossible": bool(columns["is_impossible"][t]),
        "events": events,
        "beliefs": {
            node: {name: float(columns[f"{node}_{name}"][t]) for name in model.values[node]}
            for node in nodes
        },
    }


def _event_rows(events: Mapping[str, NDArray[Any]]) -> list[dict[str, Any]]:
    """Return lane-change events as dicts; unknown values are None."""
    names = ("from_lane", "to_lane", "direction", "time_s", "probability")
    columns = [events[name].tolist() for name in names]
    return [
        {name: value if value == value else None for name, value in zip(names, row, strict=True)}
        for row in zip(*columns, strict=True)
    ]


# --- messages ------------------------------------------------------------------------------------


def read_messages(experiment: Experiment, messages: Iterable[str]) -> Iterator[LineLog]:
    """Parse JSON messages, one frame each; blank lines are skipped.

    A message is `{"frame_id": 7, "lines": [{"offset_m": -1.8, "is_valid": true, "is_continuous":
    false, "lri": 10}, ...]}`. `is_valid` is true by default, `is_continuous` false, `lri` unknown.
    `time_s`, seconds, is optional; with it the frame id may be omitted, and is the last one plus 1.
    `recording.columns` gives other names of these fields.

    Raises InputError, naming the message, for one that cannot be used.
    """
    recording = with_inputs(experiment).recording
    after = 0
    before = -np.inf
    for number, text in enumerate(messages, start=1):
        if text.strip():
            where = f"message {number}"
            log = _parse(text, where, recording, after)
            after = int(log.frame_id[0]) + 1
            now = float(log.time_s[0])
            if not before <= now < np.inf:
                raise InputError(f"{where}: time_s: {now:g} is not after that of the last message")
            before = now
            yield log


def _parse(text: str, where: str, recording: Recording, after: int) -> LineLog:
    """Return one frame. after: its id if the message has a time only."""
    columns = recording.columns
    frame_rate = recording.frame_rate
    try:
        content = from_json(text)
    except ValueError as error:
        raise InputError(f"{where}: is not JSON: {error}") from error
    if columns is not None:
        # The reader of bags is slow to import.
        from egolane_pgm.recordings.topics import lines_of_messages

        if not isinstance(content, dict):
            raise InputError(f"{where}: is not a JSON object")
        return lines_of_messages([content], columns, where, frame_rate, after)
    message = validated(_Message, content, where)
    lines = message.lines
    time_s = message.time_s
    frame_id = after if message.frame_id is None and time_s is not None else message.frame_id
    if frame_id is None:
        raise InputError(f"{where}: frame_id: is missing, as is time_s")
    log = LineLog.from_rows(
        np.array([frame_id]),
        frame_rate,
        np.zeros(len(lines), dtype=np.int64),
        # None becomes NaN.
        np.array([line.offset_m for line in lines], dtype=np.float64),
        np.array([line.is_valid for line in lines]),
        np.array([line.is_continuous for line in lines]),
        np.array([line.lri for line in lines], dtype=np.float64),
        source=where,
    )
    return log if time_s is None else replace(log, time_s=np.array([time_s]))

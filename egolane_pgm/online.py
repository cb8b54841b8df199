"""The filter as it runs in a car: lines of a frame in, the belief for that frame out, at once."""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from egolane_pgm.experiment import Experiment
from egolane_pgm.inference.filtering import step
from egolane_pgm.inference.layout import FilterState
from egolane_pgm.inference.smoothing import LagState, lag_rest, lag_step
from egolane_pgm.model import online_output, prepare_model, value_names
from egolane_pgm.recordings.select import clip_lri, fill_after
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.types import Beliefs, InputError, LineLog, suggestion

#: Whole numbers up to here are exact as floating-point times.
MAX_FRAME_ID = 2**53

_KEYS = {"frame_id", "lines"}
_LINE_KEYS = {"offset_m", "is_valid", "is_continuous", "lri"}


def filter_stream(experiment: Experiment, messages: Iterable[str]) -> Iterator[dict[str, Any]]:
    """Filter messages as they come, and yield the belief after each of them.

    - messages: one frame each, a JSON line such as `{"frame_id": 7, "lines": [{"offset_m": -1.8,
      "is_valid": true, "is_continuous": false, "lri": 10}, ...]}`. `is_valid` is true by default,
      `is_continuous` false, `lri` unknown. Blank lines are skipped.

    Yields `{frame_id, time_s, assigned_lane (0: Unassigned), is_impossible, beliefs: {node: {value:
    probability}}}`. With filter fixed_lag the belief about a frame comes `lag` frames later, those
    about the last frames at the end.

    Raises InputError, naming the message, for what cannot be used, and for filter smoothed, which
    needs the whole drive.
    """
    frame_rate = experiment.recording.frame_rate
    logs = (
        parse_message(text, f"message {number}", frame_rate)
        for number, text in enumerate(messages, start=1)
        if text.strip()
    )
    yield from filter_logs(experiment, logs)


def filter_logs(experiment: Experiment, logs: Iterable[LineLog]) -> Iterator[dict[str, Any]]:
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
    output_of = online_output(model, experiment.evidence_reading)
    recording, below = experiment.recording, experiment.unassigned_below
    max_lri = float(model.parameters.get("max_lri", 10))  # type: ignore[arg-type]
    state: FilterState | None = None
    late: LagState | None = None
    # Frames that wait for their answer; None stands for one that the recording lacks.
    waiting: deque[LineLog | None] = deque()
    last: LineLog | None = None
    for log in logs:
        if recording.lri == "clip":
            log = clip_lri(log, max_lri)
        due = fill_after(last, log, recording.missing_frames, recording.frame_rate)
        evidence = output_of(due).filtered
        last = log
        if experiment.lag is None:
            state, beliefs = step(model.compiled, state, evidence, experiment.filter)
            yield _answer(log, beliefs, len(due) - 1, names, below)
            continue
        waiting.extend([*[None] * (len(due) - 1), log])
        for t in range(len(due)):
            frame = evidence.take(slice(t, t + 1))
            late, beliefs = lag_step(model.compiled, late, frame, experiment.lag)
            yield from _answers(waiting, beliefs, names, below)
    if late is not None:
        rest = lag_rest(model.compiled, late)
        yield from _answers(waiting, rest, names, below)


def _answers(
    waiting: deque[LineLog | None],
    beliefs: Beliefs,
    names: Mapping[str, Sequence[str]],
    below: float,
) -> Iterator[dict[str, Any]]:
    """The answers to the first frames that wait, as many as there are beliefs."""
    for t in range(len(beliefs)):
        log = waiting.popleft()
        if log is not None:
            yield _answer(log, beliefs, t, names, below)


def _answer(
    log: LineLog, beliefs: Beliefs, t: int, names: Mapping[str, Sequence[str]], below: float
) -> dict[str, Any]:
    return {
        "frame_id": int(log.frame_id[0]),
        "time_s": float(log.time_s[0]),
        "assigned_lane": int(assigned_lane(beliefs.lane[t : t + 1], below)[0]),
        "is_impossible": bool(beliefs.is_impossible[t]),
        "beliefs": {
            node: dict(zip(names[node], values[t].tolist(), strict=True))
            for node, values in beliefs.marginals.items()
        },
    }


def parse_message(text: str, where: str, frame_rate: float) -> LineLog:
    """One message as a LineLog of one frame; see `filter_stream`."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: is not JSON: {error}") from error
    if not isinstance(content, dict):
        raise InputError(f"{where}: needs an object with frame_id and lines")
    _check_keys(content, _KEYS, where)
    frame_id, lines = content.get("frame_id"), content.get("lines")
    if isinstance(frame_id, bool) or not isinstance(frame_id, int):
        raise InputError(f"{where}: frame_id {frame_id!r} is not a whole number")
    if abs(frame_id) > MAX_FRAME_ID:
        raise InputError(f"{where}: frame_id {str(frame_id)[:30]} is too large for a frame count")
    if not isinstance(lines, list) or not all(isinstance(line, dict) for line in lines):
        raise InputError(f"{where}: lines must be a list of objects")
    rows = [_line(line, f"{where}: line {k}") for k, line in enumerate(lines, start=1)]
    columns = zip(*rows, strict=True) if rows else [()] * 4
    return LineLog.of_frame(frame_id, frame_rate, *columns, source=where)


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

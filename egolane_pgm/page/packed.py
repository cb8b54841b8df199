"""What a page's timeline shows of a result, in as few bytes as the eye needs.

Probabilities are bytes, 0 to CERTAIN, and BLANK where nothing is to be drawn; offsets are
centimetres. A long drive is thinned out: a step then stands for several frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.results import Result
from egolane_pgm.types import BoolArray, FloatArray, InputError, IntArray, LineLog
from egolane_pgm.views.answers import UNSEEN, is_known

#: The bytes of the probability 1, and of what is not drawn.
CERTAIN, BLANK = 254, 255

#: The most steps of a result. 100,000 frames are shown one by one.
MAX_STEPS = 200_000

#: Of a node with more values than this (a position in the lane) no probability is drawn.
FEW_VALUES = 4

#: How a line is drawn.
NOT_VALID, VALID, CONTINUOUS = 1, 2, 3


@dataclass(frozen=True)
class Packed:
    """A result of T frames as S steps.

    - frames_per_step: 1, or how many frames a step stands for.
    - step_s: seconds between steps.
    - columns: (S,) each. t: seconds; id: the frame id; b1..n and d1..n: belief and detector's
      answer, bytes; c1..: the probabilities of `curves`, bytes; model, detector, truth: lanes, 0 is
      none; crossing: 1 for a true lane change.
    - lines: (N,) each. cm: offsets, centimetres; kind: NOT_VALID, VALID or CONTINUOUS. Those of
      step k begin at columns["first"][k]. Empty where the result has no lines.
    - curves: what each of c1.. is the probability of.
    """

    frames_per_step: int
    step_s: float
    columns: Mapping[str, NDArray[Any]]
    lines: Mapping[str, NDArray[Any]]
    curves: tuple[str, ...]

    def of(self, *names: str) -> bytes:
        """The bytes of some columns, or of lines, and when they are: two results that share them
        show the same."""
        known = {**self.columns, **self.lines}
        arrays = (known[name].tobytes() for name in ("t", *names))
        return b"".join([*arrays, *map(str.encode, names)])


def packed(result: Result, max_steps: int = MAX_STEPS) -> Packed:
    """The steps of a result. Raises InputError for one without frames."""
    n_frames = len(result.frame_id)
    if not n_frames:
        raise InputError(f"{result.directory}: has no frames to show")
    each = -(-n_frames // max_steps)
    starts = np.arange(0, n_frames, each)
    frame = _told(result, starts, each)
    columns: dict[str, NDArray[Any]] = {
        "t": result.time_s[frame] if each == 1 else _means(result.time_s, starts),
        "id": result.frame_id[frame].astype(np.float64),
        "model": result.assigned_lane[frame].astype(np.uint8),
        "truth": result.true_lane[frame].astype(np.uint8),
        "crossing": result.is_crossing[frame].astype(np.uint8),
    }
    columns |= _lanes("b", result, result.marginals["Lane"], starts, frame)
    if result.tentative is not None and result.detector_lane is not None:
        columns |= _lanes("d", result, result.tentative, starts, frame)
        columns["detector"] = result.detector_lane[frame].astype(np.uint8)
    curves = _curves(result)
    for k, probability in enumerate(curves.values(), start=1):
        columns[f"c{k}"] = _bytes(_means(probability, starts))
    lines: Mapping[str, NDArray[Any]] = {}
    if result.lines is not None:
        columns["first"], lines = _lines(result.lines.take(frame))
    step = np.diff(columns["t"])
    step_s = float(np.median(step)) if len(step) else 1 / float(result.run["frame_rate"])
    return Packed(each, step_s, columns, lines, tuple(curves))


def _told(result: Result, starts: IntArray, each: int) -> IntArray:
    """(S,): the frame whose answers and lines a step shows: the first with a wrong answer, else the
    one in the middle."""
    last = len(result.frame_id) - 1
    middle = np.minimum(starts + each // 2, last)
    if each == 1:
        return middle
    wrong = np.flatnonzero(is_wrong(result))
    found = np.searchsorted(wrong, starts)
    first = np.append(wrong, last + each)[found]
    return np.where(first < starts + each, first, middle)


def is_wrong(result: Result) -> BoolArray:
    """(T,): whether the lane that is answered is not the true one, or none is answered."""
    wrong: BoolArray = is_known(result) & (result.assigned_lane != result.true_lane)
    return wrong


def _means(values: FloatArray, starts: IntArray) -> FloatArray:
    """The means over steps, along the first axis."""
    count = np.diff(np.append(starts, len(values)))
    sums: FloatArray = np.add.reduceat(values, starts, axis=0)
    return sums / count.reshape(-1, *[1] * (values.ndim - 1))


def _bytes(probability: FloatArray) -> NDArray[np.uint8]:
    return np.round(np.clip(probability, 0, 1) * CERTAIN).astype(np.uint8)


def _lanes(
    letter: str, result: Result, belief: FloatArray, starts: IntArray, frame: IntArray
) -> dict[str, NDArray[Any]]:
    mean = _means(belief, starts)
    image = _bytes(mean)
    if result.road_lanes is not None:
        no_lane = np.arange(result.n_lanes) >= result.road_lanes[frame][:, None]
        # The map may be wrong by a lane: what is believed there is shown.
        image[no_lane & (mean < UNSEEN)] = BLANK
    return {f"{letter}{k + 1}": image[:, k].copy() for k in range(image.shape[1])}


def _curves(result: Result) -> dict[str, FloatArray]:
    """Probabilities beside the lane's, by what they are of."""
    found = {
        f"P({node} = {result.values[node][0]})": result.marginals[node][:, 0]
        for node in result.values
        if node != "Lane" and len(result.values[node]) <= FEW_VALUES
    }
    if result.crossing is not None:
        found["P(on a line between two lanes)"] = result.crossing
    return found


def _lines(log: LineLog) -> tuple[NDArray[np.int32], dict[str, NDArray[Any]]]:
    is_there = np.isfinite(log.offset_m)
    first = np.append(0, np.cumsum(is_there.sum(axis=1)))[:-1].astype(np.int32)
    cm = np.clip(np.round(100 * log.offset_m[is_there]), -32767, 32767).astype(np.int16)
    kind = np.where(log.is_continuous, CONTINUOUS, VALID)
    kind = np.where(log.is_valid, kind, NOT_VALID)[is_there].astype(np.uint8)
    return first, {"cm": cm, "kind": kind}

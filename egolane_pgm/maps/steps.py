"""From a road table to the value of the input node Step in each frame of a recording.

The lanes change where the car passes a join of the map. The distance that it drove is taken from
the road table, whose rows need not be as dense as the frames, and a change is the step of the first
frame behind the join. Where the map may be wrong about the place (`place_sigma_m`), it is the step
of nine places around the join, with the chance of each.

At an exit or a fork it is known which road the car took. What that says of its lane is evidence in
the frame before: SERVED for a lane that leads there, OPTIONAL for one that also leads elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from egolane_pgm.graphs.lane_steps import HOLD, PLACES, Step
from egolane_pgm.maps.road_table import RoadTable
from egolane_pgm.types import MAX_LANES, BoolArray, FloatArray, InputError, IntArray

#: P(the car is in a lane | it took the branch that this lane serves), in proportion to that of a
#: lane which does not serve it: .98 to .02.
SERVED = 0.98

#: The same for a lane that serves this branch and another.
OPTIONAL = 0.5

#: The speed that is assumed where no rows give it, metres per second.
_USUAL_SPEED = 25.0


@dataclass(frozen=True)
class RoadChanges:
    """C places at which the lanes of a drive change, or the road splits, in order.

    - at_m (C,): metres driven there since the first row.
    - steps: the change at each.
    - is_branch (C,): whether the road splits there.
    - optional (C,): the lanes before it that lead to another road too.
    - row_m (T,): metres driven at each row of the road table.
    - n_lanes (T,): lanes at each row; where the table does not know, those of the row before.
    - is_guess (T,): whether that is a guess.
    """

    at_m: FloatArray
    steps: tuple[Step, ...]
    is_branch: tuple[bool, ...]
    optional: tuple[tuple[int, ...], ...]
    row_m: FloatArray
    n_lanes: IntArray
    is_guess: BoolArray

    def vocabulary(self, *, is_exact: bool = False) -> str:
        """The values of the input node for this road, as `lane_steps` writes them.

        - is_exact: whether each change is where the map has it, without places around it.
        """
        here = {*zip(self.n_lanes.tolist(), self.is_guess.tolist(), strict=True)}
        here |= {(step.after, step.is_guess) for step in self.steps}
        words = [str(Step(n, n, is_guess=guess)) for n, guess in sorted(here)]
        for step in dict.fromkeys(self.steps):
            words.append(str(step))
            if _is_change(step) and not is_exact:
                words += [str(replace(step, place=k + 1)) for k in range(len(PLACES))]
        return " ".join([*dict.fromkeys(words), *([] if is_exact else [str(HOLD)])])


@dataclass(frozen=True)
class LanesAlong:
    """The lanes of the road in each of T frames.

    - n_lanes (T,): as the map says.
    - step (T,): index of the frame's step among the words of `steps`.
    - steps: the values of the input node, with blanks between them.
    - served (T, N): evidence of Lane, 1 where nothing is known.
    - origin (T,): lane k of a frame is lane k - origin of the first one, if it was there then.
      Lanes that come and go at the left move the numbers.
    - changes (C,): the frames in which the lanes of the map change.
    - is_renumbering (T,): marks frames near a change at the left whose place is uncertain: their
      lanes may still have, or already have, other numbers.
    """

    n_lanes: IntArray
    step: IntArray
    steps: str
    served: FloatArray
    origin: IntArray
    changes: IntArray
    is_renumbering: BoolArray

    def __len__(self) -> int:
        return len(self.n_lanes)


def _is_change(step: Step) -> bool:
    """Whether lanes begin, end or get other numbers; else its number may begin to be a guess."""
    return step.before != step.after or bool(step.shift)


def road_changes(table: RoadTable, *, doubts_guesses: bool = False) -> RoadChanges:
    """The changes of lanes along a drive.

    Where the table does not know the lanes (off the map, or a segment without a number), they are
    those of the row before.

    - doubts_guesses: whether a guess of an `untold` number is told from a number of the map.

    Raises InputError where no row knows them, and for more lanes than
    MAX_LANES.
    """
    known = table.n_lanes > 0
    if not known.any():
        raise InputError(f"{table.source}: no row knows how many lanes the road has")
    if table.n_lanes.max() > MAX_LANES:
        row = int(table.n_lanes.argmax())
        raise InputError(
            f"{table.source}: row {row}: a road of {int(table.n_lanes[row])} lanes; at most"
            f" {MAX_LANES} are taken"
        )
    last = np.maximum.accumulate(np.where(known, np.arange(len(table)), -1))
    n_lanes = np.where(last >= 0, table.n_lanes[np.maximum(last, 0)], table.n_lanes[known.argmax()])
    # Off the map the number before goes on, and with it that it is a guess.
    is_guess = doubts_guesses & ((table.untold > 0) | (table.untold[np.maximum(last, 0)] > 0))
    passes, driven = _passes(table)
    row_m = np.concatenate([[0.0], np.cumsum(driven)])
    at_m: list[float] = []
    steps: list[Step] = []
    is_branch: list[bool] = []
    optional: list[tuple[int, ...]] = []
    differs = (np.diff(n_lanes) != 0) | np.diff(is_guess)
    for row in map(int, np.flatnonzero(passes | differs)):
        before, after = int(n_lanes[row]), int(n_lanes[row + 1])
        # The row's next join is this one if the lanes behind it are those that the row has.
        is_told = bool(passes[row]) and int(table.next_n_lanes[row]) == after
        shift = table.next_shift[row] if is_told else np.nan
        side = _shift(before, after, shift, table, row, is_told)
        if before == after and side == 0 and is_guess[row] != is_guess[row + 1]:
            side = None
        step = Step(before, after, side, is_guess=bool(is_guess[row + 1]))
        branch = is_told and table.next_join[row] in ("exit", "fork") and step.shift is not None
        ahead = table.next_in_m[row] if passes[row] else driven[row] / 2
        if _is_change(step) or step.shift is None or branch:
            at_m.append(float(row_m[row] + min(ahead, driven[row])))
            steps.append(step)
            is_branch.append(bool(branch))
            optional.append(_optional(table, row) if branch else ())
    return RoadChanges(
        np.array(at_m), tuple(steps), tuple(is_branch), tuple(optional), row_m, n_lanes, is_guess
    )


def _optional(table: RoadTable, row: int) -> tuple[int, ...]:
    words = str(table.next_optional[row]).split()
    if not all(word.isdigit() and 1 <= int(word) <= MAX_LANES for word in words):
        raise InputError(
            f"{table.source}: row {row}: next_optional: '{table.next_optional[row]}' are no lanes"
            " such as '2' or '2 3'"
        )
    return tuple(map(int, words))


def _shift(
    before: int, after: int, shift: float, table: RoadTable, row: int, is_told: bool
) -> int | None:
    """The shift of a change, from its side where only that is known."""
    if np.isfinite(shift):
        return round(float(shift))
    if before == after:
        return 0
    # At a split the side is that of a branch, and not of the lanes that end.
    if is_told and table.next_join[row] == "same" and table.next_side[row] != 0:
        return 0 if table.next_side[row] > 0 else after - before
    return None


def _passes(table: RoadTable) -> tuple[BoolArray, FloatArray]:
    """For each two rows that follow each other: whether the car passes the join that the first one
    has ahead (T - 1,), and the metres between them.

    A join lies between two segments. The rows do not say whether it lies between them or farther
    ahead, where the segments differ for another reason: what fits the car's speed is taken.
    """
    time = np.diff(table.t_s)
    segment, along = table.segment, table.along_m
    on_map = (segment[:-1] >= 0) & (segment[1:] >= 0)
    same = on_map & (segment[:-1] == segment[1:])
    sure = same & (np.diff(along) > 0)
    speed = np.full(len(time), _USUAL_SPEED)
    if sure.any():
        rows = np.arange(len(time))
        speed = np.interp(rows, rows[sure], (np.diff(along) / time)[sure])
    expected = speed * time
    ahead, later = table.next_in_m[:-1], table.next_in_m[1:]
    if_passed, if_not = ahead + along[1:], ahead - later
    fits = ~(np.abs(if_not - expected) <= np.abs(if_passed - expected))
    passes = on_map & ~same & np.isfinite(if_passed) & fits
    driven = np.where(same, np.diff(along), np.where(passes, if_passed, if_not))
    driven = np.where(np.isfinite(driven), driven, expected)
    return passes, np.maximum(driven, 0.0)


def lanes_along(
    table: RoadTable,
    time_s: FloatArray,
    *,
    steps: str,
    n_lanes: int,
    place_sigma_m: float = 0.0,
    source: str = "recording",
) -> LanesAlong:
    """The lanes of the road in each of T frames, as the input node takes them.

    - time_s (T,): of the frames, seconds, by the same clock as the table's.
    - steps: the values of the input node, which must have those of this road.
    - n_lanes: number of values of Lane.
    - place_sigma_m: standard deviation of the places where lanes begin and end about the map's,
      metres; 0 for a map that is exact.
    - source: the recording, for messages.

    Frames before the first row and behind the last one have its lanes. Raises InputError, with both
    ranges, where the clocks do not overlap, and for lanes or steps that the graph does not have.
    """
    check_overlap(table, time_s, source)
    found = road_changes(table, doubts_guesses="~" in steps)
    number = {word: k for k, word in enumerate(steps.split())}
    driven = np.interp(time_s, table.t_s, found.row_m)

    def frame_at(metres: float) -> int:
        return int(np.searchsorted(driven, metres, side="left"))

    # A drive that ends on the way to a change never gets there; one that begins behind it neither.
    frames: dict[int, int] = {}
    for c, at in enumerate(found.at_m):
        frame = frame_at(float(at))
        if frame > 0:
            # Two changes in one frame become the steps of two frames.
            frame = max([frame, *(before + 1 for before in frames.values())])
            if frame < len(time_s):
                frames[c] = frame
    behind = np.flatnonzero(found.at_m <= driven[0])
    first_n, first_is_guess = int(found.n_lanes[0]), bool(found.is_guess[0])
    if len(behind):
        first_n = found.steps[behind[-1]].after
        first_is_guess = found.steps[behind[-1]].is_guess
    step_of = np.full(len(time_s), -1, dtype=np.int64)
    n_map = np.full(len(time_s), first_n, dtype=np.int64)
    is_guess = np.full(len(time_s), first_is_guess)
    origin = np.zeros(len(time_s), dtype=np.int64)
    served = np.ones((len(time_s), n_lanes))
    is_renumbering = np.zeros(len(time_s), dtype=bool)
    for c, frame in frames.items():
        step = found.steps[c]
        n_map[frame:] = step.after
        is_guess[frame:] = step.is_guess
        origin[frame:] += step.shift or 0
    both = zip(n_map.tolist(), is_guess.tolist(), strict=True)
    words = [str(Step(n, n, is_guess=guess)) for n, guess in both]
    taken = set(frames.values())
    for c, frame in frames.items():
        step = found.steps[c]
        if found.is_branch[c]:
            served[frame - 1] = _served(step, n_lanes, found.optional[c])
        places = [frame_at(found.at_m[c] + z * place_sigma_m) for z in PLACES]
        is_clear = (
            place_sigma_m > 0
            and not found.is_branch[c]
            and _is_change(step)
            and places[0] > 0
            and places[-1] < len(time_s)
            and len(set(places)) == len(places)
            and not (taken - {frame}).intersection(range(places[0], places[-1] + 1))
        )
        if not is_clear:
            if _is_change(step) or step.shift is None:
                words[frame] = str(step)
            continue
        # Two changes that are near each other do not share their places.
        taken.update(range(places[0], places[-1] + 1))
        is_renumbering[places[0] : places[-1] + 1] = step.shift != 0
        words[places[0] : places[-1] + 1] = [str(HOLD)] * (places[-1] + 1 - places[0])
        for k, place in enumerate(places):
            words[place] = str(replace(step, place=k + 1))
    try:
        step_of[:] = [number[word] for word in words]
    except KeyError as error:
        raise InputError(
            f"{table.source}: the step '{error.args[0]}' of this road is not among the graph's:"
            f" {steps}"
        ) from None
    if n_map.max() > n_lanes:
        raise InputError(
            f"{table.source}: the road has {int(n_map.max())} lanes, n_lanes is {n_lanes}"
        )
    changes = np.array(
        [frame for c, frame in frames.items() if _is_change(found.steps[c])], dtype=np.int64
    )
    return LanesAlong(n_map, step_of, steps, served, origin, changes, is_renumbering)


def check_overlap(table: RoadTable, time_s: FloatArray, source: str) -> None:
    """Raise InputError, with both ranges, where the clocks of a road table and of the frames of a
    source do not overlap."""
    if not len(time_s) or time_s[-1] < table.t_s[0] or time_s[0] > table.t_s[-1]:
        span = f"{time_s[0]:g} to {time_s[-1]:g} s" if len(time_s) else "no frames"
        raise InputError(
            f"{table.source}: has the times {table.t_s[0]:g} to {table.t_s[-1]:g} s, and {source}"
            f" has {span}: they do not overlap"
        )


def _served(step: Step, n_lanes: int, optional: tuple[int, ...]) -> FloatArray:
    """(N,): evidence of Lane before a split whose branch is known."""
    onto = np.arange(1, n_lanes + 1) + (step.shift or 0)
    # A lane that the map does not have is beside its last one.
    onto[step.before :] = onto[step.before - 1]
    leads = (onto >= 1) & (onto <= step.after)
    elsewhere = np.isin(np.arange(1, n_lanes + 1), optional)
    return np.where(leads, np.where(elsewhere, OPTIONAL, SERVED), 1 - SERVED)


def on_constant_road(n_frames: int, n_lanes: int) -> LanesAlong:
    """A road of n lanes on which nothing changes, for T frames."""
    zeros = np.zeros(n_frames, dtype=np.int64)
    ones = np.ones((n_frames, n_lanes))
    none = zeros.astype(bool)
    return LanesAlong(zeros + n_lanes, zeros, str(n_lanes), ones, zeros, zeros[:0], none)

"""How lanes continue where one segment ends and others begin.

With p the place of the way's line from the left edge, in lanes, lane i continues as i + s with
s = p_next - p_previous; a shift that is no whole number says nothing. Other sources are asked where
placement cannot tell: the arrows of `turn:lanes`, the sums of lanes where roads meet, and at last
the habit that lanes begin and end at the side of the slow traffic. Each shift says its source.

All joins are worked on at once, as arrays: a country has a million.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from egolane_pgm.maps.lane_graph import LaneGraph, along_points, metres_per_degree
from egolane_pgm.types import BoolArray, FloatArray, IntArray

#: No road leads on where one would turn back by more than this; measured over TURN_M metres.
MOST_TURN_DEG, TURN_M = 135.0, 15.0

#: The distance, metres, from where two roads part or meet at which the left one of both is found.
LOOK_M = 60.0


def with_joins(ways: LaneGraph, is_placed: BoolArray, *, drives_left: bool = False) -> LaneGraph:
    """The same S segments with the joins between them: J, where one ends and another begins.

    - ways: its own joins are not looked at.
    - is_placed (S,): whether a tag gave the placement. Placements that no tag gave count only with
      others that fit: where the number of lanes changes, a tag has to give one of both, and where
      it stays, neither or both.
    - drives_left: traffic keeps to the left, so that lanes are taken to begin and end at the left.
    """
    meeting = _meeting(ways)
    placed = _by_placement(ways, is_placed, meeting)
    arrows = _by_arrows(ways, meeting)
    summed = _by_lane_count(ways, meeting)
    habit = _by_driving_side(ways, meeting, drives_left)
    shift = np.full(len(meeting.before), np.nan)
    source = np.full(len(shift), "", dtype="<U12")
    n, n_next = ways.n_lanes[meeting.before], ways.n_lanes[meeting.after]
    for name, found in (
        ("placement", placed),
        ("turn:lanes", arrows),
        ("lane count", summed),
        ("driving side", habit),
    ):
        # At least one lane has to continue.
        takes = np.isnan(shift) & (found > -n) & (found < n_next)
        shift[takes], source[takes] = found[takes], name
    return replace(
        ways,
        before=meeting.before,
        after=meeting.after,
        shift=shift,
        join=meeting.join,
        side=_sides(meeting, n, n_next, shift),
        source=source,
    )


# --- what meets what ---------------------------------------------------------------------------


@dataclass(frozen=True)
class _Meeting:
    """J joins and their groups: at a split all that leave one segment, at a merge all that reach
    one, elsewhere the join alone.

    - group (J,): a number of each group; size (J,): how many joins it has.
    - rank (J,): the road's place in its group, from the left, from 0.
    - is_split, is_merge (J,).
    - from_link, to_link (J,): whether before or after is a link.
    """

    before: IntArray
    after: IntArray
    join: NDArray[np.str_]
    group: IntArray
    size: IntArray
    rank: IntArray
    is_split: BoolArray
    is_merge: BoolArray
    from_link: BoolArray
    to_link: BoolArray

    def total(self, value: NDArray[np.generic]) -> FloatArray:
        """The sum of a value over the joins of each join's group, (J,)."""
        sums = np.bincount(self.group, weights=value.astype(np.float64)).astype(np.float64)
        return sums[self.group]


def _meeting(ways: LaneGraph) -> _Meeting:
    before, after = _pairs(ways)
    leaving, arriving = _headings(ways, TURN_M)
    goes_on = np.abs(_turned(leaving[after] - arriving[before])) <= MOST_TURN_DEG
    before, after = before[goes_on], after[goes_on]
    n_out = np.bincount(before, minlength=len(ways))[before]
    n_in = np.bincount(after, minlength=len(ways))[after]
    is_split = n_out > 1
    is_merge = ~is_split & (n_in > 1)
    key = np.where(is_split, before, np.where(is_merge, len(ways) + after, -1 - before))
    group: IntArray = np.unique(key, return_inverse=True)[1].astype(np.int64)
    leaving, arriving = _headings(ways, LOOK_M)
    # What leaves to the left is at the left, and what comes from there has to turn left too.
    order = np.lexsort((-_turned(leaving[after] - arriving[before]), group))
    begins = np.searchsorted(group[order], group[order])
    rank = np.empty(len(group), dtype=np.int64)
    rank[order] = np.arange(len(group)) - begins

    is_link = np.char.endswith(ways.kind, "_link")
    from_link, to_link = is_link[before], is_link[after]
    size = np.bincount(group)[group]
    links = np.bincount(group, np.where(is_split, to_link, from_link))[group]
    differ = (links > 0) & (links < size)
    # Where a road ends in a link of fewer lanes, the rest of it is not on the map.
    is_cut = ~is_split & ~is_merge & ~from_link & to_link
    is_cut &= ways.n_lanes[after] < ways.n_lanes[before]
    join = np.select(
        [is_split & differ, is_split, is_merge & differ, is_merge, is_cut],
        ["exit", "fork", "entry", "merge", "exit"],
        "same",
    )
    return _Meeting(before, after, join, group, size, rank, is_split, is_merge, from_link, to_link)


def _pairs(ways: LaneGraph) -> tuple[IntArray, IntArray]:
    """The segments of which one ends at the very point where the other begins, sorted."""
    n = len(ways)
    ends = np.rint(
        np.concatenate([ways.point[ways.first[:-1]], ways.point[ways.first[1:] - 1]]) * 1e7
    ).astype(np.int64)
    place = np.unique(ends[:, 0] * 4_000_000_000 + ends[:, 1], return_inverse=True)[1]
    order = np.argsort(place[:n], kind="stable")
    begins = place[:n][order]
    low, high = (np.searchsorted(begins, place[n:], side) for side in ("left", "right"))
    count = high - low
    before = np.repeat(np.arange(n), count)
    nth = np.arange(len(before)) - np.repeat(np.cumsum(count) - count, count)
    return before, order[low[before] + nth]


def _headings(ways: LaneGraph, metres: float) -> tuple[FloatArray, FloatArray]:
    """The direction over the first and over the last metres of each segment, (S,) both: degrees
    from east, to the left."""
    first, last = ways.first[:-1], ways.first[1:] - 1
    length = along_points(ways.point, ways.first)
    # Every point's place on all segments laid one behind the other, so that one search finds all.
    ends = np.cumsum(length[last])
    total = length + np.repeat(ends - length[last], np.diff(ways.first))
    north, east = metres_per_degree(ways.point[first, 0])

    def point_at(target: FloatArray) -> FloatArray:
        after = np.clip(np.searchsorted(total, target), first + 1, last)
        piece = total[after] - total[after - 1]
        share = np.clip((target - total[after - 1]) / np.where(piece > 0, piece, 1.0), 0.0, 1.0)
        start = ways.point[after - 1]
        place: FloatArray = start + share[:, None] * (ways.point[after] - start)
        return place

    def heading(start: FloatArray, stop: FloatArray) -> FloatArray:
        across = (stop - start) * np.stack([north, east], axis=1)
        angle: FloatArray = np.degrees(np.arctan2(across[:, 0], across[:, 1]))
        return angle

    reach = np.minimum(metres, total[last] - total[first])
    return (
        heading(ways.point[first], point_at(total[first] + reach)),
        heading(point_at(total[last] - reach), ways.point[last]),
    )


def _turned(degrees: FloatArray) -> FloatArray:
    """The same turn, from -180 to 180; positive to the left."""
    return (degrees + 180.0) % 360.0 - 180.0


# --- shifts ------------------------------------------------------------------------------------


def _by_placement(ways: LaneGraph, is_placed: BoolArray, meeting: _Meeting) -> FloatArray:
    """Shifts by where the ways' lines lie. A link that leaves or reaches a road is drawn from the
    road's line, wherever its lanes are, and so are the arms of a fork."""
    before, after = meeting.before, meeting.after
    shift = ways.placement[after, 0] - ways.placement[before, 1]
    whole = np.rint(shift)
    along = (meeting.join == "same") | ~(meeting.from_link | meeting.to_link)
    along &= (meeting.join != "fork") & (meeting.join != "merge")
    one, two = is_placed[before], is_placed[after]
    fits = np.where(ways.n_lanes[before] == ways.n_lanes[after], one == two, one | two)
    with np.errstate(invalid="ignore"):
        found = along & fits & (np.abs(shift - whole) < 1e-6)
    return np.where(found, whole, np.nan)


def _by_arrows(ways: LaneGraph, meeting: _Meeting) -> FloatArray:
    """Shifts by the arrows of the segment that is left: which of its lanes lead on to the next."""
    shift = np.full(len(meeting.before), np.nan)
    turn = ways.turn[meeting.before]
    other = np.where(meeting.is_split, 1 - 2 * meeting.rank, 0)
    alone = ~meeting.is_split & ~meeting.is_merge
    is_read = alone | (meeting.is_split & (meeting.size == 2))
    for k in np.flatnonzero((turn != "") & is_read):
        first = _first_lane(
            str(turn[k]), int(ways.n_lanes[meeting.after[k]]), int(other[k]), meeting.join[k]
        )
        if first:
            shift[k] = 1 - first
    return shift


def optional_lanes(graph: LaneGraph, joins: IntArray) -> NDArray[np.str_]:
    """The optional lanes of some joins, (K,): those of the road before, with blanks between, that
    lead to this road and to another; "" where there is none, and where no road parts.

    They are those whose arrows (`turn:lanes`) lead to two sides; without arrows the lanes that
    continue on both roads.

    - joins (K,): rows of the graph's joins.
    """
    known, place = np.unique(joins, return_inverse=True)
    return np.array([_optional(graph, int(join)) for join in known], dtype=np.str_)[place]


def _optional(graph: LaneGraph, join: int) -> str:
    before = graph.before[join]
    first, stop = np.searchsorted(graph.before, [before, before + 1])
    others = [_leading(graph, j) for j in range(first, stop) if j != join]
    if not others:
        return ""
    turn = str(graph.turn[before])
    arrows = _arrows(turn)
    if turn and len(arrows) == graph.n_lanes[before]:
        both = {lane for lane, each in enumerate(arrows, start=1) if _sides_of(each) > 1}
    else:
        both = set().union(*others)
    return " ".join(map(str, sorted(_leading(graph, join) & both)))


def _leading(graph: LaneGraph, join: int) -> set[int]:
    """The lanes of the road before that continue on the road behind a join."""
    shift, n_next = graph.shift[join], graph.n_lanes[graph.after[join]]
    if np.isnan(shift):
        return set()
    lanes = np.arange(1, graph.n_lanes[graph.before[join]] + 1)
    return set(lanes[(lanes + shift >= 1) & (lanes + shift <= n_next)].tolist())


def _arrows(turn: str) -> list[set[str]]:
    return [{arrow.strip() for arrow in lane.split(";")} for lane in turn.split("|")]


def _sides_of(arrows: set[str]) -> int:
    """The number of sides (left, ahead, right) to which the arrows of a lane lead."""
    leading = {arrow for arrow in arrows if not arrow.startswith("merge")}
    return len({arrow.rpartition("_")[2] for arrow in leading} & {"left", "right"}) + bool(
        leading & {"", "none", "through"}
    )


@cache
def _first_lane(turn: str, n_next: int, other: int, join: str) -> int:
    """The first of the lanes that lead on to a road of n_next lanes; 0 where no arrows show it.

    - other: 1 where another road parts to the right, -1 to the left, 0 where there is none.
    """
    listed = _arrows(turn)

    def lanes(fits: Callable[[str], bool]) -> set[int]:
        return {k for k, arrows in enumerate(listed, start=1) if any(map(fits, arrows))}

    ending = lanes(lambda arrow: arrow.startswith("merge"))
    left = lanes(lambda arrow: arrow.endswith("left")) - lanes(lambda a: a == "merge_to_left")
    right = lanes(lambda arrow: arrow.endswith("right")) - lanes(lambda a: a == "merge_to_right")
    onward = lanes(lambda arrow: arrow in ("", "none", "through"))
    if other:
        near, far = (left, right) if other > 0 else (right, left)
        # Without arrows to the other side those ahead are for the other road.
        choices = [near, near | onward | ending] if far else [near]
    elif join == "exit":
        choices = [right or left]
    else:
        choices = [set(range(1, len(listed) + 1)) - ending, onward] if ending else [onward]
    for lane in choices:
        if lane and len(lane) == n_next == max(lane) - min(lane) + 1:
            return min(lane)
    return 0


def _by_lane_count(ways: LaneGraph, meeting: _Meeting) -> FloatArray:
    """Shifts by how the lanes of the roads that part or meet add up; at most one lane in common."""
    n, n_next = ways.n_lanes[meeting.before], ways.n_lanes[meeting.after]
    arm = np.where(meeting.is_merge, n, n_next)
    whole = np.where(meeting.is_merge, n_next, n)
    total = meeting.total(arm)
    known = (whole > 0) & (meeting.total(arm == 0) == 0)
    order = np.lexsort((meeting.rank, meeting.group))
    running = np.cumsum(arm[order]) - arm[order]
    begins = np.searchsorted(meeting.group[order], meeting.group[order])
    at_left = np.empty(len(arm), dtype=np.int64)
    at_left[order] = running - running[begins]
    # Where there is a lane more, one lane of the whole road is both roads' (two roads only).
    in_common = (total == whole + 1) & (meeting.size == 2)
    at_left = np.where(in_common & (meeting.rank == 1), whole - arm, at_left)
    adds_up = known & ((total == whole) | in_common)
    # Where roads both part and meet in one point, nobody knows which lanes are whose.
    n_in = np.bincount(meeting.after, minlength=len(ways))[meeting.after]
    adds_up &= ~meeting.is_split | (meeting.total(n_in > 1) == 0)
    return np.where(adds_up, np.where(meeting.is_merge, at_left, -at_left), np.nan)


def _by_driving_side(ways: LaneGraph, meeting: _Meeting, drives_left: bool) -> FloatArray:
    """Shifts of a road that goes on, where lanes begin and end at the side of the slow traffic."""
    n, n_next = ways.n_lanes[meeting.before], ways.n_lanes[meeting.after]
    along = (meeting.join == "same") | ~(meeting.from_link | meeting.to_link)
    along &= (meeting.join != "fork") & (meeting.join != "merge") & (n > 0) & (n_next > 0)
    return np.where(along, n_next - n if drives_left else 0.0, np.nan)


def _sides(meeting: _Meeting, n: IntArray, n_next: IntArray, shift: FloatArray) -> IntArray:
    """Where the link or the change is, -1 left to 1 right; for forks and merges which arm it is."""
    is_link = np.where(meeting.is_split, meeting.to_link, meeting.from_link)
    links = meeting.total(is_link)
    with np.errstate(invalid="ignore"):
        # The mean places of the links and of the other roads in their group.
        link_at = meeting.total(meeting.rank * is_link) / links
        road_at = meeting.total(meeting.rank * ~is_link) / (meeting.size - links)
        of_link = np.sign(np.where(is_link, meeting.rank, link_at) - road_at)
        changes_left = shift != 0
        changes_right = n_next - n - shift != 0
        of_change = np.where(changes_left, -1, 0) + np.where(changes_right, 1, 0)
    is_arm = (meeting.join == "fork") | (meeting.join == "merge")
    of_arm = np.where(meeting.rank == 0, -1, np.where(meeting.rank == meeting.size - 1, 1, 0))
    alone = ~meeting.is_split & ~meeting.is_merge
    of_change = np.where(np.isnan(shift) | (n == 0) | (n_next == 0), 0, of_change)
    # The lanes that end are those of the road; the link is at the other side.
    of_change = np.where(meeting.join == "exit", -of_change, of_change)
    side = np.where(alone, of_change, np.where(is_arm, of_arm, of_link))
    return np.nan_to_num(side).astype(np.int64)

"""What a page lists, and a click goes to: the worst stretches of a drive, its lane changes, its
clips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from egolane_pgm.inference.events import SURE
from egolane_pgm.page.packed import is_wrong
from egolane_pgm.results import Result
from egolane_pgm.scoring.events import TOLERANCES_S, is_judged, match_events
from egolane_pgm.scoring.stability import lane_changes
from egolane_pgm.types import SIDES, UNASSIGNED, IntArray, LaneTruth, joined, pieces_of
from egolane_pgm.views.answers import is_known

#: How many stretches are listed, and how many lane changes or clips.
STRETCHES, ROWS = 10, 300

#: Stretches that are closer to each other are one, seconds.
JOIN_S = 1.0

#: What became of a lane change.
RIGHT, FALSE, MISSED, UNKNOWN = "right", "no such change", "not told", ""


@dataclass(frozen=True)
class Place:
    """A place on the timeline, and what is said of it.

    - begin_s, end_s: seconds.
    - cells: its row of a table.
    """

    begin_s: float
    end_s: float
    cells: tuple[str, ...]


@dataclass(frozen=True)
class Change:
    """A lane change that was told, or a true one.

    - begin_s, end_s: of a told one when the new lane became the more probable one, and when it was
      told; of a true one its crossing.
    - probability: of the new lane, when told; NaN of a true one.
    - delay_s: from the end of the true crossing to the report; NaN where there is none.
    - direction: of a told one, -1 to the left and 1 to the right; from_lane and to_lane may be
      UNASSIGNED then.
    - outcome: of a told one RIGHT, FALSE or, where the truth says nothing, UNKNOWN; of a true one
      RIGHT or MISSED.
    """

    begin_s: float
    end_s: float
    from_lane: int
    to_lane: int
    probability: float
    delay_s: float
    outcome: str
    direction: int = 0


@dataclass(frozen=True)
class Changes:
    """The lane changes that were told, and the true ones, each in the order of time."""

    told: tuple[Change, ...]
    true: tuple[Change, ...]

    @property
    def listed(self) -> list[Change]:
        """Those that were told, and the true ones that were not, in the order of time."""
        missed = [change for change in self.true if change.outcome == MISSED]
        return sorted([*self.told, *missed], key=lambda change: change.begin_s)


def worst_stretches(result: Result) -> tuple[str, list[str], list[Place]]:
    """The stretches with the most wrong frames; without ground truth, those in which the belief is
    least sure. Returns what is listed, the table's header, and the places, the worst first."""
    has_truth = result.truth is not None
    top = result.marginals["Lane"].max(axis=1)
    marked = is_wrong(result) if has_truth else top < SURE
    weight = marked.astype(np.float64) if has_truth else 1 - top
    found = joined(marked, result.time_s, JOIN_S)
    found.sort(key=lambda part: -float(weight[part[0] : part[1]].sum()))
    places = []
    for start, stop in found[:STRETCHES]:
        rows = slice(start, stop)
        bad = np.flatnonzero(marked[rows]) + start
        begin, end = float(result.time_s[start]), float(result.time_s[stop - 1])
        cells = [f"{begin:.1f} to {end:.1f}", f"{int(result.frame_id[start])}"]
        cells += [f"{len(bad)} of {stop - start}", _lanes(result.assigned_lane[bad])]
        cells.append(_lanes(result.true_lane[bad]) if has_truth else f"{top[rows].min():.2f}")
        places.append(Place(begin, end, tuple(cells)))
    if has_truth:
        n_wrong, n_scored = int(marked.sum()), int(is_known(result).sum())
        said = f"{n_wrong} of {n_scored} frames are wrong, in {len(found)} stretches"
        return said, ["time, s", "from frame", "wrong", "answered", "true lane"], places
    said = f"the belief is below {SURE:g} in {int(marked.sum())} frames, {len(found)} stretches"
    return said, ["time, s", "from frame", "unsure", "answered", "lowest belief"], places


def _lanes(lanes: IntArray) -> str:
    return ", ".join("none" if lane == UNASSIGNED else str(lane) for lane in np.unique(lanes))


def changes_of(result: Result) -> Changes:
    """The lane changes of a result, told and true."""
    events, truth = result.events, result.truth
    rate = float(result.run["frame_rate"])
    since = result.time_s[np.searchsorted(result.frame_id, events.frame_id)]
    told = result.time_s[np.searchsorted(result.frame_id, events.told_frame_id)]
    # With filter fixed_lag a belief is known later than its frame.
    told = told + events.told_time_s - events.told_frame_id / rate
    delay = np.full(len(events), np.nan) if events.delay_s is None else events.delay_s
    outcome = [UNKNOWN] * len(events)
    true: list[Change] = []
    if truth is not None:
        true, is_right = _true_changes(result, truth)
        for e, is_known in enumerate(is_judged(events, truth)):
            outcome[e] = RIGHT if is_right[e] else FALSE if is_known else UNKNOWN
    columns = (since, told, events.from_lane, events.to_lane, events.probability, delay)
    rows = zip(
        *(column.tolist() for column in columns), outcome, events.direction.tolist(), strict=True
    )
    return Changes(tuple(Change(*row) for row in rows), tuple(true))


def _true_changes(result: Result, truth: LaneTruth) -> tuple[list[Change], list[bool]]:
    """The true changes, and for each told one whether it is right."""
    events, added = result.with_same_lanes(result.events), result.renumbered
    rows = np.searchsorted(result.frame_id, truth.frame_id)
    lanes = replace(truth, lane=truth.lane + added[rows])
    matched = match_events(events, lanes, float(result.run["frame_rate"]), max(TOLERANCES_S))
    changes = lane_changes(lanes.lane, lanes.is_crossing)
    told = set(matched.tolist())
    found = []
    for c in range(len(changes)):
        start, end = rows[changes.start[c]], rows[changes.end[c]]
        one, other = changes.from_lane[c] - added[end], changes.to_lane[c] - added[end]
        times = float(result.time_s[start]), float(result.time_s[end])
        outcome = RIGHT if c in told else MISSED
        found.append(Change(*times, int(one), int(other), np.nan, np.nan, outcome))
    return found, [bool(each >= 0) for each in matched]


def change_places(changes: Sequence[Change]) -> tuple[list[str], list[Place]]:
    """Header and rows of a table of lane changes."""
    places = []
    for change in changes:
        told = f"{change.end_s:.1f}" if change.outcome != MISSED else "-"
        sure = "-" if np.isnan(change.probability) else f"{change.probability:.3f}"
        outcome = change.outcome
        if outcome == RIGHT:
            outcome = f"{RIGHT}, {change.delay_s:+.1f} s"
        lanes = f"{change.from_lane} → {change.to_lane}"
        if change.from_lane == UNASSIGNED:
            lanes = SIDES[change.direction]
        cells = (f"{change.begin_s:.1f}", lanes, told, sure, outcome)
        places.append(Place(change.begin_s, change.end_s, cells))
    return ["time, s", "lanes", "told at, s", "probability", "truth"], places


def clip_places(result: Result) -> tuple[list[str], list[Place]]:
    """Header and rows of a table of the clips of a recording."""
    columns = result.clip_columns()
    if not columns or result.clip is None:
        return [], []
    places = []
    for k, piece in enumerate(pieces_of(result.clip, len(result.frame_id))):
        begin, end = float(result.time_s[piece.start]), float(result.time_s[piece.stop - 1])
        sure = float(columns["probability"][k])
        cells = (f"{begin:.1f}", str(columns["clip"][k]), str(int(columns["frames"][k])))
        lane = _lanes(columns["assigned_lane"][k : k + 1])
        places.append(Place(begin, end, (*cells, lane, f"{sure:.3f}")))
    return ["time, s", "clip", "frames", "lane at its end", "probability"], places

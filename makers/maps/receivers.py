"""What the positions of four real receivers add to lines, on one trip near Rotterdam.

The lane changes, the numbers of lanes and the positions are as they were; the lines are frames of
the paper's recordings, laid on these lane changes (`makers.benchmark.tracks`). The map does
not say where the way's line lies across the road. `told` puts it, stretch by stretch, where the
receivers have it in the median, to half a lane, as a map with placement would; `not told` takes it
for the middle, as the package does.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

import egolane_pgm as ego
from egolane_pgm.experiment import Gnss, load_experiment
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.maps.lanes_from_gnss import across
from egolane_pgm.maps.locating import locate
from egolane_pgm.maps.on_map import with_positions
from egolane_pgm.maps.road_table import RoadTable
from egolane_pgm.model import make_evidence, prepare_model
from egolane_pgm.types import BoolArray, FloatArray, LaneTruth, LineLog
from makers.benchmark.tracks import DONORS, Change, donor, driven, stretches_of
from makers.benchmark.transplanting import RATE, transplanted
from makers.maps._drives import data
from tests.kits.lane_maps import without_lines
from tests.kits.tracks import ROTTERDAM, rotterdam_receivers, rotterdam_road

#: Each stretch is driven so often, with other donors.
N_DRIVES = 3

#: Seconds without lines, the first time after so many, then every so many.
OUTAGE_S, FIRST_S, EVERY_S = 30.0, 20.0, 35.0

#: A lane of the annotated road, metres.
LANE_M = 3.5

CASES = ("all lines", "the two lines of its own lane only", "30 s without lines")

#: Right frames, -log P(true lane), frames that are sure, and those of them that are right.
Scores = FloatArray


@dataclass(frozen=True)
class Stretch:
    """A stretch of the trip on one number of lanes; the way's line is `line` lanes from the left
    edge, as far as the receivers tell."""

    begin_s: float
    end_s: float
    n_lanes: int
    changes: list[Change]
    line: float


def measure() -> Iterator[str]:
    """Lines of a table: lines alone and both, and their difference by resampling the stretches."""
    graph, index = rotterdam_road(data())
    tables = [locate(graph, index, drove) for drove in rotterdam_receivers(data()).values()]
    annotations = data() / ROTTERDAM / "lane change annotations with sections trip 1.csv"
    stretches = [Stretch(*found, _line(tables, *found)) for found in stretches_of(annotations)]
    columns = "lines alone | both | difference | log loss | difference | sure | of these right"
    yield f"| lines | the way's line | {columns} |"
    yield "|---|---|---:|---:|---:|---:|---:|---:|---:|"
    for case in CASES:
        alone, both = {}, {}
        for k, stretch in enumerate(stretches):
            for seed in range(N_DRIVES):
                for start, scored in enumerate(_scored(stretch, case)):
                    key = (k, seed, start)
                    alone[key], both[key] = _scores(stretch, k + 3 * seed, case, scored, tables)
        if not alone:
            continue
        for told, name in enumerate(("not told", "told")):
            yield f"| {case} | {name} | {_row(alone, both, told)} |"


def _line(
    tables: Sequence[RoadTable], begin: float, end: float, n: int, changes: list[Change]
) -> float:
    offs = []
    for table in tables:
        t = table.t_s
        lane = np.full(len(t), float(changes[0][1]))
        for when, _, after in changes:
            lane[t > when] = after
        here = (t > begin) & (t < end)
        for when, *_ in changes:
            here &= np.abs(t - when) > 3
        offs.append(np.nanmedian(lane[here] - 0.5 - table.offset_m[here] / LANE_M))
    return float(np.clip(np.round(2 * np.nanmedian(offs)) / 2, 0, n))


def _scored(stretch: Stretch, case: str) -> list[BoolArray]:
    """The frames that are scored, (T,); once for each time that the lines are missing."""
    time_s = np.arange(round(RATE * (stretch.end_s - stretch.begin_s))) / RATE
    if case != CASES[2]:
        return [np.ones(len(time_s), dtype=bool)]
    starts = np.arange(FIRST_S, time_s[-1] - OUTAGE_S, EVERY_S)
    return [(time_s >= start) & (time_s < start + OUTAGE_S) for start in starts]


def _scores(
    stretch: Stretch, number: int, case: str, scored: BoolArray, tables: Sequence[RoadTable]
) -> tuple[Scores, Scores]:
    """The scores of the lines alone (5,), frames last, and of both (2, R, 5): the line not told and
    told, for R receivers."""
    rng = np.random.default_rng([number, int(stretch.begin_s)])
    changes = [(when - stretch.begin_s, a, b) for when, a, b in stretch.changes]
    path = driven(changes, len(scored), stretch.n_lanes, rng)
    log, truth = transplanted(donor(1 + number % len(DONORS)), path, rng), path.truth()
    if case == CASES[1]:
        log = _own_lines(log)
    if case == CASES[2]:
        log = without_lines(log, scored)
    place = ego.experiments_folder() / "zero_label.yaml"
    model = prepare_model(load_experiment(place, {"n_lanes": stretch.n_lanes}))
    lines = make_evidence(model, log).filtered
    lanes, gnss = np.full(len(log), stretch.n_lanes), Gnss()
    both = []
    for line in (np.nan, stretch.line):
        for table in tables:
            whole = np.ones(len(table))
            told = replace(
                table,
                t_s=table.t_s - stretch.begin_s,
                way_line=whole * line,
                n_lanes=np.full(len(table), stretch.n_lanes),
            )
            seen = across(told, log.time_s, lanes, gnss.lane_width_m)
            given = with_positions(model.compiled, log, lines, seen, gnss)
            belief = filter_beliefs(model.compiled, given).lane
            both.append(_score(belief, truth, scored))
    alone = _score(filter_beliefs(model.compiled, lines).lane, truth, scored)
    return alone, np.reshape(both, (2, len(tables), -1))


def _own_lines(log: LineLog) -> LineLog:
    """The log with the nearest valid line on either side only."""
    kept = np.zeros_like(log.is_valid)
    for side in (-1, 1):
        away = np.where(log.is_valid & (side * log.offset_m > 0), np.abs(log.offset_m), np.inf)
        nearest = away.argmin(axis=1)
        rows = np.flatnonzero(np.isfinite(away.min(axis=1)))
        kept[rows, nearest[rows]] = True
    return replace(log, offset_m=np.where(kept, log.offset_m, np.nan), is_valid=kept)


def _score(belief: FloatArray, truth: LaneTruth, scored: BoolArray) -> Scores:
    rows = np.flatnonzero(scored & ~truth.is_crossing)
    belief, lane = belief[rows], truth.lane[rows] - 1
    right, is_sure = belief.argmax(axis=1) == lane, belief.max(axis=1) > 0.95
    loss = -np.log(np.maximum(belief[np.arange(len(rows)), lane], 1e-6))
    sums = right.sum(), loss.sum(), is_sure.sum(), (right & is_sure).sum(), len(rows)
    return np.array(sums, dtype=np.float64)


def _row(
    alone: dict[tuple[int, int, int], Scores], both: dict[tuple[int, int, int], Scores], told: int
) -> str:
    used = sorted({k for k, *_ in alone})
    sums = np.zeros((len(used), 2, 5))
    for key, scores in alone.items():
        receivers = both[key][told]
        sums[used.index(key[0])] += [scores * len(receivers), receivers.sum(axis=0)]
    drawn = np.random.default_rng(0).integers(0, len(used), (2000, len(used)))
    again = sums[drawn].sum(axis=1)
    total = sums.sum(axis=0)

    def less(what: int) -> str:
        spread = (again[:, 1, what] - again[:, 0, what]) / again[:, 0, 4]
        mean = (total[1, what] - total[0, what]) / total[0, 4]
        low, high = np.quantile(spread, [0.025, 0.975])
        return f"{mean:+.3f} ({low:+.3f} to {high:+.3f})".replace("0.", ".")

    share = total / total[:, 4:]
    cells = [f"{share[0, 0]:.3f}", f"{share[1, 0]:.3f}", less(0), f"{share[1, 1]:.3f}", less(1)]
    sure = [f"{share[0, 2]:.2f}, {share[1, 2]:.2f}"]
    right = total[:, 3] / np.maximum(total[:, 2], 1)
    return " | ".join([*cells, *sure, f"{right[0]:.3f}, {right[1]:.3f}"]).replace("0.", ".")

"""What it costs that the road is found from positions: lanes on simulated drives over real maps."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from egolane_pgm.experiment import Gnss
from egolane_pgm.maps.index import index_of
from egolane_pgm.maps.interchange import InterchangeDrive, Journey, simulate_interchange
from egolane_pgm.maps.locating import locate
from egolane_pgm.maps.positions import Positions
from egolane_pgm.maps.road_table import RoadTable
from egolane_pgm.types import BoolArray, FloatArray
from makers.maps._drives import lane_belief, real_maps, share, text

#: Drives over each map, and over each mirror image.
N_DRIVES = 10

#: Seconds behind a change of lanes that are scored apart.
BEHIND_S = 10.0

#: What is behind a change, in parts.
SECONDS = (0.0, 1.0, 2.0, 10.0)

TABLES = ("true", "offline", "online")


def measure() -> Iterator[str]:
    """Lines of a table, and how far apart the rows are."""
    right: dict[tuple[str, str, str], list[int]] = {}
    frames: dict[str, list[int]] = {"behind": [], "elsewhere": []}
    rows_right: dict[str, list[int]] = {name: [] for name in TABLES}
    rows: list[int] = []
    by_second = np.zeros((len(SECONDS) - 1, 2))
    for graph in real_maps().values():
        index = index_of(graph)
        for seed in range(N_DRIVES):
            drive = simulate_interchange(seed + 500, graph, Journey(n_frames=3000))
            seen = Positions.make(drive.road.t_s, *drive.position.T)
            found = {
                "true": drive.road,
                "offline": locate(graph, index, seen),
                "online": locate(graph, index, seen, online=True),
            }
            since_s = _since_change(drive)
            behind = since_s < BEHIND_S
            for name, table in found.items():
                hits = _right(drive, table)
                if name == "true":
                    for k, (low, high) in enumerate(pairwise(SECONDS)):
                        here = (since_s >= low) & (since_s < high) & ~drive.truth.is_crossing
                        by_second[k] += [(hits["lines"] & here).sum(), here.sum()]
                for place, here in (("behind", behind), ("elsewhere", ~behind)):
                    counted = here & ~drive.truth.is_crossing
                    if name == "true":
                        frames[place].append(int(counted.sum()))
                    for lines, hit in hits.items():
                        right.setdefault((name, lines, place), []).append(
                            int((hit & counted).sum())
                        )
                rows_right[name].append(_rows_right(drive.road, table))
            rows.append(len(drive.road))
    yield "| road table | rows right | | behind a change | elsewhere |"
    yield "|---|---:|---|---:|---:|"
    for name in TABLES:
        for lines in ("lines", "lines and positions"):
            cells = [text(share(right[name, lines, p], frames[p])) for p in frames]
            of_rows = text(share(rows_right[name], rows)) if lines == "lines" else ""
            yield f"| {name} | {of_rows} | {lines} | {' | '.join(cells)} |"
    yield ""
    total = np.array(frames["behind"]) + np.array(frames["elsewhere"])
    yield f"{len(rows)} drives, {total.sum()} frames, {sum(frames['behind'])} behind a change."
    said = [
        f"{a:.0f} to {b:.0f} s {r / n:.3f}"
        for (a, b), (r, n) in zip(pairwise(SECONDS), by_second, strict=True)
    ]
    yield f"Seconds behind a change (true table, lines): {', '.join(said)}."
    for name in TABLES[1:]:
        for lines in ("lines", "lines and positions"):
            lost = [
                sum(right["true", lines, p][k] - right[name, lines, p][k] for p in frames)
                for k in range(len(rows))
            ]
            low_high = share(lost, list(total))
            said = "{:.2f} ({:.2f} to {:.2f})".format(*(100 * v for v in low_high))
            yield f"{name}, {lines}: {said} points fewer than with the true table."


def _right(drive: InterchangeDrive, table: RoadTable) -> dict[str, BoolArray]:
    """Whether the most probable lane is right (T,), with lines and with positions too."""
    none = np.zeros(len(drive), dtype=bool)
    beliefs, _ = lane_belief(drive, table, none, [None, Gnss()])
    hits = [belief.argmax(axis=1) + 1 == drive.truth.lane for belief in beliefs]
    return {"lines": hits[0], "lines and positions": hits[1]}


def _since_change(drive: InterchangeDrive) -> FloatArray:
    """Seconds since the lanes of the map last changed (T,), infinite before that."""
    changes = np.flatnonzero(np.diff(drive.on_map)) + 1
    frame = np.arange(len(drive))
    last = np.searchsorted(changes, frame, side="right") - 1
    time_s = drive.log.time_s
    return np.array(
        [time_s[t] - time_s[changes[k]] if k >= 0 else np.inf for t, k in enumerate(last)]
    )


def _rows_right(true: RoadTable, found: RoadTable) -> int:
    """How many rows of the true table have their segment in the one that was found."""
    row = np.searchsorted(found.t_s, true.t_s)
    return int((found.segment[np.minimum(row, len(found) - 1)] == true.segment).sum())

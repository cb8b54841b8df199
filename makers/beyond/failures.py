"""Where and why position in lane fails on the multi-lane detector's Italian recording (run 5).

Where the lines really are is known from the simple detectors on the same drive (runs 1 to 4): the
median of their smoothed places. An oracle sets one thing right with that knowledge; what the
accuracy then is says what the thing costs.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from egolane_pgm.inference.smoothing import infer_beliefs
from egolane_pgm.model import Model, make_evidence
from egolane_pgm.parameters import number
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.types import BoolArray, Evidence, FloatArray, IntArray, LineLog
from egolane_pgm.views.answers import (
    DETECTOR_COLOUR,
    FAINT,
    INK,
    MODEL_COLOUR,
    PROBABILITY_COLOURS,
)
from egolane_pgm.views.style import new_figure, write_figure
from makers.beyond.strangers import zero_label
from tests.kits.strangers import (
    FRAME_RATE,
    Drive,
    paper_drive,
    scaled,
    shifted,
    with_lines,
    without,
)

RUN, SISTERS = 5, (1, 2, 3, 4)

#: A line is on the lattice of the road if it is nearer than this to a place of it, lanes.
NEAR = 0.3

#: Wrong frames with fewer right ones between them are one stretch.
JOINED = 15

#: Evidence as it would be if something else were known.
Told = Callable[[Drive, Evidence], Evidence]

#: The stretches that are drawn, first and last frame.
DRAWN = {"failures_run5.png": (1860, 2480), "failures_run5_start.png": (239, 860)}


@functools.cache
def multi_lane_drive() -> Drive:
    """Run 5, with the place of the vehicle as runs 1 to 4 have it."""
    drive = paper_drive(RUN)
    frame_id = drive.log.frame_id
    sisters = [paper_drive(run) for run in SISTERS]
    places = [np.interp(frame_id, other.log.frame_id, other.position) for other in sisters]
    return replace(drive, position=np.median(places, axis=0))


def on_road(drive: Drive) -> tuple[FloatArray, IntArray, BoolArray]:
    """Where each line is on the road, (T, L) lanes from the left edge (NaN: no valid line); the
    nearest line of the road; and whether it is that one."""
    log = drive.log
    offset = np.where(log.is_valid & (log.offset_m != 0), log.offset_m, np.nan)
    place = offset / drive.width_m + drive.position[:, None]
    line = np.clip(np.nan_to_num(np.round(place)), 0, drive.n_lanes).astype(np.int64)
    with np.errstate(invalid="ignore"):
        return place, line, np.abs(place - line) < NEAR


def believed(drive: Drive, told: Told | None = None) -> dict[str, FloatArray]:
    """The belief over lanes, (T, n), from the frames so far and smoothed, each as its own defaults
    read the lines; `told` may change the evidence."""
    found = {}
    for name, filter in (("causal", "exact"), ("smoothed", "smoothed")):
        evidence = evidence_of(drive, filter)
        evidence = told(drive, evidence) if told else evidence
        found[name] = infer_beliefs(_model(drive, filter).compiled, evidence, filter).lane
    return found


def evidence_of(drive: Drive, filter: str = "exact") -> Evidence:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return make_evidence(_model(drive, filter), drive.log).filtered


def _model(drive: Drive, filter: str) -> Model:
    looks_back = ("filter=smoothed", "parameters.lane_width_m=auto")
    return zero_label(drive.n_lanes, looks_back if filter == "smoothed" else ())


# Where --------------------------------------------------------------------------------------------


def stretches(drive: Drive, lane: IntArray) -> list[tuple[int, int, int]]:
    """Stretches of wrong frames: first and last frame (indices), number of wrong ones."""
    wrong = np.flatnonzero((lane != drive.lane) & (drive.lane > 0))
    parts = np.split(wrong, np.flatnonzero(np.diff(wrong) > JOINED) + 1)
    return [(int(p[0]), int(p[-1]), len(p)) for p in parts if len(p)]


def _table_of_stretches(drive: Drive) -> Iterator[str]:
    evidence = evidence_of(drive)
    beliefs = infer_beliefs(zero_label(drive.n_lanes).compiled, evidence, "exact")
    lane, is_ok = assigned_lane(beliefs.lane), beliefs.marginals["SensorState"][:, 0]
    found = stretches(drive, lane)
    n_wrong, n_scored = sum(n for _, _, n in found), np.count_nonzero(drive.lane)
    yield f"{n_wrong} of {n_scored} frames are wrong, in {len(found)} stretches; the ten longest:"
    yield ""
    yield "| frames | wrong | true lane | believed | P(OK) | lines of the road seen | others |"
    yield "|---|---|---|---|---|---|---|"
    place, line, is_on = on_road(drive)
    for a, b, n in sorted(found, key=lambda part: -part[2])[:10]:
        frames = slice(a, b + 1)
        is_wrong = (drive.lane[frames] > 0) & (lane[frames] != drive.lane[frames])
        seen = [
            f"{k} {np.mean((is_on & (line == k))[frames].any(axis=1)):.0%}"
            for k in range(drive.n_lanes + 1)
        ]
        beside = place[frames]
        other = [
            f"{name} {np.mean(where.any(axis=1)):.0%}"
            for name, where in (
                ("left", beside < -NEAR),
                ("right", beside > drive.n_lanes + NEAR),
            )
        ]
        ids = drive.log.frame_id
        yield (
            f"| {ids[a]}-{ids[b]} | {n} | {_values(drive.lane[frames][is_wrong])} |"
            f" {_values(lane[frames][is_wrong])} | {is_ok[frames].mean():.2f} |"
            f" {', '.join(seen)} | {', '.join(other)} |"
        )


def _values(lane: IntArray) -> str:
    return ", ".join(str(k) for k in np.unique(lane))


# What each thing costs ----------------------------------------------------------------------------


def oracles(drive: Drive) -> Mapping[str, Callable[[], Drive]]:
    """The drive with one thing about its lines set right."""
    place, line, is_on = on_road(drive)
    log, width, n = drive.log, drive.width_m, drive.n_lanes
    is_left, is_right = place < -NEAR, place > n + NEAR
    is_inside = np.isfinite(place) & ~is_on & ~is_left & ~is_right
    true_m = (np.arange(n + 1) - drive.position[:, None]) * width
    is_seen = np.stack([(is_on & (line == k)).any(axis=1) for k in range(n + 1)], axis=1)
    exact = replace(
        log, offset_m=np.where(is_on, np.take_along_axis(true_m, line, axis=1), log.offset_m)
    )

    def given(lines: LineLog) -> Callable[[], Drive]:
        return lambda: replace(drive, log=lines)

    def added(wanted: BoolArray) -> Callable[[], Drive]:
        return given(with_lines(log, np.where(wanted & ~is_seen, true_m, np.nan)))

    first = np.argmax(is_seen, axis=1)[:, None]
    last = n - np.argmax(is_seen[:, ::-1], axis=1)[:, None]
    between = (np.arange(n + 1) > first) & (np.arange(n + 1) < last) & is_seen.any(axis=1)[:, None]
    own = np.clip(drive.position.astype(np.int64), 0, n - 1)[:, None]
    is_own = (np.arange(n + 1) == own) | (np.arange(n + 1) == own + 1)
    edges = np.broadcast_to((np.arange(n + 1) % n) == 0, is_seen.shape)
    return {
        "as recorded": given(log),
        "scale of each frame": lambda: replace(drive, log=scaled(log, 1 / scales(drive))),
        "every line of the road exactly on its place": given(exact),
        "no lines off the lattice, inside the road": given(without(log, is_inside)),
        "no lines beyond the edges of the road": given(without(log, is_left | is_right)),
        "... left of it": given(without(log, is_left)),
        "... right of it": given(without(log, is_right)),
        "no line but those of the road, on their places": given(
            without(exact, is_inside | is_left | is_right)
        ),
        "missing lines between seen ones added": added(between),
        "missing lines of the own lane added": added(is_own),
        "missing edges of the road added": added(edges),
        "all missing lines added": added(np.ones_like(is_seen)),
        "missing frames filled in": lambda: gaps_filled(drive),
    }


def gaps_filled(drive: Drive) -> Drive:
    """With the frames that are missing between others: the lines before them, moved as the vehicle
    did."""
    log = drive.log
    frame_id = np.arange(log.frame_id[0], log.frame_id[-1] + 1)
    source = np.searchsorted(log.frame_id, frame_id, side="right") - 1
    position = np.interp(frame_id, log.frame_id, drive.position)
    filled = drive.take(source)
    moved_m = (drive.position[source] - position) * drive.width_m
    lines = replace(shifted(filled.log, moved_m), frame_id=frame_id, time_s=frame_id / FRAME_RATE)
    lane = np.where(np.isin(frame_id, log.frame_id), drive.lane[source], 0)
    return replace(drive, log=lines, lane=lane, position=position)


def scales(drive: Drive) -> FloatArray:
    """(T,) the scale of each frame: what fits the lines of the road best, with a shift; between
    frames with two of them, interpolated."""
    place, line, is_on = on_road(drive)
    scale = np.full(len(drive.log), np.nan)
    for t in range(len(scale)):
        true = line[t, is_on[t]] - drive.position[t]
        if len(np.unique(true)) >= 2:
            seen = place[t, is_on[t]] - drive.position[t]
            scale[t] = np.polyfit(true, seen, 1)[0]
    known = np.flatnonzero(np.isfinite(scale))
    return np.interp(np.arange(len(scale)), known, scale[known])


def _first_told(drive: Drive, evidence: Evidence) -> Evidence:
    """The evidence, with the lane told in the first frame."""
    ((key, likelihood),) = evidence.likelihoods.items()
    lane = np.arange(likelihood.shape[1]) * drive.n_lanes // likelihood.shape[1] + 1
    told = likelihood.copy()
    told[0] *= (lane == int(drive.position[0]) + 1)[:, None]
    return Evidence({key: told}, evidence.inputs)


def _failures_told(drive: Drive, evidence: Evidence) -> Evidence:
    """The evidence, with a sensor that is known to fail where its lines speak against the lane."""
    ((key, likelihood),) = evidence.likelihoods.items()
    best = likelihood[..., 0].reshape(len(likelihood), drive.n_lanes, -1).max(axis=2)
    own = np.clip(drive.position.astype(np.int64), 0, drive.n_lanes - 1)
    is_against = best[np.arange(len(best)), own] < best.max(axis=1)
    told = likelihood.copy()
    told[is_against, :, 0] = 0.0
    return Evidence({key: told}, evidence.inputs)


def _table_of_oracles(drive: Drive) -> Iterator[str]:
    yield "| set right | from the frames so far | smoothed |"
    yield "|---|---|---|"
    changed = {name: made() for name, made in oracles(drive).items()}
    for name, with_it in changed.items():
        yield _row(name, with_it)
    yield _row("lane told in the first frame", drive, _first_told)
    yield _row("sensor known to fail where it does", drive, _failures_told)
    inside = changed["no lines beyond the edges of the road"]
    yield _row("no lines beyond the edges, lane told in the first frame", inside, _first_told)


def _row(name: str, drive: Drive, told: Told | None = None) -> str:
    found = believed(drive, told).values()
    is_scored = drive.lane > 0
    cells = [f"{np.mean((assigned_lane(b) == drive.lane)[is_scored]):.3f}" for b in found]
    return f"| {name} | {' | '.join(cells)} |"


# What the lines are like --------------------------------------------------------------------------


def _table_of_rates(drives: Mapping[int, Drive]) -> Iterator[str]:
    yield "| run | true lane | lines of the road, from the left | beyond left | beyond right |"
    yield "|---|---|---|---|---|"
    for run, drive in drives.items():
        place, line, is_on = on_road(drive)
        for lane in range(1, drive.n_lanes + 1):
            frames = drive.lane == lane
            seen = [(is_on & (line == k))[frames].any(axis=1) for k in range(drive.n_lanes + 1)]
            beside = [place[frames] < -NEAR, place[frames] > drive.n_lanes + NEAR]
            shares = [f"{s.mean():.2f}" for s in seen]
            others = [f"{b.any(axis=1).mean():.2f}" for b in beside]
            yield f"| {run} | {lane} | {' '.join(shares)} | {' | '.join(others)} |"


def weights(drive: Drive) -> tuple[float, list[tuple[float, float, float, float]]]:
    """How much the lines say about the lane, and for how long they say the same.

    The share of frames in which the true lane is likeliest; then, against the left and the right
    neighbour, mean and standard deviation of the log likelihood ratio at the true place in the lane
    (which is known within two cells), its correlation time in frames, and the weight with which it
    would be a log odds: 2 mean / (variance * correlation time).
    """
    parameters = zero_label(drive.n_lanes).parameters
    (likelihood,) = evidence_of(drive).likelihoods.values()
    alpha, beta = (number(parameters, name) for name in ("alpha", "beta"))
    n_frames, n = len(likelihood), drive.n_lanes
    # The log likelihood of the lines, up to a constant in each frame (see `line_geometry.rule`).
    working, failing = np.log(likelihood[..., 0]), np.log(likelihood[..., 1])
    log_lines = ((working - failing) / alpha + failing / beta).reshape(n_frames, n, -1)
    cells = log_lines.shape[2]
    lane = np.clip(drive.position.astype(np.int64), 0, n - 1)
    cell = np.clip(((drive.position - lane) * cells).astype(np.int64), 0, cells - 1)
    near = np.clip(cell[:, None] + np.arange(-2, 3), 0, cells - 1)
    best = log_lines[np.arange(n_frames)[:, None], :, near].max(axis=1)
    own = best[np.arange(n_frames), lane]
    found = []
    for side in (-1, 1):
        other = lane + side
        against = best[np.arange(n_frames), np.clip(other, 0, n - 1)]
        found.append(_calibrated(np.where((other >= 0) & (other < n), own - against, np.nan)))
    return float(np.mean(best.argmax(axis=1) == lane)), found


def _calibrated(ratio: FloatArray) -> tuple[float, float, float, float]:
    mean, variance = float(np.nanmean(ratio)), float(np.nanvar(ratio))
    away = ratio - mean
    total = 1.0
    for lag in range(1, 300):
        correlation = float(np.nanmean(away[lag:] * away[:-lag])) / variance
        if correlation < 0.05:
            break
        total += 2 * correlation
    return mean, variance**0.5, total, 2 * mean / (variance * total)


def _table_of_weights(drives: Mapping[int, Drive]) -> Iterator[str]:
    yield "| run | true lane likeliest | mean | deviation | correlated for | weight |"
    yield "|---|---|---|---|---|---|"
    for run, drive in drives.items():
        share, ((m1, s1, t1, w1), (m2, s2, t2, w2)) = weights(drive)
        yield (
            f"| {run} | {share:.2f} | {m1:.2f}, {m2:.2f} | {s1:.1f}, {s2:.1f} |"
            f" {t1 / 10:.0f} s, {t2 / 10:.0f} s | {w1:.3f}, {w2:.3f} |"
        )


def measure(runs: Sequence[int], only: str, overrides: Sequence[str]) -> Iterator[str]:
    """All tables, a line at a time."""
    drive = multi_lane_drive()
    drives = {run: drive if run == RUN else paper_drive(run) for run in runs}
    tables = {
        "Where": _table_of_stretches(drive),
        "What each thing costs": _table_of_oracles(drive),
        "How often each line is reported": _table_of_rates(drives),
        "What the lines say about the lane": _table_of_weights(drives),
    }
    for title, lines in tables.items():
        yield f"## {title}"
        yield ""
        yield from lines
        yield ""


# Pictures -----------------------------------------------------------------------------------------


def draw(folder: Path) -> None:
    """Draws the stretches of DRAWN."""
    drive = multi_lane_drive()
    beliefs = believed(drive)
    for name, (first, last) in DRAWN.items():
        write_figure(functools.partial(_figure, drive, beliefs, first, last), folder / name)


def _figure(drive: Drive, beliefs: Mapping[str, FloatArray], first: int, last: int) -> Figure:
    """Above the lines on the road, below the belief over lanes; time runs to the right."""
    frames = np.flatnonzero((drive.log.frame_id >= first) & (drive.log.frame_id <= last))
    ids = drive.log.frame_id[frames]
    figure = new_figure(9.0, 6.2)
    upper, *lower = figure.subplots(
        1 + len(beliefs), 1, sharex=True, gridspec_kw={"height_ratios": [3] + [1] * len(beliefs)}
    )
    figure.subplots_adjust(left=0.13, right=0.98, top=0.9, bottom=0.09, hspace=0.12)
    _draw_lines(upper, drive, frames, ids)
    for ax, (name, belief) in zip(lower, beliefs.items(), strict=True):
        _draw_belief(ax, drive, belief[frames], ids, frames)
        ax.set_ylabel(f"lane,\n{name}")
    lower[-1].set_xlabel("frame (ten a second)")
    figure.suptitle(
        f"Run {RUN}: lines on the road, where the vehicle truly is, and the belief over its lane",
        fontsize=10,
    )
    return figure


def _draw_lines(ax: Axes, drive: Drive, frames: IntArray, ids: IntArray) -> None:
    place, _, is_on = on_road(drive)
    n = drive.n_lanes
    for k in range(n + 1):
        ax.axhline(k, color=FAINT, linewidth=1.6 if k in (0, n) else 0.8, zorder=0)
    ax.plot(ids, drive.position[frames], color=INK, linewidth=1.5, label="vehicle")
    beyond = (place < -NEAR) | (place > n + NEAR)
    for mask, colour, label in (
        (is_on, MODEL_COLOUR, "line of the road"),
        (~is_on & ~beyond, FAINT, "off the lattice"),
        (beyond, DETECTOR_COLOUR, "beyond the road"),
    ):
        row, column = np.nonzero(mask[frames] & np.isfinite(place[frames]))
        ax.plot(
            ids[row],
            place[frames][row, column],
            linestyle="none",
            marker=".",
            markersize=2.5,
            color=colour,
            label=label,
        )
    ax.set_ylim(n + 2.2, -3.2)
    ax.set_yticks(range(n + 1), ["left edge", *map(str, range(1, n)), "right edge"])
    ax.set_ylabel("lanes from the left edge")
    ax.legend(loc="upper right", ncols=4, fontsize=7, markerscale=3, framealpha=0.9)


def _draw_belief(
    ax: Axes, drive: Drive, belief: FloatArray, ids: IntArray, frames: IntArray
) -> None:
    ramp = LinearSegmentedColormap.from_list("probability", list(PROBABILITY_COLOURS))
    edges = np.append(ids, ids[-1] + 1) - 0.5
    ax.pcolormesh(edges, np.arange(drive.n_lanes + 1) + 0.5, belief.T, cmap=ramp, vmin=0, vmax=1)
    lane = np.where(drive.lane[frames] > 0, drive.lane[frames].astype(float), np.nan)
    ax.plot(ids, lane, color=DETECTOR_COLOUR, linewidth=1.5)
    ax.set_ylim(drive.n_lanes + 0.5, 0.5)
    ax.set_yticks(range(1, drive.n_lanes + 1))

"""A graph with the car's position inside the lane.

RoadPosition is the car's position across the road, in cells; it persists from frame to frame, as
SensorState does. Lane is a function of RoadPosition. In a lane change RoadPosition drifts across a
line. The input LineMotion, the median displacement of the lines since the previous frame, measures
this drift. The evidence (`evidence.line_geometry`) is a joint likelihood of RoadPosition and
SensorState. An OK sensor is evidence of the lane and the position in it, a BAD one of the position
in the lane only.

Time passes in ticks of a tenth of a second, whatever the frame rate.

The first cell of RoadPosition is the leftmost one of lane 1. SensorState has the values OK (0) and
BAD (1). LineMotion has values for

- the displacement of the lines over a tick: `motion_bins` intervals from -MOTION_RANGE to
  MOTION_RANGE, in lane widths;
- the same over two ticks or more;
- a frame in which no tick begins;
- ticks without a displacement: one for each entry of `SHOWN`, `TICKS` and `COASTING`. A car that
  loses its lines in a lane change so completes the change.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from egolane_pgm.graphs.cpds import (
    Table,
    binary,
    dynamics,
    normal_cdf,
    previous,
    prior,
    uniform,
    within,
)
from egolane_pgm.graphs.sensor_failure import P1, P2
from egolane_pgm.parameters import Parameter, Parameters, Value, number
from egolane_pgm.tools.jit import kernel
from egolane_pgm.types import BoolArray, FloatArray, IntArray

HIDDEN = ("RoadPosition", "Lane", "SensorState")
OBSERVED = (("RoadPosition", "SensorState"),)
INPUTS = ("LineMotion",)
VALUES = {"SensorState": ("OK", "BAD")}

#: Numbers of ticks without a displacement. A number counts as the nearest one, by its logarithm.
TICKS = (1, 2, 4, 8, 16, 32, 128)

#: How the lines moved before, lane widths per tick. A quick lane change is 0.06.
COASTING = tuple(0.06 * k / 8 for k in range(-8, 9))

#: The share of that velocity which is left after a tick without a displacement.
KEPT_VELOCITY = 0.99

#: The weight of the wide normal in a tick without a displacement, by what the sensor shows: the
#: lines of its own lane only, or others as well. The second kind loses its lines in other ways.
SHOWN = {"own": 0.03, "all": 0.3}

#: Motion in a tick without a displacement: the gain near the middle of the lane and near its lines,
#: the distances from the middle where the one ends and the other begins, lane widths, and the
#: standard deviation. A car in the middle of its lane stays there, one on its way across goes on.
_UNSEEN_GAIN = (0.4, 2.0)
_UNSEEN_PLACE = (0.15, 0.35)
_UNSEEN = {"motion_sigma": 0.03}

#: The geometry of the cells and of LineMotion. The evidence rule declares these parameters too.
CELLS = Parameter(
    "cells", "integer", 16, "cells of RoadPosition in each lane", lowest=1, highest=100
)
MOTION_BINS = Parameter(
    "motion_bins",
    "integer",
    49,
    "values of LineMotion for known displacements",
    lowest=1,
    highest=1000,
)

#: The largest displacement of a line that is followed, lane widths.
MOTION_RANGE = 0.2

PARAMETERS = (
    CELLS,
    MOTION_BINS,
    Parameter(
        "motion_gain",
        "non_negative",
        0.9,
        "share of the lines' displacement by which RoadPosition moves, the other way",
        search=None,
    ),
    Parameter(
        "motion_sigma",
        "sigma",
        0.04,
        "standard deviation of the motion in a tenth of a second, lane widths",
        search=(0.005, 0.1),
    ),
    Parameter(
        "motion_sigma_wide",
        "sigma",
        0.12,
        "the same for the share of time in which the displacement misleads, lane widths",
        search=(0.05, 0.3),
    ),
    Parameter("wide_share", "probability", 0.03, "weight of the wide normal", search=(0.01, 0.3)),
    Parameter(
        "edges",
        "choice",
        "contradicted",
        "moves off the road: `contradicted` ends them where the lines say otherwise, so that no"
        " frame is evidence of an outer lane; `left_out` excludes them, so that the lane changes of"
        " a whole drive tell the lanes",
        search=None,
        choices=("contradicted", "left_out"),
        smoothed="left_out",
    ),
    replace(P1, default=0.98),
    replace(P2, default=0.85),
)

#: The probability of a jump to anywhere on the road in a tick.
_JUMP = 1e-5

#: The largest move of RoadPosition in one tick, lanes.
_BAND = 0.5

#: How far inside of its start a move ends that would leave the road, lanes. There the lines
#: contradict it, as they contradict a move across a line inside the road. If it lost less, every
#: frame without a lane change would be evidence of the outer lanes.
_BACK = 2 / 3

#: The largest standard deviation that is used, in cells. A wider normal is as flat over the band,
#: and its differences would lose digits.
_WIDEST = 100.0


def motion_values(parameters: Mapping[str, Value]) -> int:
    """The number of values of LineMotion."""
    n_bins = int(number(parameters, "motion_bins"))
    return 2 * n_bins + 1 + len(SHOWN) * len(TICKS) * len(COASTING)


def motion_index(
    displacement: FloatArray,
    ticks: IntArray,
    velocity: FloatArray,
    shows_own: BoolArray,
    parameters: Mapping[str, Value],
) -> IntArray:
    """The value of LineMotion in each frame, (T,).

    - displacement: (T,) of the lines over the ticks that begin with the frame, lane widths; NaN
      where unknown. One that is out of range counts as unknown.
    - ticks: (T,)
    - velocity: (T,) of the lines before, lane widths per tick
    - shows_own: (T,) whether the sensor shows the lines of its own lane only
    """
    n_bins = int(number(parameters, "motion_bins"))
    index = np.empty(len(ticks), dtype=np.int64)
    _index_motion(displacement, ticks, velocity, shows_own, n_bins, index)
    return index


@kernel()
def _index_motion(
    displacement: FloatArray,
    ticks: IntArray,
    velocity: FloatArray,
    shows_own: BoolArray,
    n_bins: int,
    index: IntArray,
) -> None:
    """Fills index (T,); see `motion_index`."""
    middle = len(COASTING) // 2
    for t in range(len(index)):
        if ticks[t] == 0:
            index[t] = 2 * n_bins
        elif abs(displacement[t]) < MOTION_RANGE:
            share = (displacement[t] / MOTION_RANGE + 1) / 2
            index[t] = min(int(share * n_bins), n_bins - 1) + (n_bins if ticks[t] > 1 else 0)
        else:
            k = len(TICKS) - 1
            while k > 0 and ticks[t] ** 2 < TICKS[k] * TICKS[k - 1]:
                k -= 1
            # The lines go as far as in the true time.
            way = velocity[t] * (1 - KEPT_VELOCITY ** ticks[t]) / (1 - KEPT_VELOCITY ** TICKS[k])
            coasting = int(np.rint(min(max(way / COASTING[-1], -1.0), 1.0) * middle)) + middle
            k += 0 if shows_own[t] else len(TICKS)
            index[t] = 2 * n_bins + 1 + k * len(COASTING) + coasting


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """RoadPosition moves with LineMotion, SensorState persists, and Lane is the cell's lane."""
    cells = int(number(parameters, "cells"))
    n_positions = n_lanes * cells
    n_values = motion_values(parameters)
    sensor = binary(number(parameters, "p1"), number(parameters, "p2"))
    lane = np.repeat(np.eye(n_lanes), cells, axis=0)
    motion = uniform(n_values)
    return [
        *prior("LineMotion", motion),
        *dynamics("LineMotion", [], motion),
        *prior("RoadPosition", uniform(n_values, n_positions), ["LineMotion"]),
        *prior("SensorState", uniform(n_values, 2), ["LineMotion"]),
        *dynamics(
            "RoadPosition",
            [previous("RoadPosition"), "LineMotion"],
            np.stack(motions(n_positions, cells, parameters), axis=1),
        ),
        *dynamics(
            "SensorState",
            [previous("SensorState"), "LineMotion"],
            np.stack(sensors(sensor, parameters), axis=1),
        ),
        *within("Lane", ["RoadPosition"], lane),
    ]


def motions(n_positions: int, cells: int, parameters: Mapping[str, Value]) -> list[FloatArray]:
    """The transition of RoadPosition, (R, R), for each value of LineMotion."""
    transition = partial(moved, n_positions=n_positions, cells=cells)
    twice = {**parameters, "motion_sigma": math.sqrt(2) * number(parameters, "motion_sigma")}
    displacements = known_displacements(parameters)
    found = [
        transition(each, parameters=at) for at in (parameters, twice) for each in displacements
    ]
    found.append(np.eye(n_positions))
    place = np.abs((np.arange(cells) + 0.5) / cells - 0.5)
    on_way = np.tile(np.interp(place, _UNSEEN_PLACE, (0, 1)), n_positions // cells)[:, None]
    stays, goes_on = ({**parameters, **_UNSEEN, "motion_gain": gain} for gain in _UNSEEN_GAIN)
    for share in SHOWN.values():
        shown = {"wide_share": share}
        unseen = [
            (1 - on_way) * transition(velocity, parameters=stays | shown)
            + on_way * transition(velocity, parameters=goes_on | shown)
            for velocity in COASTING
        ]
        by_velocity = [_coasted(unseen, velocity) for velocity in COASTING]
        found += [over[k] for k in range(len(TICKS)) for over in by_velocity]
    return found


def sensors(sensor: FloatArray, parameters: Mapping[str, Value]) -> list[FloatArray]:
    """The transition of SensorState for each value of LineMotion; sensor (2, 2): in a tick."""
    n_bins = int(number(parameters, "motion_bins"))
    unseen = [_power(sensor, k) for _ in SHOWN for k in TICKS for _ in COASTING]
    return [sensor] * n_bins + [_power(sensor, 2)] * n_bins + [np.eye(2)] + unseen


def known_displacements(parameters: Mapping[str, Value]) -> FloatArray:
    """Return the displacement of each of the first values of LineMotion, lane widths."""
    n_bins = int(number(parameters, "motion_bins"))
    return ((np.arange(n_bins) + 0.5) / n_bins * 2 - 1) * MOTION_RANGE


def moved(
    displacement: float, n_positions: int, cells: int, parameters: Mapping[str, Value]
) -> FloatArray:
    """Return the transition of RoadPosition, (R, R), for a `displacement`, lane widths."""
    gain = number(parameters, "motion_gain")
    narrow = number(parameters, "motion_sigma") * cells
    wide = number(parameters, "motion_sigma_wide") * cells
    half = max(1, math.ceil(_BAND * cells))
    share = number(parameters, "wide_share")
    shift = float(np.clip(-gain * displacement * cells, -half, half))
    move = (1 - share) * _cell_moves(shift, narrow, half)
    move += share * _cell_moves(shift, wide, half)
    back = round(_BACK * cells) if parameters["edges"] == "contradicted" else None
    return (1 - _JUMP) * _banded(move, n_positions, back) + _JUMP / n_positions


def _coasted(unseen: Sequence[FloatArray], velocity: float) -> list[FloatArray]:
    """The transition over each of `TICKS` without a displacement.

    - unseen: that over a tick, (R, R), for each of `COASTING`
    - velocity: of the lines before
    """
    over = np.eye(len(unseen[0]))
    passed = 0
    found = []
    for ticks in TICKS:
        left = velocity * np.mean(KEPT_VELOCITY ** np.arange(passed, ticks))
        nearest = int(np.argmin(np.abs(np.array(COASTING) - left)))
        over = over @ _power(unseen[nearest], ticks - passed)
        passed = ticks
        found.append(over / over.sum(axis=1, keepdims=True))
    return found


def _power(transition: FloatArray, steps: int) -> FloatArray:
    """The transition over several frames, normalised again after rounding."""
    power = np.linalg.matrix_power(transition, steps)
    return np.asarray(power / power.sum(axis=1, keepdims=True))


def _cell_moves(shift: float, sigma: float, half: int) -> FloatArray:
    """Probabilities of moving by -half to half cells, (2 half + 1,).

    The motion is normal around `shift` with standard deviation `sigma`, both in cells; it starts
    anywhere in a cell with equal density.
    """
    sigma = min(sigma, _WIDEST)
    # By symmetry, all differences are taken left of the mean, where small numbers keep their
    # digits.
    left = -np.abs(np.arange(-half, half + 1) - shift)
    # The second difference of the normal's second antiderivative integrates over the cell that the
    # car leaves and over the one that it enters.
    before, at, after = (_twice_integrated(left + k, sigma) for k in (-1, 0, 1))
    return np.maximum(before - 2 * at + after, 0.0)


def _twice_integrated(x: FloatArray, sigma: float) -> FloatArray:
    with np.errstate(over="ignore"):
        z = x / sigma
        density = np.exp(-0.5 * z**2) / math.sqrt(2 * math.pi)
    return np.asarray(x * normal_cdf(z) + sigma * density)


def _banded(move: FloatArray, n_positions: int, back: int | None) -> FloatArray:
    """Return the transition (R, R) of moves by -half to half cells, (2 half + 1,).

    A move that leaves the road ends `back` cells inside of its start; with None it is left out, and
    a cell from which every move leaves the road keeps its car.
    """
    half = len(move) // 2
    source = np.arange(n_positions)[:, None]
    target = source + np.arange(-half, half + 1)
    is_off = [target < 0, target >= n_positions]
    rows = np.broadcast_to(move, target.shape).copy()
    if back is None:
        rows[is_off[0] | is_off[1]] = 0.0
        rows[:, half] = np.where(rows.any(axis=1), rows[:, half], 1.0)
        back = 0
    target = np.clip(np.select(is_off, [source + back, source - back], target), 0, n_positions - 1)
    transition = np.zeros((n_positions, n_positions))
    np.add.at(transition, (source, target), rows / rows.sum(axis=1, keepdims=True))
    return transition

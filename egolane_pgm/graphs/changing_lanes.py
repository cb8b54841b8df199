"""The paper's graph on a road whose lanes begin, end, merge and split.

Lane has as many values as the road has lanes at its widest. An input, Step, says in each frame what
the map knows of the road (`lane_steps`). Lane moves in two parts: first to where its lane goes on,
then to a neighbour as in the paper's Table `tab:cptlane`, of a road with the lanes that there are
now. On a road that does not change this is the paper's table.

- Lanes is the number of lanes that there really are. The map may be wrong by one (`map_wrong`), and
  so may be a number that it does not tell and that was guessed (`guess_wrong`).
- Passed says whether a change of lanes, which the map puts at one place and which is somewhere
  around it, is behind the car.
- Evidence of Lane is what is known otherwise: that the car took a branch, which some lanes serve.
"""

from __future__ import annotations

import numpy as np

from egolane_pgm.graphs.cpds import (
    Table,
    binary,
    builder,
    dynamics,
    lane_normals,
    previous,
    prior,
    uniform,
    within,
)
from egolane_pgm.graphs.lane_steps import (
    CHANGE_AT_RIGHT,
    GUESS_WRONG,
    MAP_STAYS,
    TOLD_STEPS,
    Step,
    passing,
    read_steps,
    survivors,
)
from egolane_pgm.graphs.shared_parameters import NORMAL, P1, P2, P3, P4, SIGMA1, SIGMA2
from egolane_pgm.parameters import Parameter, Parameters, number
from egolane_pgm.types import FloatArray

HIDDEN = ("Lane", "SensorState", "Lanes", "Passed")
OBSERVED = (("DetectorOutput", "Lanes"), "WOR", "Lane")
INPUTS = ("Step",)

#: The keys that the evidence rule gives. The model makes the evidence of OBSERVED from these and
#: the map.
TAKES = ("DetectorOutput", "WOR")
VALUES = {"SensorState": ("OK", "BAD"), "WOR": ("OK", "BAD")}
PARAMETERS = (
    SIGMA1,
    SIGMA2,
    P1,
    P2,
    P3,
    P4,
    NORMAL,
    TOLD_STEPS,
    Parameter(
        "map_wrong",
        "probability",
        0.0,
        "P(the map has a lane too few or too many), both equally likely; 0 for a map that is"
        " believed, 0.1 for one that is not",
        search=None,
    ),
    GUESS_WRONG,
    MAP_STAYS,
    CHANGE_AT_RIGHT,
    Parameter(
        "place_sigma_m",
        "non_negative",
        20.0,
        "standard deviation, metres, of where along the road lanes begin and end about the map's"
        " place; 0 for a map that is exact",
        search=None,
    ),
)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """The paper's tables, with those of Lane and DetectorOutput for each number of lanes."""
    steps = read_steps(str(parameters["steps"]), n_lanes)
    p1, p2 = number(parameters, "p1"), number(parameters, "p2")
    p3, p4 = number(parameters, "p3"), number(parameters, "p4")
    first_lanes, next_lanes = _lanes(steps, n_lanes, parameters)
    first_passed, next_passed = _passed(steps)
    n_passed = first_passed.shape[1]
    # Lane in the first frame: every lane that there is.
    exists = np.tril(np.ones((n_lanes, n_lanes)))
    first_lane = exists / exists.sum(axis=1, keepdims=True)
    first_lane = np.broadcast_to(first_lane, (len(steps), n_passed, n_lanes, n_lanes))
    return [
        *prior("Step", uniform(len(steps))),
        *dynamics("Step", [], uniform(len(steps))),
        *prior("Passed", first_passed, ["Step"]),
        *dynamics("Passed", ["Step", previous("Passed")], next_passed),
        *prior("Lanes", np.repeat(first_lanes[:, None], n_passed, axis=1), ["Step", "Passed"]),
        *dynamics("Lanes", ["Step", previous("Passed"), "Passed", previous("Lanes")], next_lanes),
        *prior("Lane", first_lane, ["Step", "Passed", "Lanes"]),
        *dynamics(
            "Lane",
            ["Step", previous("Passed"), "Passed", previous("Lanes"), "Lanes", previous("Lane")],
            _lane(steps, n_lanes, parameters),
        ),
        *prior("SensorState", uniform(2)),
        *dynamics("SensorState", [previous("SensorState")], binary(p1, p2)),
        *within("WOR", ["SensorState"], binary(p3, p4)),
        *within("DetectorOutput", ["SensorState", "Lanes", "Lane"], _output(n_lanes, parameters)),
    ]


build = builder(tables, OBSERVED)


def most_lanes(on_map: int, parameters: Parameters) -> int:
    """The number of values of Lane; on_map: number of lanes on the map where the road is widest."""
    return on_map + (number(parameters, "map_wrong") > 0 or "~" in str(parameters["steps"]))


def _n_passed(steps: tuple[Step, ...]) -> int:
    """On a road without uncertain places nothing is ever passed: Passed has one value then."""
    return 1 + any(step.place is not None for step in steps)


def _happens(step: Step, before: int, now: int) -> bool:
    """Whether a step's change happens; before, now: the values of Passed."""
    return step.before > 0 and (step.place is None or (before == 0 and now == 1))


def _passed(steps: tuple[Step, ...]) -> tuple[FloatArray, FloatArray]:
    """Passed in the first frame (U, P), and later (U, P, P)."""
    n_passed = _n_passed(steps)
    first = np.zeros((len(steps), n_passed))
    later = np.zeros((len(steps), n_passed, n_passed))
    first[:, 0] = 1.0
    for u, step in enumerate(steps):
        if step.place is not None:
            here = float(passing()[step.place - 1])
            later[u] = [[1 - here, here], [0.0, 1.0]]
        elif step.before == 0:
            later[u] = np.eye(n_passed)
        else:
            later[u, :, 0] = 1.0
    return first, later


def _lanes(
    steps: tuple[Step, ...], n_lanes: int, parameters: Parameters
) -> tuple[FloatArray, FloatArray]:
    """Lanes in the first frame (U, n), and later (U, P, P, n, n)."""
    stays = number(parameters, "map_stays")
    of_map, of_guess = (
        _really(n_lanes, number(parameters, name)) for name in ("map_wrong", "guess_wrong")
    )
    first = np.stack([(of_guess if step.is_guess else of_map)[step.after] for step in steps])
    n_passed = _n_passed(steps)
    later = np.zeros((len(steps), n_passed, n_passed, n_lanes, n_lanes))
    for u, step in enumerate(steps):
        for before, now in np.ndindex(n_passed, n_passed):
            if not _happens(step, before, now):
                later[u, before, now] = np.eye(n_lanes)
            elif step.before == step.after and step.shift == 0:
                later[u, before, now] = _stays(first[u], stays)
            elif step.is_guess:
                later[u, before, now] = first[u]
            else:
                later[u, before, now] = _goes_on(step, first[u])
    return first, later


def _really(n_lanes: int, wrong: float) -> FloatArray:
    """(n + 1, n): P(number of lanes) where the map has 0 to n; wrong: P(one less or more)."""
    away = np.subtract.outer(np.arange(1, n_lanes + 1), np.arange(n_lanes + 1)).T
    table = np.where(away == 0, 1 - wrong, np.where(abs(away) == 1, wrong / 2, 0.0))
    table[0] = 1.0
    # With one lane, the only other number is 0: the map is right, whatever is said of it.
    empty = table.sum(axis=1) == 0
    table[empty] = away[empty] == 0
    return np.asarray(table / table.sum(axis=1, keepdims=True))


def _stays(on_map: FloatArray, stays: float) -> FloatArray:
    """(n, n): the number of lanes mostly stays where the map may be right about it."""
    table = np.tile(on_map, (len(on_map), 1))
    for n in np.flatnonzero(on_map):
        others = np.where(np.arange(len(on_map)) == n, 0.0, on_map)
        if others.sum() > 0:
            table[n] = (1 - stays) * others / others.sum()
            table[n, n] = stays
        else:
            table[n] = on_map
    return table


def _goes_on(step: Step, on_map: FloatArray) -> FloatArray:
    """(n, n): behind a change the map is as wrong as before it, or else, as likely, right."""
    n = len(on_map)
    table = np.zeros((n, n))
    rows = np.arange(n)
    as_before = np.clip(rows + step.after - step.before, 0, n - 1)
    # Further from the map than it may be: the map is believed.
    as_before = np.where(on_map[as_before] > 0, as_before, step.after - 1)
    np.add.at(table, (rows, as_before), 0.5)
    table[:, step.after - 1] += 0.5
    return table


def _lane(steps: tuple[Step, ...], n_lanes: int, parameters: Parameters) -> FloatArray:
    """Lane at t+1: (U, P, P, n, n, n, n), by Step, Passed before and now, Lanes before and now, and
    Lane before."""
    n_passed, right = _n_passed(steps), number(parameters, "change_at_right")
    # Table `tab:cptlane` for each number of lanes.
    sigma1 = number(parameters, "sigma1")
    moves = [_widened(n, n_lanes, sigma1, parameters) for n in range(1, n_lanes + 1)]
    table = np.empty((len(steps), n_passed, n_passed, *(n_lanes,) * 4))
    # Most entries are about the same few changes.
    known: dict[tuple[int, int, int | None], FloatArray] = {}

    def moved(before: int, after: int, shift: int | None) -> FloatArray:
        key = (before, after, shift)
        if key not in known:
            rows = survivors(before, after, shift, right) @ moves[after - 1]
            # A lane beyond the last one is the last one.
            known[key] = rows[np.minimum(np.arange(n_lanes), before - 1)]
        return known[key]

    for u, step in enumerate(steps):
        for passed, now in np.ndindex(n_passed, n_passed):
            happens = _happens(step, passed, now)
            added = step.after - step.before if happens else 0
            for before, after in np.ndindex(n_lanes, n_lanes):
                # Lanes that begin or end where the map has no change do so at an unknown side.
                is_told = after - before == added
                shift = (step.shift if happens else 0) if is_told else None
                table[u, passed, now, before, after] = moved(before + 1, after + 1, shift)
    return table


def _widened(n: int, n_lanes: int, sigma: float, parameters: Parameters) -> FloatArray:
    """F of a normal around each lane of a road of n lanes, with columns for all: (n, n_lanes)."""
    rows = lane_normals(sigma, n, str(parameters["normal"]))
    return np.pad(rows, ((0, 0), (0, n_lanes - n)))


def _output(n_lanes: int, parameters: Parameters) -> FloatArray:
    """Table `tab:cptdetlane` for each number of lanes: (2, n, n, n), by SensorState, Lanes and
    Lane."""
    table = np.empty((2, n_lanes, n_lanes, n_lanes))
    for n in range(1, n_lanes + 1):
        rows = _widened(n, n_lanes, number(parameters, "sigma2"), parameters)
        table[0, n - 1] = rows[np.minimum(np.arange(n_lanes), n - 1)]
        table[1, n - 1] = np.where(np.arange(n_lanes) < n, 1 / n, 0.0)
    return table

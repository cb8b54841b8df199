"""The position inside the lane on a road whose lanes begin, end, merge and split.

It is `position_in_lane` with RoadPosition of as many lanes as the road has at its widest. An input,
Step, says in each frame what the map knows of the road (`lane_steps`) and how the lines moved.
RoadPosition moves in two parts: first to where its lane goes on, at the same place inside it, then
with the lines, on a road with the lanes that there are now. On a road that does not change this is
`position_in_lane`.

The map is taken for right about the number of lanes that it tells and the place of a change. Where
the number is a guess, Step has values for a lane less and more too (`guess_wrong`), and the lines
beside the car say which of them a frame takes (`maps.on_map`): with the number as a hidden node
there would be three times as many states. In the frame of a change the motion of the lines is
rounded to one of COASTING, and frames that are missing before it are not counted: each value of
Step takes its own transition.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from egolane_pgm.graphs import position_in_lane as fixed
from egolane_pgm.graphs.cpds import (
    Table,
    binary,
    builder,
    dynamics,
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
    read_steps,
    survivors,
)
from egolane_pgm.graphs.position_in_lane import COASTING
from egolane_pgm.parameters import Parameters, number
from egolane_pgm.types import FloatArray, InputError, IntArray

HIDDEN = fixed.HIDDEN
OBSERVED = fixed.OBSERVED
INPUTS = ("Step",)
VALUES = fixed.VALUES
PARAMETERS = (*fixed.PARAMETERS, TOLD_STEPS, GUESS_WRONG, MAP_STAYS, CHANGE_AT_RIGHT)


def tables(n_lanes: int, parameters: Parameters) -> list[Table]:
    """The tables of `position_in_lane`, with those of RoadPosition for each value of Step."""
    steps, _ = _steps(n_lanes, parameters)
    cells = int(number(parameters, "cells"))
    sensor = binary(number(parameters, "p1"), number(parameters, "p2"))
    first: list[FloatArray] = []
    positions: list[FloatArray] = []
    sensors: list[FloatArray] = []
    on_road: dict[int, list[FloatArray]] = {}
    for step in steps:
        n = step.after
        if step.is_change:
            moves = [_carried(step, velocity, n_lanes, cells, parameters) for velocity in COASTING]
            positions += moves
            sensors += [sensor] * len(moves)
        else:
            if n not in on_road:
                road = fixed.motions(n * cells, cells, parameters)
                on_road[n] = [_widened(move, n_lanes * cells, parameters) for move in road]
            moves = on_road[n]
            positions += moves
            sensors += fixed.sensors(sensor, parameters)
        there = np.arange(n_lanes * cells) < n * cells
        first += [there / there.sum()] * len(moves)
    motion = uniform(len(positions))
    return [
        *prior("Step", motion),
        *dynamics("Step", [], motion),
        *prior("RoadPosition", np.stack(first), ["Step"]),
        *prior("SensorState", uniform(len(positions), 2), ["Step"]),
        *dynamics("RoadPosition", [previous("RoadPosition"), "Step"], np.stack(positions, axis=1)),
        *dynamics("SensorState", [previous("SensorState"), "Step"], np.stack(sensors, axis=1)),
        *within("Lane", ["RoadPosition"], np.repeat(np.eye(n_lanes), cells, axis=0)),
    ]


build = builder(tables, OBSERVED)


def most_lanes(on_map: int, parameters: Parameters) -> int:
    """The number of values of Lane; on_map: number of lanes on the map where the road is widest."""
    steps = read_steps(str(parameters["steps"]), on_map)
    return max(on_map, *(step.after + step.is_guess for step in steps))


def step_index(
    word: IntArray,
    motion: IntArray,
    n_lanes: int,
    parameters: Parameters,
    off: IntArray | None = None,
) -> IntArray:
    """The value of Step in each frame, (T,).

    - word: (T,) index of the frame's step among the words of the parameter `steps`
    - motion: (T,) the value of LineMotion, as the evidence rule gives it
    - off: (T,) -1 or 1 where there is a lane less or more than a guess, else 0; default 0
    """
    steps, which = _steps(n_lanes, parameters)
    is_change = np.array([step.is_change for step in steps])
    sizes = np.where(is_change, len(COASTING), fixed.motion_values(parameters))
    begins = np.cumsum(sizes) - sizes
    known = fixed.known_displacements(parameters)
    middle, most = len(COASTING) // 2, COASTING[-1]
    coasting = np.rint(np.clip(known / most, -1, 1) * middle).astype(np.int64) + middle
    after_gap = np.arange(fixed.motion_values(parameters) - len(known)) % len(COASTING)
    velocity = np.concatenate([coasting, after_gap])
    now = np.zeros_like(word) if off is None else off
    taken = which[word, np.concatenate([[0], now[:-1]]), now]
    return np.asarray(begins[taken] + np.where(is_change[taken], velocity[motion], motion))


def _steps(n_lanes: int, parameters: Parameters) -> tuple[tuple[Step, ...], IntArray]:
    """The steps of roads whose numbers of lanes are exact, and which of them each word of the
    parameter `steps` is: (W, 3, 3), by how many lanes more (0, 1, -1) there are before and now than
    a guess has."""
    words = read_steps(str(parameters["steps"]), n_lanes)
    guessed = {word.after for word in words if word.is_guess}
    found: dict[Step, int] = {}
    which = np.zeros((len(words), 3, 3), dtype=np.int64)
    for k, word in enumerate(words):
        if word.place is not None or not word.before:
            raise InputError(f"steps: '{word}': this graph takes the map's places for exact")
        goes_on = not word.is_change
        # A stretch begins with the number that was guessed.
        offs = (0, 1, -1) if word.before in guessed and goes_on <= word.is_guess else (0,)
        # Within it lanes begin or end at a side that nothing tells, as in `changing_lanes`; where
        # the map tells a number again the doubt ends, and no lane does.
        side: int | None = 0
        if word.before != word.after or word.shift:
            side = word.shift
        elif goes_on:
            side = None
        for off, now in product(offs, offs if goes_on else (0,)):
            before, after = word.before + off, word.after + now
            is_change = before != after or side
            step = Step(before, after, side) if is_change else Step(after, after)
            if 1 <= min(before, after) <= max(before, after) <= n_lanes:
                which[k, off, now] = found.setdefault(step, len(found))
    return tuple(found), which


def _widened(move: FloatArray, n_positions: int, parameters: Parameters) -> FloatArray:
    """A transition (R', R') of a road with fewer lanes, for all positions (R, R). The car is never
    where it has no lane, and from there, as from everywhere, jumps onto the road."""
    n_here, jump = len(move), number(parameters, "jump")
    wide = (1 - jump) * np.eye(n_positions)
    wide[:, :n_here] += jump / n_here
    wide[:n_here] = 0.0
    wide[:n_here, :n_here] = move
    return wide


def _carried(
    step: Step, velocity: float, n_lanes: int, cells: int, parameters: Parameters
) -> FloatArray:
    """The transition (R, R) in the frame of a change."""
    right = number(parameters, "change_at_right")
    onto = np.kron(survivors(step.before, step.after, step.shift, right), np.eye(cells))
    move = onto @ fixed.moved(velocity, step.after * cells, cells, parameters)
    carried = np.zeros((n_lanes * cells, n_lanes * cells))
    carried[: len(move), : move.shape[1]] = move
    # A lane beyond the last one is the last one.
    beyond = n_lanes - step.before
    carried[len(move) :, : move.shape[1]] = np.tile(move[len(move) - cells :], (beyond, 1))
    return carried

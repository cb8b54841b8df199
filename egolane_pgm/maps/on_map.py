"""Adds a map to a drive: the lanes of its road in each frame, and the evidence of the lane on that
road; and adds the positions of a receiver to that.

The rule around the rule is `evidence_along`: it calls the evidence rule for roads of several
numbers of lanes, and the map says which of the answers count in which frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np

from egolane_pgm.evidence.line_geometry.model import LANE_M
from egolane_pgm.evidence.lines_beside import fit_of_counts, off_by, tells_the_number
from egolane_pgm.experiment import Experiment, Gnss, load_experiment
from egolane_pgm.graphs.lane_steps import read_steps
from egolane_pgm.inference.compile import Compiled
from egolane_pgm.maps.lane_graph import ways_named
from egolane_pgm.maps.lanes_from_gnss import Across, across, beside_lines
from egolane_pgm.maps.road_table import RoadTable
from egolane_pgm.maps.steps import (
    LanesAlong,
    check_overlap,
    lanes_along,
    on_constant_road,
    road_changes,
)
from egolane_pgm.parameters import Parameters, number, resolve_parameters
from egolane_pgm.types import Evidence, FloatArray, InputError, IntArray, LineLog

#: The nodes that a graph of positions inside the lane observes.
POSITIONS = ("RoadPosition", "SensorState")


def is_of_changing_roads(graph: ModuleType) -> bool:
    """Whether a graph takes the lanes of the road in each frame, as the input Step."""
    return "Step" in getattr(graph, "INPUTS", ()) and hasattr(graph, "most_lanes")


def check_on_map(experiment: Experiment, graph: ModuleType) -> None:
    """Raise InputError for a graph or a reading of the evidence that knows no changing road."""
    if not is_of_changing_roads(graph):
        raise InputError(
            f"{experiment.source}: graph: {experiment.graph} is of a road with a fixed number of"
            " lanes; a road table needs graph: changing_lanes or position_in_changing_lanes"
        )
    if experiment.evidence_reading != "soft":
        raise InputError(
            f"{experiment.source}: evidence_reading: {experiment.evidence_reading} does not go with"
            " a road table; soft does"
        )


def with_lanes_of(table: RoadTable, experiment: Experiment, graph: ModuleType) -> Experiment:
    """The experiment with the lanes and the steps of a road. Raises InputError for a road table
    that cannot be used."""
    on_map = int(table.n_lanes.max())
    named = {p.name for p in graph.PARAMETERS}
    known = {name: value for name, value in experiment.parameters.items() if name in named}
    where = f"{experiment.source}: parameters"
    parameters = resolve_parameters(graph.PARAMETERS, known, on_map, where)
    found = road_changes(table, doubts_guesses=bool(parameters.get("guess_wrong")))
    steps = found.vocabulary(is_exact=not parameters.get("place_sigma_m"))
    n_lanes = graph.most_lanes(on_map, {**parameters, "steps": steps})
    changes: dict[str, Any] = {"n_lanes": n_lanes, "parameters": {"steps": steps}}
    if isinstance(told := experiment.start_lane, tuple):
        # It is told of the road where the drive begins, which is not always the widest.
        changes["start_lane"] = told + (0.0,) * (n_lanes - len(told))
    return load_experiment(experiment, changes)


def road_along(
    experiment: Experiment, table: RoadTable, parameters: Mapping[str, Any], log: LineLog
) -> LanesAlong | None:
    """The lanes of the road in each frame of a log, as the experiment's graph takes them; None
    where the number is fixed.

    - parameters: the model's. Raises InputError as `lanes_along`.
    """
    if not experiment.follows_map:
        return None
    return lanes_along(
        table,
        log.time_s,
        steps=str(parameters["steps"]),
        n_lanes=experiment.n_lanes,
        place_sigma_m=float(parameters.get("place_sigma_m", 0.0)),
        source=log.source,
    )


def untold_lanes(table: RoadTable, log: LineLog) -> list[str]:
    """Lines for the frames of a log in which the map does not tell the number of lanes, whether it
    was guessed or not, and for those that are off the map."""
    row = np.maximum(np.searchsorted(table.t_s, log.time_s, side="right") - 1, 0)
    off, way = table.segment[row] < 0, table.untold[row]
    untold, guessed = ~off & (table.n_lanes[row] == 0), (table.n_lanes[row] > 0) & (way > 0)
    what, goes_on = "the map does not tell how many lanes the road has", "the number before goes on"
    said = (
        (guessed, f"{what} ({ways_named(way[guessed])}); the number is a guess"),
        (untold, f"{what}; {goes_on}"),
        (off, f"the car is off the map; {goes_on}"),
    )
    return [
        f"{table.source}: in {here.sum()} of {len(log)} frames {what}"
        for here, what in said
        if here.any()
    ]


def across_road(
    experiment: Experiment, table: RoadTable, road: LanesAlong | None, log: LineLog
) -> Across | None:
    """Where positions put the car in each frame of a log; None where they do not count. Raises
    InputError where the road table is of another time."""
    if experiment.gnss is None:
        return None
    check_overlap(table, log.time_s, log.source)
    lanes = np.full(len(log), experiment.n_lanes) if road is None else road.n_lanes
    return across(table, log.time_s, lanes, experiment.gnss.lane_width_m)


def evidence_along(
    rule: ModuleType,
    graph: ModuleType,
    n_lanes: int,
    parameters: Parameters,
    log: LineLog,
    road: LanesAlong | None,
) -> tuple[Evidence, FloatArray | None]:
    """The evidence of a log of T frames on a road whose lanes change, and the tentative vector
    (T, n) of a road with the lanes of the map; None for a graph of positions.

    - road: None for one on which nothing changes.
    """
    road = road or on_constant_road(len(log), n_lanes)
    if POSITIONS in graph.OBSERVED:
        return _positions_along(rule, graph, n_lanes, parameters, log, road), None
    asked = {n + k for n in np.unique(road.n_lanes).tolist() for k in (-1, 0, 1)}
    joint = np.zeros((len(log), n_lanes, n_lanes))
    # On a road whose number of lanes is certain, this scales a frame's evidence and no more.
    width_m = number(parameters, "lane_width_m")
    fit, tells = fit_of_counts(log, n_lanes, width_m), tells_the_number(log, width_m)
    wor = np.ones((len(log), 2))
    tentative = np.zeros((len(log), n_lanes))
    for n in sorted(asked.intersection(range(1, n_lanes + 1))):
        given = rule.evidence(log, n, parameters)
        output = given.likelihoods["DetectorOutput"]
        largest = output.max(axis=1, keepdims=True)
        joint[:, :n, n - 1] = fit[:, n - 1 : n] * output / np.where(largest > 0, largest, 1.0)
        here = road.n_lanes == n
        seen = given.likelihoods["WOR"]
        if seen.shape != wor.shape:
            raise InputError(f"evidence for WOR: shape {seen.shape}, the graph needs {wor.shape}")
        wor[here] = seen[here]
        tentative[here, :n] = output[here]
    # Counting votes for fewer lanes where only the lines of its own lane are seen.
    alike = tentative / tentative.max(axis=1, keepdims=True)
    rightmost = np.take_along_axis(alike, road.n_lanes[:, None] - 1, axis=1)
    alike = np.where(np.arange(n_lanes) < road.n_lanes[:, None], alike, rightmost)
    joint[~tells] = np.where(joint[~tells] > 0, alike[~tells, :, None], 0.0)
    found = Evidence(
        {("DetectorOutput", "Lanes"): joint, "WOR": wor, "Lane": road.served}, {"Step": road.step}
    )
    return found, tentative / tentative.sum(axis=1, keepdims=True)


def _positions_along(
    rule: ModuleType,
    graph: ModuleType,
    n_lanes: int,
    parameters: Parameters,
    log: LineLog,
    road: LanesAlong,
) -> Evidence:
    """The evidence of positions on a road with the lanes of the map: in each frame what the rule
    makes of the lines on a road of that many lanes, or of those that there seem to be where the map
    does not tell them."""
    cells = int(number(parameters, "cells"))
    joint = np.zeros((len(log), n_lanes * cells, 2))
    motion = np.zeros(len(log), dtype=np.int64)
    off = _off_the_guess(n_lanes, parameters, log, road)
    lanes = road.n_lanes + off
    for n in np.unique(lanes).tolist():
        given = rule.evidence(log, n, parameters)
        here = lanes == n
        joint[here, : n * cells] = given.likelihoods[POSITIONS][here]
        motion = given.inputs["LineMotion"]
    joint *= np.repeat(road.served, cells, axis=1)[:, :, None]
    step = graph.step_index(road.step, motion, n_lanes, parameters, off)
    return Evidence({POSITIONS: joint}, {"Step": step})


def _off_the_guess(
    n_lanes: int, parameters: Parameters, log: LineLog, road: LanesAlong
) -> IntArray:
    """How many lanes more (-1, 0 or 1) there seem to be in each frame than a guess says, (T,)."""
    steps = read_steps(road.steps, n_lanes)
    goes_on = np.array([step.is_guess and not step.is_change for step in steps])[road.step]
    goes_on[:1] = False
    if not goes_on.any():
        return np.zeros(len(log), dtype=np.int64)
    said = (parameters.get(name) for name in ("lane_width_m", "fallback_width_m"))
    width_m = next((width for width in said if isinstance(width, int | float)), LANE_M)
    fit = fit_of_counts(log, n_lanes, width_m)
    fit[~tells_the_number(log, width_m)] = 1.0
    near = road.n_lanes[:, None] + (-1, 0, 1)
    # Column n is that of n lanes: none is not among them.
    fit = np.take_along_axis(np.pad(fit, ((0, 0), (1, 1))), near, axis=1)
    wrong, stays = number(parameters, "guess_wrong"), number(parameters, "map_stays")
    return off_by(fit, goes_on, wrong, stays)


def with_positions(
    compiled: Compiled, log: LineLog, lines: Evidence, seen: Across, gnss: Gnss
) -> Evidence:
    """The evidence of T frames with what positions say of the lane, or of the place across the road
    for a graph that knows it.

    - lines: the evidence of the T frames of the log without them.
    """
    of_places = POSITIONS in lines.likelihoods
    key, node = (POSITIONS, POSITIONS[0]) if of_places else ("Lane", "Lane")
    said = beside_lines(compiled, lines, node, log, seen, gnss)
    joint = lines.likelihoods[key] * (said[:, :, None] if of_places else said)
    return replace(lines, likelihoods={**lines.likelihoods, key: joint})

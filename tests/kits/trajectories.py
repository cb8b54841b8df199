"""Answers about whole drives by adding up every trajectory, in plain loops: what the smoothers and
the most probable path are checked against."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from egolane_pgm.graphs.cpds import Table
from egolane_pgm.types import Evidence
from tests.conformance.networks import (
    _assignments,
    _likelihood,
    _marginal,
    _size,
    _weight,
)

#: The assignment of every node in every frame, and its probability with the evidence.
Weighted = tuple[tuple[dict[str, int], ...], float]


def trajectories(tables: Sequence[Table], evidence: Evidence) -> tuple[list[Weighted], list[bool]]:
    """Every trajectory of positive weight; the evidence of frames of zero joint likelihood (the
    flags) is left out."""
    slices = [[t for t in tables if t.node[1] == s] for s in (0, 1)]
    paths: list[Weighted] = [((), 1.0)]
    flags = []
    for t in range(len(evidence)):
        extended = extend(paths, slices[min(t, 1)], evidence, t)
        scaled = [(path, weight * _likelihood(evidence, t, path[-1])) for path, weight in extended]
        scaled = [(path, weight) for path, weight in scaled if weight > 0]
        flags.append(not scaled)
        paths = scaled or extended
    return paths, flags


def extend(
    paths: Sequence[Weighted], tables: Sequence[Table], evidence: Evidence, t: int
) -> list[Weighted]:
    """The trajectories one frame longer, before its evidence."""
    priced = [table for table in tables if table.node[0] not in evidence.inputs]
    extended = [
        ((*path, values), weight * _weight(priced, path[-1] if path else {}, values))
        for path, weight in paths
        for values in _assignments(tables, evidence, t)
    ]
    return [(path, weight) for path, weight in extended if weight > 0]


def enumerated_smoothing(
    tables: Sequence[Table], hidden: Sequence[str], evidence: Evidence, lags: Sequence[int]
) -> list[dict[str, np.ndarray]]:
    """For each lag P(node at t | evidence up to t + lag) per node (T, cardinality)."""
    n_frames = len(evidence)
    seen = [trajectories(tables, evidence.take(slice(0, k + 1)))[0] for k in range(n_frames)]
    answers = []
    for lag in lags:
        marginals: dict[str, list[np.ndarray]] = {name: [] for name in hidden}
        for t in range(n_frames):
            at = [((path[t],), weight) for path, weight in seen[min(t + lag, n_frames - 1)]]
            for name in hidden:
                marginals[name].append(_marginal(at, name, _size(tables, name)))
        answers.append({name: np.stack(values) for name, values in marginals.items()})
    return answers


def enumerated_paths(
    tables: Sequence[Table], hidden: Sequence[str], evidence: Evidence
) -> dict[tuple[tuple[int, ...], ...], float]:
    """P(values of the hidden nodes in all frames, evidence), by these values."""
    paths, _ = trajectories(tables, evidence)
    weights: dict[tuple[tuple[int, ...], ...], list[float]] = defaultdict(list)
    for path, weight in paths:
        weights[tuple(tuple(values[name] for name in hidden) for values in path)].append(weight)
    return {states: math.fsum(parts) for states, parts in weights.items()}

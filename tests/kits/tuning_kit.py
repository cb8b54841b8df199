"""What the tests of the parameter search share: a short simulated drive, and cheap objectives."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from egolane_pgm.tuning.plan import Plan, Problem, load_plan, make_problem, with_options
from egolane_pgm.tuning.sampler import from_unit
from egolane_pgm.tuning.space import Point, SearchSpace, distributions, make_space

from egolane_pgm.parameters import Parameter
from egolane_pgm.types import FloatArray

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
QUICKSTART = EXPERIMENTS / "quickstart.yaml"

#: Blocks of the simulated drive without any of which every lane is left.
BLOCKS = 7


def plan(**options: Any) -> Plan:
    """The simulated drive, with options of the tuning section."""
    return with_options(load_plan(QUICKSTART), {"blocks": BLOCKS, **options})


@functools.lru_cache(maxsize=8)
def _problem(options: tuple[tuple[str, Any], ...]) -> Problem:
    return make_problem(plan(**dict(options)))


def problem(**options: Any) -> Problem:
    """As `plan`, with the recording read."""
    return _problem(tuple(sorted(options.items())))


def plain_space(n: int = 3) -> SearchSpace:
    """A space without a recording: x0, x1, ... in (0, 1)."""
    specs = [Parameter(f"x{k}", "probability", 0.5, "", search=(0.0, 1.0)) for k in range(n)]
    return make_space(specs, {s.name: s.default for s in specs}, {}, 1, "plain")


def bowl(point: Point) -> list[float]:
    """Best, 1, where all are 0.3; in steps, as accuracy is."""
    values = np.array([float(v) for v in point.values()])
    return [float(np.round(1 - np.abs(values - 0.3).mean(), 3))]


def points_at(space: SearchSpace, units: FloatArray) -> list[dict[str, Any]]:
    """Points of the space from rows of the unit cube."""
    ranges = distributions(space)
    return [
        {key: from_unit(d, u) for (key, d), u in zip(ranges.items(), row, strict=True)}
        for row in units.tolist()
    ]


def told(trials: Sequence[Any]) -> list[tuple[Mapping[str, Any], Any]]:
    """What was tried and what came out, in order."""
    return [(t.params, t.values) for t in trials]

"""What the tests of the parameter search share: a short simulated drive, and cheap objectives."""

from __future__ import annotations

import functools
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.parameters import Parameter
from egolane_pgm.tune.plan import Plan, Problem, load_plan, make_problem, with_options
from egolane_pgm.tune.space import Point, SearchSpace, make_space
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


def bowl(points: Sequence[Point]) -> FloatArray:
    """Best, 1, where all are 0.3; in steps, as accuracy is."""
    values = np.array([[float(v) for v in p.values()] for p in points])
    return np.round(1 - np.abs(values - 0.3).mean(axis=1, keepdims=True), 3)


def slow_bowl(points: Sequence[Point]) -> FloatArray:
    """As `bowl`, with time to be killed in the middle of a trial."""
    time.sleep(0.002 * len(points))
    return bowl(points)


def told(trials: Sequence[Any]) -> list[tuple[Mapping[str, Any], Any]]:
    """What was tried and what came out, in order."""
    return [(t.params, t.values) for t in trials]

"""EM of tied parameters: the numbers that a graph's tables are made of, such as sigma1 and p1.

The E step is that of `em`. The M step maximises the expected log likelihood of the tables,
`Q = sum_ij N_ij log table_ij(parameters)` over the expected counts N, within the bounds of the
parameters. Soft evidence is linear in a table's row, so that a maximum often lies at a bound.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from egolane_pgm.graphs.cpds import SliceNode, Table
from egolane_pgm.inference.compile import Compiled, with_tables
from egolane_pgm.studies.em import Learned, iterate
from egolane_pgm.types import BoolArray, Evidence, FloatArray, IntArray

#: The smallest probability whose logarithm counts, so that a bound is not out of reach.
_TINY = 1e-300

#: From numbers (D,) to the tables of the network, of both slices.
TablesOf = Callable[[FloatArray], Sequence[Table]]


def fit_tied(
    compiled: Compiled,
    evidence: Evidence,
    tables_of: TablesOf,
    start: Sequence[float],
    bounds: Sequence[tuple[float, float]],
    known: Mapping[str, IntArray] | None = None,
    is_first: BoolArray | None = None,
    *,
    iterations: int = 100,
) -> Learned:
    """Find the most probable numbers by EM, with a flat prior.

    - compiled: the network; its structure must be that of the tables.
    - tables_of: the tables of numbers (D,), of both slices.
    - start, bounds: of the D numbers; a start out of bounds is moved into them.
    - known, is_first: as `expected_counts`.

    Raises InputError as `expected_counts`.
    """
    low, high = np.array(bounds, dtype=np.float64).reshape(-1, 2).T
    numbers = np.clip(np.asarray(start, dtype=np.float64), low, high)

    def maximise(counts: Mapping[SliceNode, FloatArray]) -> tuple[Compiled, float]:
        nonlocal numbers
        numbers = _maximised(counts, tables_of, numbers, (low, high))
        return with_tables(compiled, tables_of(numbers)), 0.0

    first = with_tables(compiled, tables_of(numbers))
    found = iterate(first, 0.0, (evidence, known, is_first), maximise, iterations)
    return replace(found, numbers=numbers)


def _maximised(
    counts: Mapping[SliceNode, FloatArray],
    tables_of: TablesOf,
    numbers: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Return numbers at which the expected log likelihood is at its largest."""

    def loss(at: FloatArray) -> float:
        tables = {table.node: table.values for table in tables_of(np.clip(at, *bounds))}
        value = sum(
            float((count * np.log(np.maximum(tables[node], _TINY))).sum())
            for node, count in counts.items()
        )
        return -value

    with warnings.catch_warnings():
        # Nelder and Mead's start is moved into the bounds.
        warnings.simplefilter("ignore")
        found = minimize(
            loss,
            numbers,
            method="Nelder-Mead",
            bounds=np.stack(bounds, axis=1),
            options={"xatol": 1e-5, "fatol": 1e-4, "maxfev": 200 * len(numbers)},
        )
    # The expected log likelihood never falls, so the log evidence does not.
    better = found.fun <= loss(numbers)
    return np.clip(found.x, *bounds) if better else numbers

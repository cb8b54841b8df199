"""EM of tied parameters: the numbers that a graph's tables are made of, such as sigma1 and p1.

The E step is that of `em`. The M step maximises the expected log likelihood of the tables,
`Q = sum_ij N_ij log table_ij(parameters)` over the expected counts N, within the bounds of the
parameters. Soft evidence is linear in a table's row, so that a maximum often lies at a bound.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from egolane_pgm.graphs.cpds import SliceNode, Table
from egolane_pgm.inference.compile import Compiled, with_tables
from egolane_pgm.inference.expected_counts import expected_counts
from egolane_pgm.studies.em import TOLERANCE
from egolane_pgm.types import BoolArray, Evidence, FloatArray, InputError, IntArray

#: The smallest probability whose logarithm counts, so that a bound is not out of reach.
_TINY = 1e-300

#: From numbers (D,) to the tables of the network, of both slices.
TablesOf = Callable[[FloatArray], Sequence[Table]]

#: From numbers (D,) to their log prior.
LogPrior = Callable[[FloatArray], float]


@dataclass(frozen=True)
class TiedFit:
    """The result of EM of tied parameters.

    - numbers: (D,).
    - compiled: the network with their tables.
    - log_posterior (I,): log evidence plus log prior, before each iteration and after the last.
    - is_impossible (T,): marks frames whose evidence has probability zero.
    - starts (R,): the log posterior that each start reached, the first one's first.
    """

    numbers: FloatArray
    compiled: Compiled
    log_posterior: FloatArray
    is_impossible: BoolArray
    starts: FloatArray


def fit_tied(
    compiled: Compiled,
    evidence: Evidence,
    tables_of: TablesOf,
    start: Sequence[float],
    bounds: Sequence[tuple[float, float]],
    known: Mapping[str, IntArray] | None = None,
    is_first: BoolArray | None = None,
    *,
    log_prior: LogPrior = lambda numbers: 0.0,
    iterations: int = 100,
    restarts: int = 0,
    seed: int = 0,
) -> TiedFit:
    """Find the most probable numbers by EM.

    - compiled: the network; its structure must be that of the tables.
    - tables_of: the tables of numbers (D,), of both slices.
    - start, bounds: of the D numbers.
    - known, is_first: as `expected_counts`.
    - log_prior: of the numbers, natural logarithm; by default flat.
    - restarts: further starts, drawn uniformly within the bounds; the best fit is returned.

    Raises InputError as `expected_counts`, and for a start outside of the bounds.
    """
    low, high = np.array(bounds, dtype=np.float64).reshape(-1, 2).T
    first = np.asarray(start, dtype=np.float64)
    if first.shape != low.shape or not ((low <= first) & (first <= high)).all():
        raise InputError(f"tied parameters: the start {first.tolist()} is not within the bounds")
    rng = np.random.default_rng(seed)
    starts = [first, *(low + (high - low) * rng.random((restarts, len(low))))]
    data = (evidence, known, is_first)
    fits = [
        _fit(compiled, data, tables_of, at, (low, high), log_prior, iterations) for at in starts
    ]
    reached = np.array([fit.log_posterior[-1] for fit in fits])
    best = fits[int(np.argmax(reached))]
    return TiedFit(best.numbers, best.compiled, best.log_posterior, best.is_impossible, reached)


def _fit(
    compiled: Compiled,
    data: tuple[Evidence, Mapping[str, IntArray] | None, BoolArray | None],
    tables_of: TablesOf,
    start: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
    log_prior: LogPrior,
    iterations: int,
) -> TiedFit:
    numbers, history = start, []
    while True:
        now = with_tables(compiled, tables_of(numbers))
        expected = expected_counts(now, *data)
        history.append(expected.log_evidence + log_prior(numbers))
        gain = history[-1] - history[-2] if len(history) > 1 else np.inf
        if gain <= TOLERANCE * max(1, len(data[0])) or len(history) > iterations:
            reached = np.array(history)
            return TiedFit(numbers, now, reached, expected.is_impossible, reached[-1:])
        numbers = _maximised(expected.counts, tables_of, numbers, bounds, log_prior)


def _maximised(
    counts: Mapping[SliceNode, FloatArray],
    tables_of: TablesOf,
    numbers: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
    log_prior: LogPrior,
) -> FloatArray:
    """Return numbers at which the expected log posterior is at its largest."""

    def loss(at: FloatArray) -> float:
        tables = {table.node: table.values for table in tables_of(np.clip(at, *bounds))}
        value = sum(
            float((count * np.log(np.maximum(tables[node], _TINY))).sum())
            for node, count in counts.items()
        )
        return -value - log_prior(at)

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
    # The expected log posterior never falls, so that the log posterior does not.
    better = found.fun <= loss(numbers)
    return np.clip(found.x, *bounds) if better else numbers

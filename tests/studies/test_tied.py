"""EM of tied parameters against a direct search of the log evidence."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from egolane_pgm.graphs import sensor_failure
from egolane_pgm.inference.compile import Compiled, compile_tables, with_tables
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.inference.sampling import sample
from egolane_pgm.parameters import resolve_parameters
from egolane_pgm.studies.em import fit_tied
from egolane_pgm.types import Evidence

NAMES = ("sigma1", "sigma2", "p1", "p2", "p3", "p4")
BOUNDS = [(1e-3, 3.0), (1e-3, 3.0), *[(0.0, 1.0)] * 4]
TRUE = np.array([0.45, 0.6, 0.95, 0.85, 0.9, 0.8])
START = [0.6, 0.9, 0.8, 0.8, 0.7, 0.7]


def tables_of(numbers: np.ndarray) -> list:
    given = dict(zip(NAMES, map(float, numbers), strict=True))
    return sensor_failure.tables(3, resolve_parameters(sensor_failure.PARAMETERS, given, 3))


@pytest.fixture(scope="module")
def network() -> Compiled:
    return compile_tables(
        tables_of(TRUE), observed=sensor_failure.OBSERVED, hidden=sensor_failure.HIDDEN
    )


@pytest.fixture(scope="module")
def evidence(network: Compiled) -> Evidence:
    """What a drive of the model shows, softened."""
    drawn = sample(network, 4000, seed=1)
    hard = Evidence.hard(drawn[["DetectorOutput", "WOR"]], network)
    return Evidence({key: values + 0.05 for key, values in hard.likelihoods.items()})


def log_evidence(network: Compiled, evidence: Evidence, numbers: np.ndarray) -> float:
    now = with_tables(network, tables_of(numbers))
    return float(filter_beliefs(now, evidence).log_evidence.sum())


def test_em_ends_where_a_direct_search_ends(network: Compiled, evidence: Evidence) -> None:
    fit = fit_tied(network, evidence, tables_of, START, BOUNDS)
    assert (np.diff(fit.log_posterior) > -1e-6).all()
    assert fit.log_posterior[-1] == pytest.approx(log_evidence(network, evidence, fit.numbers))
    direct = minimize(
        lambda x: -log_evidence(network, evidence, x),
        START,
        method="Nelder-Mead",
        bounds=BOUNDS,
        options={"maxfev": 1500, "xatol": 1e-4, "fatol": 1e-3},
    )
    assert fit.log_posterior[-1] > -direct.fun - 0.5
    np.testing.assert_allclose(fit.numbers, TRUE, atol=0.12)


def test_a_start_out_of_bounds_is_moved_into_them(network: Compiled, evidence: Evidence) -> None:
    short = evidence.take(slice(0, 300))
    found = [
        fit_tied(network, short, tables_of, [*START[:5], p4], BOUNDS, iterations=3).numbers
        for p4 in (1.0, 1.5)
    ]
    np.testing.assert_array_equal(*found)

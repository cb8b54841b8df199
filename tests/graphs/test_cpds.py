"""Tables: the discretised normal F, checks of tables, and the declaration in pgmpy."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from egolane_pgm.graphs.cpds import (
    Table,
    declare,
    dynamics,
    lane_normals,
    normal_cdf,
    previous,
    prior,
    uniform,
    within,
)
from egolane_pgm.types import InputError


@settings(max_examples=50, deadline=None)
@given(sigma=st.floats(0.05, 1e6), n=st.integers(1, 6))
def test_every_row_is_a_distribution_and_its_mirror_image_mirrored(sigma: float, n: int) -> None:
    rows = lane_normals(sigma, n)
    assert rows.shape == (n, n)
    assert (rows >= 0).all()
    np.testing.assert_allclose(rows.sum(axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(rows[::-1, ::-1], rows, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("sigma", [1e-3, 1e-100, 1e-200, 1e-300])
def test_a_tiny_sigma_leaves_all_on_the_nearest_lane_without_a_warning(sigma: float) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_array_equal(lane_normals(sigma, 4), np.eye(4))


@pytest.mark.parametrize("sigma", [1e6, 1e12, 1e17, 1e200, 1.7e308])
def test_a_boundless_sigma_is_uniform(sigma: float) -> None:
    np.testing.assert_allclose(lane_normals(sigma, 5), np.full((5, 5), 0.2), rtol=1e-6)


def test_the_normal_s_distribution_function_keeps_the_digits_of_its_tail() -> None:
    found = normal_cdf(np.array([[-10.0, 0.0], [1.96, 40.0]]))
    np.testing.assert_allclose(found, [[7.619853024160527e-24, 0.5], [0.9750021048517795, 1]])


# --- tables --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parents", "values", "message"),
    [
        ((), np.full((2, 2), 0.5), "P(D at t+1 | nothing): the table has 2 axes, needs 1"),
        ((("A", 0),), np.full(2, 0.5), "P(D at t+1 | A at t): the table has 1 axes, needs 2"),
        ((), np.array([np.nan, 1.0]), "P(D at t+1 | nothing): the table has a negative or NaN"),
        ((), np.array([-0.5, 1.5]), "P(D at t+1 | nothing): the table has a negative or NaN"),
        ((), np.array([np.inf, 1.0]), "P(D at t+1 | nothing): the rows of the table must sum"),
        (
            (("A", 1),),
            np.array([[0.5, 0.5], [0.5, 0.6]]),
            "P(D at t+1 | A at t+1): the rows of the table must sum to one",
        ),
    ],
)
def test_a_table_that_is_no_distribution_is_refused_naming_it(
    parents: tuple[tuple[str, int], ...], values: np.ndarray, message: str
) -> None:
    with pytest.raises(InputError) as error:
        Table(("D", 1), parents, values)
    assert str(error.value).startswith(message)


# --- declaration ---------------------------------------------------------------------------------

KEEP = np.array([[0.9, 0.1], [0.2, 0.8]])


def persistent(name: str) -> list[Table]:
    return [*prior(name, [0.5, 0.5]), *dynamics(name, [previous(name)], KEEP)]


def test_a_node_whose_second_slice_has_no_edge_is_declared_all_the_same() -> None:
    tables = [
        *prior("A", [0.5, 0.5]),
        *dynamics("A", [], [0.3, 0.7]),
        *prior("B", [0.5, 0.5]),
        *dynamics("B", [previous("A")], KEEP),
        *within("D", ["B"], KEEP),
    ]
    network = declare(tables, ["D"])
    assert {(str(n[0]), int(n[1])) for n in network.nodes()} >= {("A", 0), ("A", 1)}


@pytest.mark.parametrize(
    ("tables", "observed", "message"),
    [
        (
            [*prior("A", [0.5, 0.5]), *dynamics("A", [previous("B")], KEEP)],
            [],
            "A at t+1 has the parent B at t, for which there is no table",
        ),
        (
            [*prior("A", uniform(3)), *dynamics("A", [previous("A")], uniform(2, 3))],
            [],
            "A: its table has 2 rows for A, which has 3 values",
        ),
        (
            [*prior("A", [0.5, 0.5]), *dynamics("A", [previous("A")], uniform(2, 3))],
            [],
            "A: has 2 values in the first frame and 3 later",
        ),
        ([*persistent("A"), *prior("A", [0.5, 0.5])], [], "A at t: there are two tables for it"),
        (
            [*persistent("A"), *prior("B", [0.5, 0.5]), *dynamics("B", ["A"], KEEP)],
            [],
            "B at t+1 depends on A at t+1, but B at t does not depend on A at t: give both tables",
        ),
        (
            [*persistent("A"), *prior("B", KEEP, ["A"]), *dynamics("B", [previous("B")], KEEP)],
            [],
            "B at t depends on A at t, but B at t+1 does not depend on A at t+1: give both tables",
        ),
        (
            [*within("A", ["B"], KEEP), *within("B", ["A"], KEEP)],
            [],
            "the edges within a slice form a cycle: A -> B -> A",
        ),
        (
            [Table(("A", 0), (("A", 1),), KEEP), Table(("A", 1), (), np.array([0.5, 0.5]))],
            [],
            "A: an edge from A leads from slice 1 back to slice 0",
        ),
    ],
)  # fmt: skip
def test_tables_that_do_not_fit_together_are_refused_naming_both_nodes(
    tables: list[Table], observed: list[str], message: str
) -> None:
    with pytest.raises(InputError) as error:
        declare(tables, observed)
    assert str(error.value).startswith(message)
    assert "\n" not in str(error.value)

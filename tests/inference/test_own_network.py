"""A network of a user's own, all in memory: observed values go in, beliefs and tables come out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pandas as pd
import pytest

from egolane_pgm.graphs.cpds import quiet
from egolane_pgm.inference.compile import Compiled, compile
from egolane_pgm.inference.expected_counts import expected_counts
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.inference.smoothing import smooth_beliefs
from egolane_pgm.inference.unrolling import unrolled
from egolane_pgm.inference.viterbi import viterbi
from egolane_pgm.studies.em import fit_tables
from egolane_pgm.types import Evidence, InputError

with quiet():
    from pgmpy.factors.discrete import TabularCPD
    from pgmpy.models import DynamicBayesianNetwork

GEAR, COLD, RPM = ["low", "mid", "top"], [True, False], ["slow", "fast"]
#: Rows are the node's own values, columns those of what it is given, the last one fastest.
GEAR_FIRST, COLD_FIRST = [[0.5], [0.3], [0.2]], [[0.6], [0.4]]
GEAR_NEXT = [  # given the hill in this frame and the gear before
    [0.8, 0.2, 0.1, 0.9, 0.5, 0.3],
    [0.15, 0.7, 0.2, 0.09, 0.4, 0.4],
    [0.05, 0.1, 0.7, 0.01, 0.1, 0.3],
]
COLD_NEXT = [[0.9, 0.05], [0.1, 0.95]]
RPM_GIVEN = [[0.1, 0.3, 0.4, 0.7, 0.9, 0.6], [0.9, 0.7, 0.6, 0.3, 0.1, 0.4]]  # gear, cold
NOISE = [[0.7, 0.2], [0.3, 0.8]]
#: What was observed, a missing value among it, and what is only likely.
ROWS = {"Rpm": ["fast", None, "slow", "slow"], "Hill": [0, 1, 1, 0]}
HEARD = [[0.9, 0.2], [0.5, 0.5], [0.1, 1.0], [0.3, 0.4]]


def cpd(node: tuple[str, int], rows: Any, given: Sequence[tuple[str, int]] = ()) -> Any:
    values = {"Gear": GEAR, "Cold": COLD, "Rpm": RPM}
    names = {n: values.get(n[0], [0, 1]) for n in (node, *given)}
    sizes = [len(names[n]) for n in given]
    return TabularCPD(node, len(rows), rows, list(given), sizes, names)


def own_network() -> Any:
    """Two hidden nodes, one of which an input moves; pgmpy fills in the second slice itself."""
    edges = [("Hill", "Gear"), ("Gear", "Rpm"), ("Cold", "Rpm"), ("Rpm", "Noise")]
    with quiet():
        network = DynamicBayesianNetwork([((n, 0), (n, 1)) for n in ("Gear", "Cold")])
        network.add_edges_from([((a, 0), (b, 0)) for a, b in edges])
        network.add_cpds(
            cpd(("Hill", 0), [[0.5], [0.5]]),
            cpd(("Gear", 0), np.repeat(GEAR_FIRST, 2, axis=1), [("Hill", 0)]),
            cpd(("Gear", 1), GEAR_NEXT, [("Hill", 1), ("Gear", 0)]),
            cpd(("Cold", 0), COLD_FIRST),
            cpd(("Cold", 1), COLD_NEXT, [("Cold", 0)]),
            cpd(("Rpm", 0), RPM_GIVEN, [("Gear", 0), ("Cold", 0)]),
            cpd(("Noise", 0), NOISE, [("Rpm", 0)]),
        )
    return network


def compiled(network: Any = None, **options: Any) -> Compiled:
    roles: dict[str, Any] = {"observed": ["Rpm", "Noise"], "inputs": ["Hill"], **options}
    return compile(network or own_network(), **roles)


def evidence() -> Evidence:
    hard = Evidence.hard(ROWS, compiled())
    return Evidence({**hard.likelihoods, "Noise": np.array(HEARD)}, hard.inputs)


def test_what_was_learned_goes_back_to_pgmpy() -> None:
    fitted = fit_tables(compiled(), evidence(), strength=1.0, iterations=5)
    with quiet():
        learned = fitted.compiled.network
        assert learned.check_model()
    assert learned.get_cpds(("Cold", 1)).state_names[("Cold", 0)] == list(map(str, COLD))
    assert not np.allclose(learned.get_cpds(("Rpm", 0)).get_values(), RPM_GIVEN)
    again = compiled(learned)
    np.testing.assert_array_equal(again.transition, fitted.compiled.transition)
    assert again.values == fitted.compiled.values


@pytest.mark.parametrize(
    "given",
    [
        {
            "Rpm": ["fast", np.nan, "slow", "slow"],
            "Hill": np.array([0, 1, 1.0, 0]),
        },
        pd.DataFrame(
            {"Rpm": pd.array(ROWS["Rpm"], "string"), "Hill": pd.array([0, 1, 1, 0], "Int64")}
        ),
        pd.DataFrame({"Rpm": pd.Categorical(ROWS["Rpm"]), "Hill": ["0", "1", "1", "0"]}),
    ],
)
def test_values_go_by_name_and_may_be_missing(given: Any) -> None:
    found, right = Evidence.hard(given, compiled()), Evidence.hard(ROWS, compiled())
    assert found.likelihoods["Rpm"].tolist() == [[0, 1], [1, 1], [1, 0], [1, 0]]
    # An observed node that is not given is missing in all frames.
    assert found.likelihoods["Noise"].tolist() == [[1, 1]] * 4
    for key in right.likelihoods:
        np.testing.assert_array_equal(found.likelihoods[key], right.likelihoods[key])
    np.testing.assert_array_equal(found.inputs["Hill"], right.inputs["Hill"])


def test_nodes_that_are_observed_jointly_are_given_each_by_itself() -> None:
    joint = compiled(observed=[("Rpm", "Noise")])
    seen = Evidence.hard({"Rpm": [RPM[0], None], "Noise": [None, 1], "Hill": [0, 0]}, joint)
    assert seen.likelihoods["Rpm", "Noise"].tolist() == [[[1, 1], [0, 0]], [[0, 1], [0, 1]]]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"Rpm": ["fast", "fats"], "Hill": [0, 0]},
            "evidence for Rpm: row 1: 'fats' is not the name of a value (did you mean 'fast'?)",
        ),
        (
            {"Rpm": [None, 2], "Hill": [0, 0]},
            "evidence for Rpm: row 1: 2 is not the name of a value (known: fast, slow)",
        ),
        ({"Rmp": [0], "Hill": [0]}, "evidence for Rmp: no such observed node or input (did you"),
        ({"Rpm": ["fast", "slow"], "Hill": [0]}, "evidence: needs a list of values for each"),
        ({"Rpm": "slow"}, "evidence: needs a list of values for each node: "),
        ({"Rpm": ["slow"], "Hill": [None]}, "evidence for Hill: is missing, an input must be"),
        ({"Rpm": ["slow"]}, "evidence for Hill: is missing, an input must be known"),
    ],
)
def test_observations_that_do_not_fit_are_refused(given: Any, message: str) -> None:
    with pytest.raises(InputError) as error:
        Evidence.hard(given, compiled())
    assert str(error.value).startswith(message)


@pytest.mark.parametrize(
    "use",
    [filter_beliefs, smooth_beliefs, viterbi, expected_counts, lambda c, e: unrolled(c, e, 0, 1)],
)
def test_what_is_no_evidence_is_refused(use: Callable[[Compiled, Any], object]) -> None:
    with pytest.raises(InputError) as error:
        use(compiled(), ROWS)
    assert str(error.value) == (
        "evidence: needs an Evidence, not a dict: Evidence(...) of likelihoods, or"
        " Evidence.hard(...) of observed values"
    )


def test_beliefs_go_by_node_and_make_a_table() -> None:
    beliefs = filter_beliefs(compiled(), evidence(), frame_id=np.array([7, 8, 10, 11]))
    table = beliefs.take(slice(1, None)).to_pandas()
    assert list(table) == ["Cold=True", "Cold=False", "Gear=low", "Gear=mid", "Gear=top"]
    assert (table.index.name, table.index.tolist()) == ("frame_id", [8, 10, 11])
    np.testing.assert_array_equal(table.iloc[:, 2:], beliefs["Gear"][1:])
    with pytest.raises(InputError, match=r"^the beliefs are about no node 'Gaer' \(did you mean"):
        beliefs["Gaer"]
    with pytest.raises(InputError, match=r"^the beliefs are about no node 'Lane' \(known: Cold"):
        _ = beliefs.lane

"""A network of a user's own, all in memory: what was observed goes in, pgmpy's answers come out."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
import pytest

from egolane_pgm.graphs.cpds import quiet
from egolane_pgm.inference.compile import Compiled, compile
from egolane_pgm.inference.expected_counts import expected_counts
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.inference.smoothing import fixed_lag_beliefs, smooth_beliefs
from egolane_pgm.inference.unrolling import unrolled
from egolane_pgm.inference.viterbi import viterbi
from egolane_pgm.types import Evidence, InputError

with quiet():
    from pgmpy.factors.discrete import TabularCPD
    from pgmpy.inference import VariableElimination
    from pgmpy.models import DiscreteBayesianNetwork, DynamicBayesianNetwork

GEAR = ["low", "mid", "top"]
RPM = ["slow", "fast"]
FIRST = [[0.5], [0.3], [0.2]]
# Of the hill in this frame and the gear before.
NEXT = [
    [0.8, 0.2, 0.1, 0.9, 0.5, 0.3],
    [0.15, 0.7, 0.2, 0.09, 0.4, 0.4],
    [0.05, 0.1, 0.7, 0.01, 0.1, 0.3],
]
SHOWN = [[0.1, 0.4, 0.8], [0.9, 0.6, 0.2]]
NOISE = [[0.7, 0.2], [0.3, 0.8]]
#: What was observed, a missing value among it, and what is only likely.
ROWS = {"Rpm": ["fast", None, "slow", "slow"], "Hill": [0, 1, 1, 0]}
HEARD = [[0.9, 0.2], [0.5, 0.5], [0.1, 1.0], [0.3, 0.4]]


def own_network() -> Any:
    with quiet():
        network = DynamicBayesianNetwork(
            [
                (("Gear", 0), ("Gear", 1)),
                (("Hill", 0), ("Gear", 0)),
                (("Gear", 0), ("Rpm", 0)),
                (("Rpm", 0), ("Noise", 0)),
            ]
        )
        names = {("Gear", s): GEAR for s in (0, 1)} | {("Rpm", 0): RPM}
        network.add_cpds(
            TabularCPD(("Hill", 0), 2, [[0.5], [0.5]]),
            TabularCPD(
                ("Gear", 0), 3, np.repeat(FIRST, 2, axis=1), [("Hill", 0)], [2],
                {("Gear", 0): GEAR, ("Hill", 0): [0, 1]},
            ),
            TabularCPD(
                ("Gear", 1), 3, NEXT, [("Hill", 1), ("Gear", 0)], [2, 3],
                {("Gear", 0): GEAR, ("Gear", 1): GEAR, ("Hill", 1): [0, 1]},
            ),
            TabularCPD(
                ("Rpm", 0), 2, SHOWN, [("Gear", 0)], [3], {k: names[k] for k in names if k[1] == 0}
            ),
            TabularCPD(
                ("Noise", 0), 2, NOISE, [("Rpm", 0)], [2],
                {("Noise", 0): [0, 1], ("Rpm", 0): RPM},
            ),
        )  # fmt: skip
    return network


def compiled() -> Compiled:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return compile(own_network(), observed=["Rpm", "Noise"], inputs=["Hill"])


def evidence() -> Evidence:
    hard = Evidence.hard(ROWS, compiled())
    return Evidence({**hard.likelihoods, "Noise": np.array(HEARD)}, hard.inputs)


def ask_pgmpy(frame: int, last: int) -> np.ndarray:
    """P(Gear in a frame | what was observed up to the last one), by pgmpy alone."""
    with quiet():
        network = DiscreteBayesianNetwork()
        for t in range(last + 1):
            nodes = [f"Gear{t}", f"Rpm{t}", f"Noise{t}"]
            network.add_nodes_from(nodes)
            network.add_edges_from(pairwise(nodes))
            before = [f"Gear{t - 1}"] if t else []
            network.add_edges_from((b, nodes[0]) for b in before)
            hill = ROWS["Hill"][t]
            moves = np.array(NEXT)[:, 3 * hill : 3 * hill + 3] if t else FIRST
            network.add_cpds(
                TabularCPD(nodes[0], 3, moves, before, [3] * len(before)),
                TabularCPD(nodes[1], 2, SHOWN, [nodes[0]], [3]),
                TabularCPD(nodes[2], 2, NOISE, [nodes[1]], [2]),
            )
        seen = {f"Rpm{t}": RPM.index(v) for t, v in enumerate(ROWS["Rpm"][: last + 1]) if v}
        heard = [
            TabularCPD(f"Noise{t}", 2, (np.array(HEARD[t]) / sum(HEARD[t]))[:, None])
            for t in range(last + 1)
        ]
        answer: Any = VariableElimination(network).query(
            [f"Gear{frame}"], evidence=seen, virtual_evidence=heard, show_progress=False
        )
        return np.asarray(answer.values)


def test_hard_soft_and_missing_evidence_give_pgmpy_s_beliefs() -> None:
    filtered, lagged, smoothed = (
        answer["Gear"]
        for answer in (
            filter_beliefs(compiled(), evidence()),
            fixed_lag_beliefs(compiled(), evidence(), 1),
            smooth_beliefs(compiled(), evidence()),
        )
    )
    for t in range(4):
        for ours, last in ((filtered, t), (lagged, min(t + 1, 3)), (smoothed, 3)):
            np.testing.assert_allclose(ours[t], ask_pgmpy(t, last), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "given",
    [
        {"Rpm": [1, None, 0, 0], "Hill": [0, 1, 1, 0]},
        {"Rpm": np.array([1, np.nan, 0, 0]), "Hill": np.array([0, 1, 1, 0])},
        pd.DataFrame({"Rpm": pd.array([1, pd.NA, 0, 0], "Int64"), "Hill": [0, 1, 1, 0]}),
        pd.DataFrame({"Rpm": pd.Categorical(ROWS["Rpm"]), "Hill": ["0", "1", "1", "0"]}),
    ],
)
def test_values_go_by_name_or_index_and_may_be_missing(given: Any) -> None:
    found, right = Evidence.hard(given, compiled()), Evidence.hard(ROWS, compiled())
    assert found.likelihoods["Rpm"].tolist() == [[0, 1], [1, 1], [1, 0], [1, 0]]
    # An observed node that is not given is missing in all frames.
    assert found.likelihoods["Noise"].tolist() == [[1, 1]] * 4
    for key in right.likelihoods:
        np.testing.assert_array_equal(found.likelihoods[key], right.likelihoods[key])
    np.testing.assert_array_equal(found.inputs["Hill"], right.inputs["Hill"])


def test_nodes_that_are_observed_jointly_are_given_each_by_itself() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        joint = compile(own_network(), observed=[("Rpm", "Noise")], inputs=["Hill"])
    seen = Evidence.hard({"Rpm": [0, None], "Noise": [None, 1], "Hill": [0, 0]}, joint)
    assert seen.likelihoods["Rpm", "Noise"].tolist() == [[[1, 1], [0, 0]], [[0, 1], [0, 1]]]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            {"Rpm": ["fast", "fats"], "Hill": [0, 0]},
            "evidence for Rpm: row 1: 'fats' is neither the name of a value nor an index, 0 to 1"
            " (did you mean 'fast'?)",
        ),
        (
            {"Rpm": [0, 2], "Hill": [0, 0]},
            "evidence for Rpm: row 1: 2 is neither the name of a value nor an index, 0 to 1"
            " (known: fast, slow)",
        ),
        (
            {"Rmp": [0], "Hill": [0]},
            "evidence for Rmp: the network has no such observed node or input (did you mean"
            " 'Rpm'?); `compile` is given those that are observed",
        ),
        (
            {"Rpm": [0, 1, 1], "Hill": [0, 0]},
            "evidence: different numbers of frames: Rpm 3, Hill 2",
        ),
        (
            {"Rpm": [0, 1], "Hill": [0, None]},
            "evidence for Hill: row 1: is missing, an input must be known",
        ),
        ({"Rpm": [0]}, "evidence for Hill: every row: is missing, an input must be known"),
        ({"Rpm": 1}, "evidence for Rpm: needs a value for each frame, e.g. [1]"),
    ],
)
def test_observations_that_do_not_fit_are_refused(given: Any, said: str) -> None:
    with pytest.raises(InputError) as error:
        Evidence.hard(given, compiled())
    assert str(error.value) == said


def test_a_number_that_is_one_value_s_name_and_another_s_index_is_refused() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        counted = compile(
            own_network(),
            observed=["Rpm", "Noise"],
            inputs=["Hill"],
            values={"Rpm": ["1", "2"]},
        )
    rows = {"Rpm": ["1", "2"], "Hill": [0, 0]}
    assert Evidence.hard(rows, counted).likelihoods["Rpm"].tolist() == [[1, 0], [0, 1]]
    with pytest.raises(InputError, match="row 0: 1 is the name of one value and the index of"):
        Evidence.hard({"Rpm": [1, 2], "Hill": [0, 0]}, counted)


@pytest.mark.parametrize(
    "use",
    [filter_beliefs, smooth_beliefs, viterbi, expected_counts, lambda c, e: unrolled(c, e, 0, 1)],
)
def test_what_is_no_evidence_is_refused(use: Callable[[Compiled, Any], object]) -> None:
    with pytest.raises(InputError) as error:
        use(compiled(), ROWS)
    assert str(error.value) == (
        "evidence: needs an Evidence, not a dict: Evidence(...) of likelihoods, or"
        " Evidence.hard(...) of what was observed"
    )


def test_beliefs_go_by_node_and_make_a_table() -> None:
    beliefs = filter_beliefs(compiled(), evidence(), frame_id=np.array([7, 8, 10, 11]))
    table = beliefs.take(slice(1, None)).to_pandas()
    assert list(table) == ["Gear=low", "Gear=mid", "Gear=top"]
    assert (table.index.name, table.index.tolist()) == ("frame_id", [8, 10, 11])
    np.testing.assert_array_equal(table, beliefs["Gear"][1:])
    with pytest.raises(InputError, match=r"^the beliefs are about no node 'Gaer' \(did you mean"):
        beliefs["Gaer"]
    with pytest.raises(InputError, match=r"^the network has no node Lane, it has Gear: "):
        _ = beliefs.lane

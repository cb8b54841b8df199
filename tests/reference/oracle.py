"""Exact answers from pgmpy alone, for short sequences: what the filters are checked against.

Nothing of `compile` or `filtering` is used. The declared two-slice network is unrolled over the
frames into a Bayesian network of `<name>@<frame>`, reading each CPD by the names of its
variables; each frame's likelihood goes into the virtual-evidence nodes, as P(1 | .) = likelihood
over its maximum, and they are conditioned on being 1. All else is pgmpy's variable elimination.

It costs milliseconds per frame, and the joint probability of the sequence must be representable:
some tens of frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.graphs.cpds import quiet, ve_name
from egolane_pgm.types import Beliefs, Evidence, FloatArray, InputError, Observed

if TYPE_CHECKING:
    from pgmpy.models import DiscreteBayesianNetwork, DynamicBayesianNetwork


def oracle_filter(
    network: DynamicBayesianNetwork,
    hidden: Sequence[str],
    observed: Sequence[Observed],
    evidence: Evidence,
    inputs: Sequence[str] = (),
) -> Beliefs:
    """The exact filter: P(node | evidence so far) for every hidden node and frame, and the log
    evidence of each frame given the frames before.

    A frame of zero joint likelihood is flagged and its evidence is left out. Raises InputError
    where the joint probability of the sequence underflows.
    """
    unrolled = unroll(network, observed, evidence, inputs)
    given = {f"{name}@{t}": int(v) for name in inputs for t, v in enumerate(evidence.inputs[name])}
    answers = []
    log_joint = 0.0
    for t in range(len(evidence)):
        seen = {node: v for node, v in given.items() if int(node.rsplit("@", 1)[1]) <= t}
        found = {f"{ve_name(key)}@{t}": 1 for key in observed}
        scale = [evidence.likelihoods[key][t].max() for key in observed]
        probability = _probability(unrolled, found, seen)
        if probability > 0:
            given |= found
            seen |= found
            log_joint += math.log(probability)
        _check_representable(probability, log_joint)
        marginals = {name: _marginal(unrolled, f"{name}@{t}", seen) for name in hidden}
        answers.append((probability, scale, marginals))
    return _beliefs(hidden, answers)


def _check_representable(probability: float, log_joint: float) -> None:
    """pgmpy multiplies everything out: refuse where a zero may be an underflow."""
    if log_joint < (-500 if probability > 0 else -250):
        raise InputError("the sequence is too improbable for the oracle; use fewer frames")


def oracle_assumed_density(
    network: DynamicBayesianNetwork,
    hidden: Sequence[str],
    observed: Sequence[Observed],
    evidence: Evidence,
    inputs: Sequence[str] = (),
) -> Beliefs:
    """The assumed-density filter: as `oracle_filter`, but after each frame the joint belief is
    replaced by the product of the marginals of the nodes with an edge across the slices
    (Boyen and Koller 1998; section "Inference")."""
    persistent = {str(v[0]) for edge in network.edges() if edge[0][1] != edge[1][1] for v in edge}
    before: dict[str, FloatArray] = {}
    answers = []
    for t in range(len(evidence)):
        frame = evidence.take(slice(t, t + 1))
        if t == 0:
            model, now = unroll(network, observed, frame, inputs), 0
        else:
            model, now = _two_slices(network, observed, frame, inputs, before), 1
        seen = {f"{name}@{now}": int(frame.inputs[name][0]) for name in inputs}
        found = {f"{ve_name(key)}@{now}": 1 for key in observed}
        scale = [frame.likelihoods[key][0].max() for key in observed]
        probability = _probability(model, found, seen)
        if probability > 0:
            seen |= found
        marginals = {n: _marginal(model, f"{n}@{now}", seen) for n in {*hidden, *persistent}}
        before = {name: marginals[name] for name in persistent}
        answers.append((probability, scale, marginals))
    return _beliefs(hidden, answers)


def oracle_smooth(
    network: DynamicBayesianNetwork,
    hidden: Sequence[str],
    observed: Sequence[Observed],
    evidence: Evidence,
    inputs: Sequence[str] = (),
    lag: int | None = None,
) -> Beliefs:
    """P(node | evidence of all frames), or up to `lag` frames later, for every hidden node and
    frame. Frames that `oracle_filter` flags are left out as there; flags and log evidence are
    its."""
    filtered = oracle_filter(network, hidden, observed, evidence, inputs)
    unrolled = unroll(network, observed, evidence, inputs)
    n_frames = len(evidence)
    marginals: dict[str, list[FloatArray]] = {name: [] for name in hidden}
    for t in range(n_frames):
        last = n_frames - 1 if lag is None else min(t + lag, n_frames - 1)
        given = {f"{n}@{k}": int(evidence.inputs[n][k]) for n in inputs for k in range(last + 1)}
        for k in np.flatnonzero(~filtered.is_impossible[: last + 1]):
            given |= {f"{ve_name(key)}@{k}": 1 for key in observed}
        for name in hidden:
            marginals[name].append(_marginal(unrolled, f"{name}@{t}", given))
    return Beliefs(
        np.arange(n_frames),
        {name: np.stack(values) for name, values in marginals.items()},
        filtered.log_evidence,
        filtered.is_impossible,
    )


def unroll(
    network: DynamicBayesianNetwork,
    observed: Sequence[Observed],
    evidence: Evidence,
    inputs: Sequence[str] = (),
) -> DiscreteBayesianNetwork:
    """The network over all frames of the evidence, with it in the virtual-evidence nodes."""
    cpds = []
    for t in range(len(evidence)):
        for cpd in _slice_cpds(network, 0 if t == 0 else 1, {ve_name(k) for k in observed}, inputs):
            cpds.append(_renamed(cpd, t))
        cpds += [_likelihood_cpd(key, evidence.likelihoods[key][t], t) for key in observed]
        cpds += _input_cpds(network, inputs, t)
    return _network(cpds)


def _two_slices(
    network: DynamicBayesianNetwork,
    observed: Sequence[Observed],
    frame: Evidence,
    inputs: Sequence[str],
    before: Mapping[str, FloatArray],
) -> DiscreteBayesianNetwork:
    """Slice 0 holds the product of the marginals `before`, slice 1 the frame and its evidence."""
    with quiet():
        from pgmpy.factors.discrete import TabularCPD

        cpds = [
            TabularCPD(f"{name}@0", len(values), (values / values.sum()).reshape(-1, 1))
            for name, values in before.items()
        ]
    for cpd in _slice_cpds(network, 1, {ve_name(k) for k in observed}, inputs):
        cpds.append(_renamed(cpd, 1))
    cpds += [_likelihood_cpd(key, frame.likelihoods[key][0], 1) for key in observed]
    cpds += _input_cpds(network, inputs, 1)
    return _network(cpds)


def _slice_cpds(
    network: DynamicBayesianNetwork, slice_: int, left_out: set[str], inputs: Iterable[str]
) -> list[Any]:
    left_out = left_out | set(inputs)
    return [
        cpd
        for cpd in network.cpds
        if cpd.variables[0][1] == slice_ and cpd.variables[0][0] not in left_out
    ]


def _renamed(cpd: Any, frame: int) -> Any:
    """A declared CPD for one frame. `variables` and `values` share their axes, so every axis keeps
    its own name whatever the order in which the parents were declared."""
    with quiet():
        from pgmpy.factors.discrete import TabularCPD

        now = cpd.variables[0][1]
        node, *parents = (f"{name}@{frame - now + s}" for name, s in cpd.variables)
        values = np.asarray(cpd.values, dtype=np.float64)
        return TabularCPD(
            node,
            values.shape[0],
            values.reshape(values.shape[0], -1),
            evidence=parents,
            evidence_card=list(values.shape[1:]),
        )


def _likelihood_cpd(key: Observed, likelihood: FloatArray, frame: int) -> Any:
    """P(virtual evidence | the observed nodes): likelihood over its maximum for 1."""
    with quiet():
        from pgmpy.factors.discrete import TabularCPD

        names = (key,) if isinstance(key, str) else key
        largest = likelihood.max()
        share = (likelihood / largest if largest > 0 else likelihood).reshape(-1)
        return TabularCPD(
            f"{ve_name(key)}@{frame}",
            2,
            np.stack([1 - share, share]),
            evidence=[f"{name}@{frame}" for name in names],
            evidence_card=list(likelihood.shape),
        )


def _input_cpds(network: DynamicBayesianNetwork, inputs: Iterable[str], frame: int) -> list[Any]:
    """Inputs are always given, so their own distribution must not matter: uniform."""
    with quiet():
        from pgmpy.factors.discrete import TabularCPD

        size = {cpd.variables[0][0]: cpd.cardinality[0] for cpd in network.cpds}
        return [
            TabularCPD(f"{name}@{frame}", size[name], np.full((size[name], 1), 1 / size[name]))
            for name in inputs
        ]


def _network(cpds: Sequence[Any]) -> DiscreteBayesianNetwork:
    with quiet():
        from pgmpy.models import DiscreteBayesianNetwork

        model = DiscreteBayesianNetwork()
        model.add_nodes_from([cpd.variables[0] for cpd in cpds])
        for cpd in cpds:
            model.add_edges_from([(parent, cpd.variables[0]) for parent in cpd.variables[1:]])
        model.add_cpds(*cpds)
        model.check_model()
        return model


def _probability(
    model: DiscreteBayesianNetwork, found: Mapping[str, int], given: Mapping[str, int]
) -> float:
    """P(found | given)."""
    factor = _query(model, list(found), given)
    return float(factor.get_value(**found))


def _marginal(model: DiscreteBayesianNetwork, node: str, given: Mapping[str, int]) -> FloatArray:
    return np.asarray(_query(model, [node], given).values, dtype=np.float64)


def _query(model: DiscreteBayesianNetwork, nodes: list[str], given: Mapping[str, int]) -> Any:
    with quiet():
        from pgmpy.inference import VariableElimination

        return VariableElimination(model).query(nodes, evidence=dict(given), show_progress=False)


def _beliefs(
    hidden: Sequence[str],
    answers: Sequence[tuple[float, Sequence[float], Mapping[str, FloatArray]]],
) -> Beliefs:
    is_impossible = np.array([not p > 0 for p, _, _ in answers], dtype=bool)
    log_evidence = np.array(
        [math.log(p) + sum(map(math.log, scale)) if p > 0 else 0.0 for p, scale, _ in answers]
    )
    return Beliefs(
        np.arange(len(answers)),
        {name: np.stack([marginals[name] for _, _, marginals in answers]) for name in hidden},
        log_evidence,
        is_impossible,
    )

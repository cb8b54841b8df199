"""The same filter by others. Each gets the network's arrays and the evidence vectors, makes the
likelihoods of the states from these, filters, and ends with what ours ends with: the belief over
lanes (T, n). None where the package is not installed.

Left out of what is timed: fitting the arrays to the package's conventions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import numpy as np

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.types import Evidence, FloatArray, IntArray

Filter = Callable[[], FloatArray]


def blocks_of(compiled: Compiled, evidence: Evidence) -> list[FloatArray]:
    """The evidence (T, K) of each observed node, or tuple of them."""
    values = [evidence.likelihoods[group.observed] for group in compiled.groups]
    return [np.ascontiguousarray(v.reshape(len(v), -1)) for v in values]


def emissions_of(compiled: Compiled) -> list[FloatArray | None]:
    """The emission (S, K) of each, None where the evidence is about the states themselves."""
    emissions = [group.emission for group in compiled.groups]
    return [None if is_identity(e) else e for e in emissions]


def is_identity(emission: FloatArray) -> bool:
    """Whether a state is one column's own."""
    return emission.shape[0] == emission.shape[1] and bool(
        (emission == np.eye(len(emission))).all()
    )


def state_likelihoods(
    emissions: Sequence[FloatArray | None], blocks: Sequence[FloatArray]
) -> FloatArray:
    """(T, S): one matrix product per observed node; numpy's arrays or jax's."""
    factors = [v if e is None else v @ e.T for e, v in zip(emissions, blocks, strict=True)]
    product = factors[0]
    for factor in factors[1:]:
        product = product * factor
    return product


def lanes_of(states: FloatArray, n_lanes: int) -> FloatArray:
    """(T, S) -> (T, n): two values of the sensor, for each all lanes or all places on the road."""
    half = states.shape[1] // 2
    places = states[:, :half] + states[:, half:]
    return places if half == n_lanes else places.reshape(len(states), n_lanes, -1).sum(axis=2)


def hmmlearn_filter(
    compiled: Compiled, evidence: Evidence, u: int = 0, *, in_logs: bool
) -> Filter | None:
    """hmmlearn's C++ forward pass, on log likelihoods (its default) or with scaling."""
    try:
        from hmmlearn import _hmmc
    except ImportError:
        return None
    prior, transition = compiled.prior[u].copy(), compiled.transition[u].copy()
    emissions, blocks = emissions_of(compiled), blocks_of(compiled, evidence)
    n_lanes = compiled.cardinality["Lane"]

    def scaling() -> FloatArray:
        likelihoods = state_likelihoods(emissions, blocks)
        # The lattice of this pass is scaled to a sum of one in each frame: it is the belief.
        return lanes_of(_hmmc.forward_scaling(prior, transition, likelihoods)[1], n_lanes)

    def logs() -> FloatArray:
        likelihoods = np.log(state_likelihoods(emissions, blocks))
        lattice = _hmmc.forward_log(prior, transition, likelihoods)[1]
        # Joint log probabilities; the largest is subtracted, or they would underflow.
        lanes = lanes_of(np.exp(lattice - lattice.max(axis=1, keepdims=True)), n_lanes)
        return lanes / lanes.sum(axis=1, keepdims=True)

    return logs if in_logs else scaling


#: hmmlearn's two implementations.
HMMLEARN = {
    "hmmlearn, C++ forward pass on log likelihoods": partial(hmmlearn_filter, in_logs=True),
    "hmmlearn, C++ forward pass with scaling": partial(hmmlearn_filter, in_logs=False),
}


def dynamax_filter(compiled: Sequence[Compiled], evidence: Evidence, u: int = 0) -> Filter | None:
    """dynamax's filter, compiled, with double precision; several networks side by side (vmap),
    (P, T, n), one alone as (T, n).

    It lifts probabilities below 1e-15 to that (`_normalize`), which now and then shows.
    """
    try:
        import jax
        from dynamax.hidden_markov_model import hmm_filter
    except ImportError:
        return None
    jax.config.update("jax_enable_x64", True)
    jnp = jax.numpy

    n_lanes = compiled[0].cardinality["Lane"]

    def one(prior, transition, emissions, blocks):  # type: ignore[no-untyped-def]
        log_likelihoods = jnp.log(state_likelihoods(emissions, blocks))
        return lanes_of(hmm_filter(prior, transition, log_likelihoods).filtered_probs, n_lanes)

    prior = np.stack([c.prior[u] for c in compiled])
    transition = np.stack([c.transition[u] for c in compiled])
    emissions = [
        None if each[0] is None else np.stack(each)
        for each in zip(*map(emissions_of, compiled), strict=True)
    ]
    given = [prior, transition, emissions]
    if len(compiled) == 1:
        run = jax.jit(one)
        given = jax.tree.map(lambda array: array[0], given)
    else:
        run = jax.jit(jax.vmap(one, in_axes=(0, 0, 0, None)))
    on_device = jax.tree.map(jnp.asarray, [*given, blocks_of(compiled[0], evidence)])
    return lambda: jax.block_until_ready(run(*on_device))


def dynamax_gradient(
    compiled: Compiled, evidence: Evidence, lane: IntArray
) -> Callable[[], FloatArray]:
    """The gradient of the log-loss of the lane by the logarithms of all tables, flattened in the
    order of `places`: automatic differentiation through dynamax's filter."""

    @cache
    def made() -> Callable[[], Any]:
        import jax
        from dynamax.hidden_markov_model import hmm_filter

        jax.config.update("jax_enable_x64", True)
        jnp = jax.numpy
        blocks = blocks_of(compiled, evidence)
        used = np.flatnonzero(lane >= 0)
        nodes = dict.fromkeys(
            (n, 1) if n in compiled.one_table else (n, s) for n, s in compiled.places
        )

        def loss(logs: list[Any]) -> Any:
            tables = dict(zip(nodes, logs, strict=True))
            arrays: dict[Any, Any] = {}
            for (name, s), place in compiled.places.items():
                table = tables[(name, 1) if name in compiled.one_table else (name, s)]
                arrays[place.target] = arrays.get(place.target, 0.0) + table[place.indices]
            emissions = [jnp.exp(arrays[g]) for g in range(len(blocks))]
            likelihood = jnp.log(state_likelihoods(emissions, blocks))
            prior = jnp.exp(arrays["prior"][0])
            moves = jnp.exp(arrays["transition"][0])
            beliefs = hmm_filter(prior, moves, likelihood).filtered_probs
            agrees = compiled.node_value["Lane"][None] == lane[used, None]
            return -jnp.log((beliefs[used] * agrees).sum(axis=1)).sum()

        run = jax.jit(jax.grad(loss))
        logs = [jnp.log(compiled.tables[node].values) for node in nodes]
        return lambda: jax.block_until_ready(run(logs))

    return lambda: np.concatenate([np.ravel(each) for each in made()()])


def hmmlearn_chain(given: Sequence[FloatArray], **settings: Any) -> Any:
    """hmmlearn's model. given: of the first frame (S,), transition (S, S), emission (S, K)."""
    from hmmlearn.hmm import CategoricalHMM

    chain = CategoricalHMM(len(given[0]), n_features=given[2].shape[1], **settings)
    chain.startprob_, chain.transmat_, chain.emissionprob_ = map(np.copy, given)
    return chain

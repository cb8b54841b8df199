"""The same filter by others. Each gets the network's arrays and the evidence vectors, makes the
likelihoods of the states from these, filters, and ends with what ours ends with: the belief over
lanes (T, n). None where the package is not installed.

Left out of what is timed: fitting the arrays to the package's conventions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.types import Evidence, FloatArray

Filter = Callable[[], FloatArray]


def state_likelihoods(compiled: Compiled, evidence: Evidence) -> FloatArray:
    """(T, S): one matrix product per observed node."""
    first, second = compiled.groups
    return (evidence.likelihoods["DetectorOutput"] @ first.emission.T) * (
        evidence.likelihoods["WOR"] @ second.emission.T
    )


def lanes_of(states: FloatArray) -> FloatArray:
    """(T, 8) -> (T, 4): SensorState, which varies fastest, summed out."""
    return states[:, ::2] + states[:, 1::2]


def hmmlearn_scaling(compiled: Compiled, evidence: Evidence) -> Filter | None:
    """hmmlearn's C++ forward pass on likelihoods (`implementation="scaling"`)."""
    try:
        from hmmlearn import _hmmc
    except ImportError:
        return None
    prior, transition = compiled.prior[0].copy(), compiled.transition[0].copy()

    def run() -> FloatArray:
        likelihoods = state_likelihoods(compiled, evidence)
        # The lattice of this pass is scaled to a sum of one in each frame: it is the belief.
        return lanes_of(_hmmc.forward_scaling(prior, transition, likelihoods)[1])

    return run


def hmmlearn_log(compiled: Compiled, evidence: Evidence) -> Filter | None:
    """hmmlearn's C++ forward pass on log likelihoods (`implementation="log"`, its default)."""
    try:
        from hmmlearn import _hmmc
    except ImportError:
        return None
    prior, transition = compiled.prior[0].copy(), compiled.transition[0].copy()

    def run() -> FloatArray:
        likelihoods = np.log(state_likelihoods(compiled, evidence))
        lattice = _hmmc.forward_log(prior, transition, likelihoods)[1]
        # Joint log probabilities; the largest is subtracted, or they would underflow.
        lanes = lanes_of(np.exp(lattice - lattice.max(axis=1, keepdims=True)))
        return lanes / lanes.sum(axis=1, keepdims=True)

    return run


def dynamax_filter(compiled: Sequence[Compiled], evidence: Evidence) -> Filter | None:
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

    def one(prior, transition, first, second, detector, wor):  # type: ignore[no-untyped-def]
        log_likelihoods = jnp.log((detector @ first.T) * (wor @ second.T))
        return lanes_of(hmm_filter(prior, transition, log_likelihoods).filtered_probs)

    arrays = [
        np.stack([c.prior[0] for c in compiled]),
        np.stack([c.transition[0] for c in compiled]),
        np.stack([c.groups[0].emission for c in compiled]),
        np.stack([c.groups[1].emission for c in compiled]),
    ]
    if len(compiled) == 1:
        run = jax.jit(one)
        arrays = [array[0] for array in arrays]
    else:
        run = jax.jit(jax.vmap(one, in_axes=(0, 0, 0, 0, None, None)))
    arrays += [evidence.likelihoods["DetectorOutput"], evidence.likelihoods["WOR"]]
    on_device = [jnp.asarray(array) for array in arrays]
    return lambda: jax.block_until_ready(run(*on_device))

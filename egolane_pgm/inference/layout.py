"""How evidence and joint states lie in the arrays that the kernels work on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from egolane_pgm.inference.compile import Compiled
from egolane_pgm.inference.kernels.banded import MIN_STATES, Band, find_band
from egolane_pgm.types import Evidence, FloatArray, InputError, IntArray, Observed


@dataclass(frozen=True)
class Layout:
    """The arrays of a network for the kernels, besides its tables and whatever the evidence.

    parts: the hidden nodes, those of the joint state first, and the columns of each in `indicator`.
    indicator (S, M): joint beliefs (T, S) times this are the marginals of these nodes, one behind
        the other (T, M).
    column (N, S): the values of all nodes of the joint state are numbered through; this is the
        number of each node's value in each joint state. columns: the same as a tuple.
    emissions: for each group of observed nodes its emission table, transposed, (K, S).
    only: for each group the one column that each joint state shows for certain (S,), or None where
        a state may show several.
    shapes: the cardinalities of each observed key.
    band: the transition, if it is a banded one.
    """

    parts: Mapping[str, slice]
    indicator: FloatArray
    column: IntArray
    columns: tuple[tuple[int, ...], ...]
    emissions: tuple[FloatArray, ...]
    only: tuple[IntArray | None, ...]
    shapes: Mapping[Observed, tuple[int, ...]]
    band: Band | None


@lru_cache(maxsize=16)
def layout(compiled: Compiled) -> Layout:
    """The layout of a network. Remembered, since an online filter asks for it in every frame."""
    size = compiled.cardinality
    in_state = [name for name in compiled.state_nodes if name in compiled.hidden]
    parts, indicator, start = {}, [], 0
    for name in (*in_state, *compiled.functions):
        parts[name] = slice(start, start + size[name])
        start += size[name]
        indicator.append(compiled.node_value[name][:, None] == np.arange(size[name]))
    column = np.empty((len(compiled.state_nodes), compiled.n_states), dtype=np.int64)
    start = 0
    for k, name in enumerate(compiled.state_nodes):
        column[k] = start + compiled.node_value[name]
        start += size[name]
    emissions, only, shapes = [], [], {}
    for group in compiled.groups:
        emissions.append(np.ascontiguousarray(group.emission.T))
        is_certain = ((group.emission == 0.0) | (group.emission == 1.0)).all()
        only.append(group.emission.argmax(axis=1) if is_certain else None)
        for key, axes in zip(group.observed, group.axes, strict=True):
            shapes[key] = tuple(group.sizes[k] for k in axes)
    return Layout(
        parts,
        np.concatenate(indicator, axis=1, dtype=np.float64),
        column,
        tuple(map(tuple, column.tolist())),
        tuple(emissions),
        tuple(only),
        shapes,
        find_band(compiled) if compiled.n_states >= MIN_STATES else None,
    )


def marginals_of(compiled: Compiled, joint: FloatArray) -> dict[str, FloatArray]:
    """The marginals of every hidden node, (T, cardinality) each, of joint beliefs (T, S)."""
    arrays = layout(compiled)
    marginals = joint @ arrays.indicator
    return {name: marginals[:, part] for name, part in arrays.parts.items()}


def evidence_blocks(
    compiled: Compiled, evidence: Evidence, frames: slice = slice(None)
) -> list[FloatArray]:
    """The evidence of each group of observed nodes in some frames, (T, K): the product over the
    group's keys for all values of its nodes. The evidence fits the network (`joint_input`)."""
    blocks = []
    for group in compiled.groups:
        block = evidence.likelihoods[group.observed[0]][frames]
        if len(group.observed) > 1:
            block = np.ones((len(block), *group.sizes))
            for key, axes in zip(group.observed, group.axes, strict=True):
                # The evidence's axes in the order of the group's, then 1 where it says nothing.
                shape = [size if k in axes else 1 for k, size in enumerate(group.sizes)]
                values = evidence.likelihoods[key][frames].transpose(0, *(1 + np.argsort(axes)))
                block *= values.reshape(-1, *shape)
        rows = block.reshape(len(block), math.prod(group.sizes))
        blocks.append(np.ascontiguousarray(rows, dtype=np.float64))
    return blocks


def check_keys(compiled: Compiled, evidence: Evidence) -> None:
    """Raise InputError, naming the node, where evidence and network do not fit each other."""
    if not isinstance(evidence, Evidence):
        raise InputError(
            f"evidence: needs an Evidence, not a {type(evidence).__name__}: Evidence(...) of"
            " likelihoods, or Evidence.hard(...) of what was observed"
        )
    shapes = layout(compiled).shapes
    for what, needed, given in (
        ("observed", shapes, evidence.likelihoods),
        ("input", compiled.inputs, evidence.inputs),
    ):
        for key in needed:
            if key not in given:
                raise InputError(f"{what} node {key}: the evidence has nothing for it")
        for key in given:
            if key not in needed:
                raise InputError(f"evidence for {key}: the graph has no such {what} node")
    for key, values in evidence.likelihoods.items():
        if values.shape[1:] != shapes[key]:
            needs = (len(evidence), *shapes[key])
            raise InputError(f"evidence for {key}: shape {values.shape}, the graph needs {needs}")
    for name, index in evidence.inputs.items():
        if len(index) and not 0 <= index.min() <= index.max() < compiled.cardinality[name]:
            raise InputError(f"input {name}: outside 0..{compiled.cardinality[name] - 1}")


def joint_input(compiled: Compiled, evidence: Evidence) -> IntArray:
    """(T,): which joint value of the input nodes each frame has; 0 without inputs.

    Raises InputError as `check_keys`.
    """
    check_keys(compiled, evidence)
    joint = np.zeros(len(evidence), dtype=np.int64)
    for name in compiled.inputs:
        joint = joint * compiled.cardinality[name] + evidence.inputs[name]
    return joint

"""How evidence and joint states lie in the arrays that the kernels work on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate, pairwise

import numpy as np

from egolane_pgm.inference.compile import Compiled, Group
from egolane_pgm.inference.kernels.banded import Band, find_band
from egolane_pgm.types import BoolArray, Evidence, FloatArray, InputError, IntArray, Observed

#: With more joint states than this, sums along the axes are quicker than a product of matrices.
MAX_MATRIX_STATES = 256


@dataclass(frozen=True)
class PosteriorEvidence(Evidence):
    """Evidence that is read by Jeffrey's rule (`jeffrey`). A row says how probable each value of
    the observed node is after the frame, up to a factor; a row of nothing but ones says nothing."""

    def take(self, frames: slice | IntArray | BoolArray) -> PosteriorEvidence:
        """The evidence of some frames, in order."""
        some = super().take(frames)
        return PosteriorEvidence(some.likelihoods, some.inputs)


@dataclass(frozen=True)
class FilterState:
    """What an online filter carries from frame to frame.

    joint (S,): the belief after the last frame; under assumed density the product of its marginals.
    """

    joint: FloatArray


@dataclass(frozen=True)
class Layout:
    """What the kernels need to know of a network, besides its tables and whatever the evidence.

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
    in_state = [name for name in compiled.state_nodes if name in compiled.hidden]
    nodes = (*in_state, *compiled.functions)
    size = compiled.cardinality
    is_value = [compiled.node_value[name][:, None] == np.arange(size[name]) for name in nodes]
    starts = accumulate((size[name] for name in compiled.state_nodes), initial=0)
    numbers = zip(compiled.state_nodes, starts, strict=False)
    column = np.array([start + compiled.node_value[n] for n, start in numbers], dtype=np.int64)
    ends = pairwise(accumulate((size[name] for name in nodes), initial=0))
    return Layout(
        {name: slice(*each) for name, each in zip(nodes, ends, strict=True)},
        np.concatenate(is_value, axis=1, dtype=np.float64),
        column,
        tuple(map(tuple, column.tolist())),
        tuple(np.ascontiguousarray(group.emission.T) for group in compiled.groups),
        tuple(_only_column(group.emission) for group in compiled.groups),
        {
            key: tuple(size[name] for name in ((key,) if isinstance(key, str) else key))
            for key in compiled.observed
        },
        find_band(compiled),
    )


def _only_column(emission: FloatArray) -> IntArray | None:
    is_one = emission == 1.0
    if np.count_nonzero(emission) == len(emission) and is_one.any(axis=1).all():
        return np.asarray(is_one.argmax(axis=1))
    return None


def marginals_of(compiled: Compiled, joint: FloatArray) -> dict[str, FloatArray]:
    """The marginals of every hidden node, (T, cardinality) each, of joint beliefs (T, S)."""
    arrays, size = layout(compiled), compiled.cardinality
    if compiled.n_states <= MAX_MATRIX_STATES:
        marginals = joint @ arrays.indicator
        return {name: marginals[:, part] for name, part in arrays.parts.items()}
    nodes = {}
    for name, part in arrays.parts.items():
        if name in compiled.state_nodes:
            k = compiled.state_nodes.index(name)
            before = math.prod(size[n] for n in compiled.state_nodes[:k])
            after = compiled.n_states // (before * size[name])
            by_value = joint.reshape(len(joint), before, size[name], after)
            nodes[name] = by_value.sum(axis=(1, 3))
        else:
            nodes[name] = joint @ arrays.indicator[:, part]
    return nodes


def evidence_blocks(
    compiled: Compiled, evidence: Evidence, frames: slice | IntArray = slice(None)
) -> list[FloatArray]:
    """The evidence of each group of observed nodes in some frames, (T, K).

    Raises InputError naming an observed node without evidence, evidence without a node, or a
    wrong shape; and for evidence that is read by Jeffrey's rule.
    """
    if isinstance(evidence, PosteriorEvidence):
        raise InputError(
            "evidence read by Jeffrey's rule is no likelihood: only the filters exact and"
            " assumed_density take it; use evidence_reading soft or hard here"
        )
    check_keys(compiled, evidence)
    return [
        np.ascontiguousarray(_group_evidence(group, evidence.likelihoods, frames), dtype=np.float64)
        for group in compiled.groups
    ]


def check_keys(compiled: Compiled, evidence: Evidence) -> None:
    """Raise InputError, naming the node, where evidence and network do not fit each other."""
    shapes = layout(compiled).shapes
    for key in shapes:
        if key not in evidence.likelihoods:
            raise InputError(f"observed node {key}: the evidence has nothing for it")
    for key, values in evidence.likelihoods.items():
        if key not in shapes:
            raise InputError(f"evidence for {key}: the graph does not observe such a node")
        if values.shape[1:] != shapes[key]:
            needs = (len(evidence), *shapes[key])
            raise InputError(f"evidence for {key}: shape {values.shape}, the graph needs {needs}")
    for name in compiled.inputs:
        if name not in evidence.inputs:
            raise InputError(f"input node {name}: the evidence has nothing for it")
    for name, index in evidence.inputs.items():
        if name not in compiled.inputs:
            raise InputError(f"input {name}: the graph has no such input node")
        ends = index if len(index) < 2 else (index.min(), index.max())
        if not all(0 <= end < compiled.cardinality[name] for end in ends):
            raise InputError(f"input {name}: outside 0..{compiled.cardinality[name] - 1}")


def _group_evidence(
    group: Group,
    likelihoods: Mapping[Observed, FloatArray],
    frames: slice | IntArray = slice(None),
    join: np.ufunc = np.multiply,
) -> FloatArray:
    """(T, K): the product of the group's evidence over all its nodes' values."""
    if len(group.observed) == 1:
        values = likelihoods[group.observed[0]][frames]
        return values.reshape(len(values), math.prod(group.sizes))
    n_frames = len(likelihoods[group.observed[0]][frames])
    product = np.full((n_frames, *group.sizes), float(join.identity))
    for key, axes in zip(group.observed, group.axes, strict=True):
        values = likelihoods[key][frames]
        # The evidence's axes in the order of the group's, then 1 where it says nothing.
        ordered = values.transpose(0, *(1 + np.argsort(axes)))
        shape = [size if k in axes else 1 for k, size in enumerate(group.sizes)]
        product = join(product, ordered.reshape(n_frames, *shape))
    return product.reshape(n_frames, math.prod(group.sizes))


def log_blocks(
    compiled: Compiled, evidence: Evidence, frames: slice | IntArray = slice(None)
) -> list[FloatArray]:
    """The logarithms of `evidence_blocks`, of products that are no numbers too."""
    logs = {key: logarithms(values[frames]) for key, values in evidence.likelihoods.items()}
    return [_group_evidence(group, logs, join=np.add) for group in compiled.groups]


def logarithms(values: FloatArray) -> FloatArray:
    """Natural logarithms, minus infinity of zero."""
    with np.errstate(divide="ignore"):
        return np.log(values)


def joint_input(compiled: Compiled, evidence: Evidence) -> IntArray:
    """(T,): which joint value of the input nodes each frame has; 0 without inputs."""
    if not compiled.inputs:
        return np.zeros(len(evidence), dtype=np.int64)
    if len(compiled.inputs) == 1:
        return np.ascontiguousarray(evidence.inputs[compiled.inputs[0]], dtype=np.int64)
    sizes = [compiled.cardinality[name] for name in compiled.inputs]
    parts = [evidence.inputs[name] for name in compiled.inputs]
    return np.asarray(np.ravel_multi_index(parts, sizes), dtype=np.int64)

"""Some frames of a model as an ordinary pgmpy network, for queries in pgmpy."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode, Table, flat_network, uniform, ve_name
from egolane_pgm.inference.compile import Compiled, takes_any_model
from egolane_pgm.inference.filtering import joint_input, step
from egolane_pgm.types import Evidence, FloatArray, InputError, IntArray, Observed

if TYPE_CHECKING:
    from pgmpy.models import DiscreteBayesianNetwork


class Unrolled(NamedTuple):
    """Some frames as a pgmpy network.

    - network: its nodes are `Lane@17`, their values have names.
    - given: the evidence, as pgmpy's queries take it: each frame's virtual-evidence nodes are 1,
      its inputs have their values.
    """

    network: DiscreteBayesianNetwork
    given: dict[str, int | str]


@takes_any_model
def unrolled(
    compiled: Compiled,
    evidence: Evidence,
    first: int,
    last: int,
    *,
    frame_id: IntArray | None = None,
) -> Unrolled:
    """The frames `first` to `last`, both included, as a pgmpy network with their evidence.

    - evidence: T frames, of which those after `last` are not used.
    - frame_id (T,): the ids that `first` and `last` are among, 0, 1, ... by default.

    The virtual-evidence node of an observed node has P(1 | value) = the value's likelihood over the
    frame's largest one. The nodes of the frame before `first` on which later frames depend carry
    the past: their joint distribution is the belief of the filter `exact`. In pgmpy,

        network, given = unrolled(compiled, evidence, 40, 45)
        VariableElimination(network).query(["Lane@45"], evidence=given)

    gives the filter's belief of the last frame, and the smoothed belief of an earlier one. `given`
    does not contain the evidence of impossible frames, which the filter ignores.

    Raises InputError for missing frames, and for evidence that does not fit the network.

    >>> import egolane_pgm as ego
    >>> place = ego.experiments_folder() / "quickstart.yaml"
    >>> run = ego.run(place, overrides={"recording.frames": [0, 300]})
    >>> unrolled = ego.unrolled(run.model.compiled, run.evidence, 40, 41)
    >>> sorted(node for node in unrolled.network.nodes() if node.startswith("Lane@"))
    ['Lane@39', 'Lane@40', 'Lane@41']
    """
    joint_input(compiled, evidence)
    ids = np.arange(len(evidence)) if frame_id is None else frame_id
    start = _position(ids, first)
    stop = _position(ids, last) + 1
    if start >= stop:
        raise InputError(f"frames {first} to {last}: the first one comes after the last")
    state = None
    tables = []
    if start > 0:
        state, _ = step(compiled, None, evidence.take(slice(0, start)), "exact")
        tables += _past(compiled, state, int(ids[start - 1]))
    frames = evidence.take(slice(start, stop))
    _, beliefs = step(compiled, state, frames, "exact")
    given: dict[str, int | str] = {}
    if start == 0 and compiled.start is not None:
        tables.append(_seen("Lane", int(ids[0]), compiled.start, "start"))
        given[f"start@{ids[0]}"] = 1
    for t, frame in enumerate(ids[start:stop].tolist()):
        later = int(start + t > 0)
        at = {later: frame, 1 - later: int(ids[start + t - 1])}
        for (name, s), table in compiled.tables.items():
            if s == later:
                # An input is always given, even a value that its own table excludes.
                is_input = name in compiled.inputs
                values = uniform(*table.values.shape) if is_input else table.values
                parents = tuple((parent, at[ps]) for parent, ps in table.parents)
                tables.append(Table((name, frame), parents, values))
        for name in compiled.inputs:
            given[f"{name}@{frame}"] = compiled.values[name][frames.inputs[name][t]]
        for key, likelihoods in frames.likelihoods.items():
            tables.append(_seen(key, frame, likelihoods[t]))
            if not beliefs.is_impossible[t]:
                given[f"{ve_name(key)}@{frame}"] = 1
    return Unrolled(flat_network(tables, compiled.values), given)


def _position(ids: IntArray, frame: int) -> int:
    found = np.flatnonzero(ids == frame)
    if not len(found):
        there = f"its frames are {ids[0]} to {ids[-1]}" if len(ids) else "it has no frames"
        raise InputError(f"frame {frame}: the evidence has no such frame, {there}")
    return int(found[0])


def _seen(key: Observed, frame: int, likelihood: FloatArray, name: str = "") -> Table:
    names = (key,) if isinstance(key, str) else key
    largest = likelihood.max()
    share = likelihood / largest if largest > 0 else likelihood
    values = np.stack([1 - share, share], axis=-1)
    return Table((name or ve_name(key), frame), tuple((each, frame) for each in names), values)


def _past(compiled: Compiled, state: FloatArray, frame: int) -> list[Table]:
    """The belief of a frame as tables of the nodes that the next frame depends on: of the first
    node, of the second given the first, and so on."""
    needed = {
        name
        for table in compiled.tables.values()
        for name, s in table.parents
        if s == 0 and table.node[1] == 1
    }
    joint = state.reshape([compiled.cardinality[name] for name in compiled.state_nodes])
    others = [k for k, name in enumerate(compiled.state_nodes) if name not in needed]
    joint = joint.sum(axis=tuple(others))
    nodes: list[SliceNode] = [(n, frame) for n in compiled.state_nodes if n in needed]
    up_to = [joint.sum(axis=tuple(range(k, len(nodes)))) for k in range(len(nodes) + 1)]
    tables = []
    for k, (before, now) in enumerate(pairwise(up_to)):
        total = before[..., None]
        # Rows for impossible values of the earlier nodes are never used.
        values = np.where(total > 0, now / np.where(total > 0, total, 1), 1 / now.shape[-1])
        tables.append(Table(nodes[k], tuple(nodes[:k]), values))
    return tables

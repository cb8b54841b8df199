"""Filters, smoothers, the most probable path and expected counts in decimal numbers of 60 digits
whose exponents have no end, so that nothing underflows. (Fractions do not round at all, but grow
with every frame, and are too slow for what is tried here.)

Everything is computed over the joint state of a compiled network, straight from the definitions.
Only what the package says of numbers that are too small is done here too: they are zero
(`egolane_pgm.inference.filtering`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import MAX_EMAX, MIN_EMIN, Context, Decimal, setcontext

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode
from egolane_pgm.inference.compile import Compiled, Group
from egolane_pgm.inference.expected_counts import FREE, counted_tables
from egolane_pgm.inference.kernels.filter import LEAST
from egolane_pgm.inference.layout import joint_input
from egolane_pgm.types import Beliefs, BoolArray, Evidence, FloatArray, IntArray
from tests.reference.inference import MOST

Row = list[Decimal]

setcontext(Context(prec=60, Emin=MIN_EMIN, Emax=MAX_EMAX))

#: A belief this near to LEAST is on one side of it or the other by rounding.
NEAR = Decimal("1e-9")


class Borderline(Exception):
    """A belief is so near to LEAST that rounding decides whether it is zero."""


@dataclass(frozen=True)
class Exact:
    """What `Beliefs` has, and what the smoothers need: filtered (T, S); likelihood (T, S), one
    where the evidence is left out; index (T,), the joint value of the inputs."""

    filtered: list[Row]
    likelihood: list[Row]
    index: IntArray
    log_evidence: FloatArray
    is_impossible: list[bool]


def numbers(values: FloatArray) -> Row:
    """The numbers of an array, in order."""
    return [Decimal(float(v)) for v in np.asarray(values).reshape(-1)]


def kept(row: Row, scale: Decimal = Decimal(1)) -> Row:
    """Zero below LEAST times `scale`. Raises Borderline where rounding would decide."""
    least = Decimal(LEAST) * scale
    if any(abs(value - least) < NEAR * least and least for value in row):
        raise Borderline
    return [value if value >= least else Decimal(0) for value in row]


def normalised(row: Row) -> Row:
    """Over its sum."""
    total = sum(row, Decimal(0))
    return [value / total for value in row]


def likelihoods(compiled: Compiled, evidence: Evidence) -> list[Row]:
    """P(evidence of a frame | joint state), (T, S), zero where it is LEAST over MOST of the
    frame's largest."""
    rows = []
    for t in range(len(evidence)):
        row = [Decimal(1)] * compiled.n_states
        for group in compiled.groups:
            seen = shown(group, evidence, t)
            table = [numbers(each) for each in group.emission]
            row = [
                a * sum(p * e for p, e in zip(of_state, seen, strict=True))
                for a, of_state in zip(row, table, strict=True)
            ]
        rows.append(kept(row, max(row) / Decimal(MOST)))
    return rows


def shown(group: Group, evidence: Evidence, t: int) -> Row:
    """What the evidence of a frame says of each column of the group's table."""
    seen = [Decimal(1)] * math.prod(group.sizes)
    for k, key in enumerate(group.observed):
        values = numbers(evidence.likelihoods[key][t])
        seen = [a * values[v] for a, v in zip(seen, columns(group, k), strict=True)]
    return seen


def columns(group: Group, k: int) -> list[int]:
    """The value of the group's k-th observed key in each column of its table."""
    digits = np.indices(group.sizes).reshape(len(group.sizes), -1)
    sizes = [group.sizes[axis] for axis in group.axes[k]]
    return [int(v) for v in np.ravel_multi_index([digits[a] for a in group.axes[k]], sizes)]


def moved(compiled: Compiled, u: int, joint: Row | None) -> Row:
    """The belief before a frame's evidence: the prior, or the transition from `joint`."""
    if joint is None:
        return numbers(compiled.prior[u])
    table = [numbers(row) for row in compiled.transition[u]]
    return [
        sum((p * row[s] for p, row in zip(joint, table, strict=True)), Decimal(0))
        for s in range(compiled.n_states)
    ]


def carried(compiled: Compiled, joint: Row, method: str) -> Row:
    """What goes on to the next frame."""
    if method == "exact":
        return joint
    product = [Decimal(1)] * compiled.n_states
    for name in compiled.state_nodes:
        value = compiled.node_value[name]
        share = [Decimal(0)] * compiled.cardinality[name]
        for v, p in zip(value, joint, strict=True):
            share[v] += p
        product = [p * share[v] for p, v in zip(product, value, strict=True)]
    return kept(product)


def forward(
    compiled: Compiled,
    evidence: Evidence,
    method: str = "exact",
    given: list[Row] | None = None,
    is_first: BoolArray | None = None,
) -> Exact:
    """The filter. given: the likelihoods, by default those of the evidence. is_first (T,): where a
    sequence begins, by default with the first frame only."""
    given = likelihoods(compiled, evidence) if given is None else given
    index = joint_input(compiled, evidence)
    filtered, is_impossible, log_evidence = [], [], []
    joint: Row | None = None
    for t, u in enumerate(index):
        predicted = moved(compiled, u, None if is_first is not None and is_first[t] else joint)
        weighted = [p * e for p, e in zip(predicted, given[t], strict=True)]
        is_impossible.append(not any(weighted))
        if is_impossible[t]:
            weighted, given[t] = predicted, [Decimal(1)] * compiled.n_states
        log_evidence.append(0.0 if is_impossible[t] else logarithm(sum(weighted, Decimal(0))))
        filtered.append(kept(normalised(weighted)))
        joint = carried(compiled, filtered[t], method)
    return Exact(filtered, given, index, np.array(log_evidence), is_impossible)


def smoothed(compiled: Compiled, passed: Exact, lag: int) -> list[Row]:
    """The joint belief about each frame given `lag` later ones. States that the filter takes for
    impossible are so here."""
    tables = [[numbers(row) for row in each] for each in compiled.transition]
    rows = []
    for t in range(len(passed.filtered)):
        ahead = [Decimal(1)] * compiled.n_states
        for k in range(min(t + lag, len(passed.filtered) - 1), t, -1):
            weight = [a * e for a, e in zip(ahead, passed.likelihood[k], strict=True)]
            ahead = [
                sum((p * w for p, w in zip(row, weight, strict=True)), Decimal(0)) if f else f
                for row, f in zip(tables[passed.index[k]], passed.filtered[k - 1], strict=True)
            ]
        rows.append(normalised([f * a for f, a in zip(passed.filtered[t], ahead, strict=True)]))
    return rows


def expected_counts(
    compiled: Compiled, evidence: Evidence, known: Mapping[str, IntArray], is_first: BoolArray
) -> tuple[dict[SliceNode, list[Decimal]], Exact]:
    """As `egolane_pgm.inference.expected_counts.expected_counts`, each table's counts in one row;
    and the filter's answer."""
    given = likelihoods(compiled, evidence)
    for node, value in known.items():
        is_so = (value[:, None] == compiled.node_value[node]) | (value == FREE)[:, None]
        given = [
            [e if so else Decimal(0) for e, so in zip(row, each, strict=True)]
            for row, each in zip(given, is_so, strict=True)
        ]
    passed = forward(compiled, evidence, given=given, is_first=is_first)
    n_frames, states = len(given), range(compiled.n_states)
    tables = [[numbers(row) for row in each] for each in compiled.transition]
    first = [Decimal(0)] * compiled.n_states
    moves = [[Decimal(0)] * compiled.n_states for _ in states]
    of_group = [[[Decimal(0)] * g.emission.shape[1] for _ in states] for g in compiled.groups]
    ahead = [Decimal(1)] * compiled.n_states
    for t in range(n_frames - 1, -1, -1):
        now = normalised([f * a for f, a in zip(passed.filtered[t], ahead, strict=True)])
        if not passed.is_impossible[t]:
            for group, counts in zip(compiled.groups, of_group, strict=True):
                seen = shown(group, evidence, t)
                for s in states:
                    both = [p * e for p, e in zip(numbers(group.emission[s]), seen, strict=True)]
                    shares = normalised(both) if now[s] else both
                    counts[s] = [c + now[s] * p for c, p in zip(counts[s], shares, strict=True)]
        if is_first[t] or t == 0:
            first = [a + b for a, b in zip(first, now, strict=True)]
            ahead = [Decimal(1)] * compiled.n_states
            continue
        before, into = passed.filtered[t - 1], tables[passed.index[t]]
        weight = [a * e for a, e in zip(ahead, given[t], strict=True)]
        pairs = [[before[r] * into[r][s] * weight[s] for s in states] for r in states]
        total = sum(map(sum, pairs), Decimal(0))
        moves = [[moves[r][s] + pairs[r][s] / total for s in states] for r in states]
        ahead = [
            sum((into[r][s] * weight[s] for s in states), Decimal(0)) if before[r] else Decimal(0)
            for r in states
        ]
    counts = {n: [Decimal(0)] * t.values.size for n, t in counted_tables(compiled).items()}
    for (name, s), place in compiled.places.items():
        node = (name, 1) if compiled.has_one_table(name) else (name, s)
        if node not in counts:
            continue
        array = {"prior": [first], "transition": moves}.get(place.kind) or of_group[place.group]
        cells = [cell for row in array for cell in row]
        shape = {"prior": (1, len(first)), "transition": (1, len(first), len(first))}.get(
            place.kind, (len(first), len(array[0]))
        )
        to = np.ravel_multi_index(
            tuple(np.broadcast_to(i, shape) for i in place.indices),
            compiled.tables[name, s].values.shape,
        )
        for cell, k in zip(cells, to.reshape(-1), strict=True):
            counts[node][k] += cell
    return counts, passed


def best_probability(compiled: Compiled, passed: Exact) -> float:
    """The logarithm of the probability of the most probable path with the evidence."""
    tables = [[numbers(row) for row in each] for each in compiled.transition]
    score = [
        p * e
        for p, e in zip(numbers(compiled.prior[passed.index[0]]), passed.likelihood[0], strict=True)
    ]
    for t in range(1, len(passed.likelihood)):
        table = tables[passed.index[t]]
        score = [
            max(a * row[s] for a, row in zip(score, table, strict=True)) * passed.likelihood[t][s]
            for s in range(compiled.n_states)
        ]
    return logarithm(max(score))


def logarithm(value: Decimal) -> float:
    """Natural; of numbers that no float holds too."""
    return float(value.ln())


def beliefs(compiled: Compiled, passed: Exact, joint: Sequence[Row] | None = None) -> Beliefs:
    """The marginals of beliefs over the joint state, the filter's by default."""
    rows = passed.filtered if joint is None else joint
    marginals = {}
    for name in compiled.hidden:
        table = np.zeros((len(rows), compiled.cardinality[name]))
        for t, row in enumerate(rows):
            for v in range(compiled.cardinality[name]):
                of_value = compiled.node_value[name] == v
                table[t, v] = float(sum((row[s] for s in np.flatnonzero(of_value)), Decimal(0)))
        marginals[name] = table
    flags = np.array(passed.is_impossible, dtype=bool)
    return Beliefs(np.arange(len(rows)), marginals, passed.log_evidence, flags)

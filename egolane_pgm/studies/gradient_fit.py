"""Fits by gradient: tables, or numbers from which they follow, that make the known values most
probable under the filter.

EM describes evidence and labels together; this fit minimises what a held-out score measures, the
log-loss of the filter. Neighbouring frames are nearly the same frame, so `block` of them weigh as
much as one against the prior. L-BFGS finds the minimum from the exact gradient
(`inference.gradient`). Numbers can be fitted to evidence and labels together, too: the expected
counts of EM are the gradient of the log evidence (Fisher's identity).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from egolane_pgm.graphs.cpds import SliceNode, Table
from egolane_pgm.inference.compile import Compiled, counted_tables, with_tables
from egolane_pgm.inference.expected_counts import all_counts
from egolane_pgm.inference.gradient import log_loss_gradient
from egolane_pgm.studies.em import Data, Learned, strength_of, with_learned
from egolane_pgm.studies.space import OPEN_END
from egolane_pgm.studies.structures import NOT_REPEATED, repetition
from egolane_pgm.types import BoolArray, FloatArray

#: The smallest entry above zero of a table.
SMALLEST_ENTRY = float(np.finfo(np.float64).tiny)

#: The step of central differences, in the coordinates of the numbers.
STEP = 1e-5

#: A fit starts at this distance from the bounds of a number, or farther, as a share of the range.
INSIDE = 1e-3

#: The step of the second derivatives, in the coordinates of the numbers.
HESSIAN_STEP = 1e-3

#: Number of draws of the posterior of numbers.
DRAWS = 200

#: Tables by their node: their gradients by the logarithm of each entry.
Gradient = Mapping[SliceNode, FloatArray]

#: Coordinates (D,), and the gradient of the log-loss per block -> minus the log prior, and the
#: gradient of the sum of both by the coordinates.
Descent = Callable[[FloatArray, Gradient], tuple[float, FloatArray]]

#: From numbers (D,) to the tables of the network, of both slices.
TablesOf = Callable[[FloatArray], Sequence[Table]]


@dataclass(frozen=True)
class _Rows:
    """The coordinates of a table: the logarithms of its entries, any constant added to a row; then,
    in the compact form, the share of repetition.

    - base: the table around which the prior is, without the repetition.
    - strength: of the prior, frames per row.
    """

    base: FloatArray
    strength: float
    repeats: bool

    @property
    def ends(self) -> list[tuple[float, float]]:
        """The range of each coordinate."""
        repeated = [(NOT_REPEATED, 1 - NOT_REPEATED)] * self.repeats
        return [(-np.inf, np.inf)] * self.base.size + repeated

    def coordinates(self, values: FloatArray) -> FloatArray:
        """The coordinates of a table that does not repeat."""
        logs = np.log(np.maximum(values, SMALLEST_ENTRY)).ravel()
        return np.append(logs, [NOT_REPEATED] * self.repeats)

    def rows(self, x: FloatArray) -> FloatArray:
        """The table without the repetition. An entry stays zero or above zero."""
        allowed = self.base > 0
        logs = np.where(allowed, x[: self.base.size].reshape(self.base.shape), -np.inf)
        rows = np.exp(logs - logs.max(axis=-1, keepdims=True))
        rows /= rows.sum(axis=-1, keepdims=True)
        return np.where(allowed, np.maximum(rows, SMALLEST_ENTRY), 0.0)

    def values(self, x: FloatArray) -> FloatArray:
        """The table."""
        return repetition(self.rows(x), x[-1]) if self.repeats else self.rows(x)

    def descent(self, x: FloatArray, gradient: FloatArray) -> tuple[float, FloatArray]:
        """Minus the log prior, and the gradient (`Descent`)."""
        rows = self.rows(x)
        allowed = self.base > 0
        ratio = np.log(self.base[allowed]) - np.log(rows[allowed])
        cost = self.strength * float((self.base[allowed] * ratio).sum())
        slope = np.zeros(len(x))
        if self.repeats:
            rho = x[-1]
            full = repetition(rows, rho)
            by_entry = np.divide(gradient, full, out=np.zeros_like(full), where=full > 0)
            slope[-1] = (by_entry * (np.eye(rows.shape[-1]) - rows[..., None, :])).sum()
            gradient = (1 - rho) * by_entry.sum(axis=-2) * rows
        by_logs = gradient - rows * gradient.sum(axis=-1, keepdims=True)
        slope[: rows.size] = (by_logs + self.strength * (rows - self.base)).ravel()
        return cost, slope


def fit_tables_to_known(
    compiled: Compiled,
    data: Data,
    *,
    nodes: Sequence[str] | None = None,
    strength: float | Mapping[str, float],
    block: float,
    bases: Mapping[SliceNode, FloatArray] | None = None,
    start: Mapping[SliceNode, Table] | None = None,
    iterations: int = 200,
) -> Learned:
    """Fit the tables of a network to known values.

    - data: evidence, known values and beginnings of sequences, as for `expected_counts`.
    - nodes, strength, start: as in `em.fit_tables`; the prior of the tables is the same.
    - block: number of frames that weigh as much as one.
    - bases: tables in the compact form (`structures.repetition`), without the repetition, whose
      share has a flat prior.
    - iterations: largest number of steps of L-BFGS.
    """
    declared = counted_tables(compiled)
    bases = bases or {}
    forms: dict[SliceNode, _Rows] = {}
    for node, table in declared.items():
        if nodes is None or node[0] in nodes:
            base = bases.get(node, table.values)
            forms[node] = _Rows(base, strength_of(strength, node[0]), node in bases)
    ends = [form.ends for form in forms.values()]
    cuts = np.cumsum([0, *map(len, ends)])
    parts = dict(zip(forms, map(slice, cuts, cuts[1:]), strict=True))

    def network_of(x: FloatArray) -> Compiled:
        found = {node: forms[node].values(x[part]) for node, part in parts.items()}
        tables = {n: Table(n, declared[n].parents, values) for n, values in found.items()}
        return with_learned(compiled, tables)

    def descent(x: FloatArray, gradient: Gradient) -> tuple[float, FloatArray]:
        found = [forms[n].descent(x[part], gradient[n]) for n, part in parts.items()]
        costs, slopes = zip(*found, strict=True)
        return sum(costs), np.concatenate(slopes)

    at = {**declared, **(start or {})}
    first = [
        form.coordinates(form.base if node in bases else at[node].values)
        for node, form in forms.items()
    ]
    x, bounds = np.concatenate(first), list(chain.from_iterable(ends))
    learned, _, _ = _minimised(label_loss, network_of, descent, x, bounds, data, block, iterations)
    return learned


def fit_numbers(
    compiled: Compiled,
    data: Data,
    tables_of: TablesOf,
    start: Sequence[float],
    bounds: Sequence[tuple[float, float]],
    is_scale: Sequence[bool],
    *,
    block: float = 1,
    centre: Sequence[float] | None = None,
    iterations: int = 100,
) -> Learned:
    """Fit numbers to known values; without a `centre`, to evidence and known values together.

    The coordinate of a scale, such as sigma1, is its logarithm, that of another number the logit of
    its position within its bounds.

    - data, block, iterations: as in `fit_tables_to_known`.
    - tables_of: the tables of numbers (D,), of both slices.
    - start, bounds: of the D numbers; a start out of bounds is moved into them.
    - is_scale: which of the D numbers are scales.
    - centre: of the prior, which is normal with a standard deviation of 1 in the coordinates. None
      for the most probable numbers given evidence and known values, with a flat prior.

    The `draws` of a result with a prior are of Laplace's approximation of the posterior: a normal
    distribution in the coordinates with the second derivatives of the log posterior at its maximum.
    """
    low, high = np.array(bounds, dtype=np.float64).T
    logs = np.array(is_scale)

    def coordinates(numbers: FloatArray, margin: float = INSIDE) -> FloatArray:
        unit = np.clip((numbers - low) / (high - low), margin, 1 - margin)
        logits = np.log(unit / (1 - unit))
        return np.asarray(np.where(logs, np.log(low + unit * (high - low)), logits))

    def numbers_at(x: FloatArray) -> FloatArray:
        return np.asarray(np.where(logs, np.exp(x), low + (high - low) / (1 + np.exp(-x))))

    def tables_at(x: FloatArray) -> dict[SliceNode, FloatArray]:
        found = {}
        for table in tables_of(numbers_at(x)):
            # The axes of the compiled network, whose first frame has those of later frames.
            order = [table.parents.index(p) for p in compiled.tables[table.node].parents]
            found[table.node] = table.values.transpose(*order, len(order))
        return found

    def network_of(x: FloatArray) -> Compiled:
        found = tables_at(x).items()
        return with_tables(
            compiled, [replace(compiled.tables[n], values=values) for n, values in found]
        )

    first = coordinates(np.asarray(start))
    middle = first if centre is None else coordinates(np.asarray(centre))
    weight = 1.0

    def descent(x: FloatArray, gradient: Gradient) -> tuple[float, FloatArray]:
        now = tables_at(x)
        slope = weight * (x - middle)
        cost = weight * float(((x - middle) ** 2).sum()) / 2
        by_entry = {
            node: np.divide(g, now[node], out=np.zeros_like(g), where=now[node] > 0)
            for node, g in gradient.items()
        }
        for k, step in enumerate(STEP * np.eye(len(x))):
            up, down = tables_at(x + step), tables_at(x - step)
            moved = {node: (up[node] - down[node]) / (2 * STEP) for node in by_entry}
            slope[k] += sum(float((g * moved[node]).sum()) for node, g in by_entry.items())
        return cost, slope

    ends = list(zip(coordinates(low, OPEN_END), coordinates(high, OPEN_END), strict=True))
    loss_of = evidence_loss if centre is None else label_loss
    shared = ends, data, block, iterations
    learned, x, slope_at = _minimised(loss_of, network_of, descent, first, *shared)
    if centre is None:
        # The first fit had a prior around the start: a first step without one may end at a bound.
        weight = 0.0
        learned, x, _ = _minimised(loss_of, network_of, descent, x, *shared)
        return replace(learned, numbers=numbers_at(x))
    steps = HESSIAN_STEP * np.eye(len(x))
    hessian = np.array([slope_at(x + step) - slope_at(x - step) for step in steps])
    curvature, axes = np.linalg.eigh((hessian + hessian.T) / (4 * HESSIAN_STEP))
    # Where the log posterior is hardly curved, the prior alone counts.
    spread = 1 / np.sqrt(np.maximum(curvature, 1.0))
    normal = np.random.default_rng(0).normal(size=(DRAWS, len(x)))
    draws = np.clip(x + (normal * spread) @ axes.T, *np.array(ends).T)
    return replace(learned, numbers=numbers_at(x), draws=numbers_at(draws))


def label_loss(compiled: Compiled, data: Data) -> tuple[float, Gradient, BoolArray]:
    """The log-loss of known values, its gradient, and the impossible frames."""
    found = log_loss_gradient(compiled, *data)
    return found.loss, found.gradient, found.is_impossible


def evidence_loss(compiled: Compiled, data: Data) -> tuple[float, Gradient, BoolArray]:
    """Minus the log evidence with the known values, its gradient, and the impossible frames."""
    found = all_counts(compiled, *data)
    gradient = {node: -counts for node, counts in found.counts.items()}
    return -found.log_evidence, gradient, found.is_impossible


def _minimised(
    loss_of: Callable[[Compiled, Data], tuple[float, Gradient, BoolArray]],
    network_of: Callable[[FloatArray], Compiled],
    descent: Descent,
    start: FloatArray,
    ends: Sequence[tuple[float, float]],
    data: Data,
    block: float,
    iterations: int,
) -> tuple[Learned, FloatArray, Callable[[FloatArray], FloatArray]]:
    """Minimise a loss per block less the log prior.

    Returns the fit, its coordinates, and the gradient as a function of them.
    """
    # Slow to import.
    from scipy.optimize import minimize

    history: list[float] = []

    def loss(x: FloatArray) -> tuple[float, FloatArray]:
        value, gradient, _ = loss_of(network_of(x), data)
        cost, slope = descent(x, {node: each / block for node, each in gradient.items()})
        history.append(-value / block - cost)
        return -history[-1], slope

    options = {"maxiter": iterations}
    found = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=ends, options=options)
    network = network_of(found.x)
    _, _, is_impossible = loss_of(network, data)
    learned = Learned(network, np.array([history[0], -found.fun]), is_impossible)
    return learned, found.x, lambda x: loss(x)[1]

"""What the tests of graphs and filters share: drawing parameters, evidence and whole networks at
random, and the answer by brute force, written in plain loops over every trajectory."""

from __future__ import annotations

import functools
import importlib
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st

from egolane_pgm.graphs.cpds import Table, declare, dynamics, previous, prior, within
from egolane_pgm.inference.compile import Compiled, compile_network, with_tables
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.parameters import Parameter, Parameters, Value, resolve_parameters
from egolane_pgm.plugins import plugin_names
from egolane_pgm.types import Beliefs, Evidence, Observed

METHODS = ("assumed_density", "exact")

seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=20, deadline=None)


def graph_names() -> list[str]:
    """Every graph of the package."""
    return plugin_names("graphs")


def graph(name: str) -> ModuleType:
    return importlib.import_module(f"egolane_pgm.graphs.{name}")


def graph_inputs(module: ModuleType) -> tuple[str, ...]:
    return tuple(getattr(module, "INPUTS", ()))


def compiled_graph(module: ModuleType, n_lanes: int, parameters: Parameters) -> Compiled:
    network = module.build(n_lanes, parameters)
    return compile_network(network, module.HIDDEN, module.OBSERVED, graph_inputs(module))


@functools.cache
def template(name: str, n_lanes: int) -> Compiled:
    """A graph of the package, small and with its default parameters."""
    module = graph(name)
    small = resolve_parameters(module.PARAMETERS, getattr(module, "SMALL", {}), n_lanes)
    return compiled_graph(module, n_lanes, small)


def small_parameters(name: str, n_lanes: int, rng: np.random.Generator) -> Parameters:
    """Random values that fit the template."""
    module = graph(name)
    drawn = draw_parameters(module.PARAMETERS, n_lanes, rng)
    return {**drawn, **getattr(module, "SMALL", {})}


def draw_parameters(
    specs: Iterable[Parameter], n_lanes: int, rng: np.random.Generator
) -> dict[str, Value]:
    """Random values by kind; one in three is an extreme of its kind. A whole number shapes the
    network (so many cells, so many levels) and keeps its default."""
    specs = list(specs)
    given: dict[str, object] = {}
    for spec in specs:
        size = n_lanes if spec.per_lane and rng.random() < 0.5 else 1
        values = [_draw_value(spec, rng) for _ in range(size)]
        given[spec.name] = values if size > 1 else values[0]
    return resolve_parameters(specs, given, n_lanes)


def _draw_value(spec: Parameter, rng: np.random.Generator) -> object:
    is_extreme = rng.random() < 1 / 3
    if spec.kind == "choice":
        return str(rng.choice(spec.choices))
    if spec.kind == "probability":
        return float(rng.integers(2)) if is_extreme else rng.random()
    if spec.kind == "sigma":
        return float(rng.choice([1e-200, 1e-3, 50.0, 1e9])) if is_extreme else rng.uniform(0.3, 3)
    if spec.kind == "positive":
        return rng.uniform(0.5, 2)
    return spec.default if spec.kind == "integer" else rng.uniform(0, 10)


def draw_evidence(
    compiled: Compiled, n_frames: int, rng: np.random.Generator, zeros: float = 0.3
) -> Evidence:
    """Random likelihoods of any scale, a share of them zero, now and then a frame of nothing but
    zeros or one certain value."""
    likelihoods: dict[Observed, np.ndarray] = {}
    for key in compiled.observed:
        names = (key,) if isinstance(key, str) else key
        shape = (n_frames, *(compiled.cardinality[n] for n in names))
        values = rng.random(shape) * (rng.random(shape) >= zeros)
        scale = np.where(rng.random(n_frames) < 0.2, 1e-9, 1.0)
        scale[(rng.random(n_frames) < 0.1) & (zeros > 0)] = 0.0
        values *= scale.reshape(-1, *[1] * len(names))
        for t in range(n_frames):
            if zeros > 0 and rng.random() < 0.15:
                values[t] = 0
                values[t].flat[rng.integers(values[t].size)] = 1
        likelihoods[key] = values
    inputs = {n: rng.integers(compiled.cardinality[n], size=n_frames) for n in compiled.inputs}
    return Evidence(likelihoods, inputs)


def assert_same_beliefs(ours: Beliefs, right: Beliefs, tolerance: float = 1e-9) -> None:
    """The same flags, marginals and log evidence."""
    np.testing.assert_array_equal(ours.is_impossible, right.is_impossible)
    assert set(ours.marginals) == set(right.marginals)
    for name in right.marginals:
        np.testing.assert_allclose(
            ours.marginals[name], right.marginals[name], rtol=0, atol=tolerance, err_msg=name
        )
    np.testing.assert_allclose(ours.log_evidence, right.log_evidence, rtol=0, atol=tolerance)


def assert_filters_agree(
    compiled: Compiled, evidence: Evidence, right: Mapping[str, Beliefs]
) -> None:
    """The filters give the right beliefs, for each method in `right`."""
    for method, beliefs in right.items():
        ours = filter_beliefs(compiled, evidence, method)
        assert_same_beliefs(ours, beliefs)


# --- the answer by brute force -------------------------------------------------------------------


def brute_force(
    tables: Sequence[Table],
    hidden: Sequence[str],
    evidence: Evidence,
    method: str,
) -> Beliefs:
    """The filter, by adding up every assignment of every node, in exact order, without pgmpy and
    without numbering joint states. Exponential in nodes and frames.

    exact: over whole trajectories. assumed_density: over two slices, slice 0 being the product of
    the marginals before.
    """
    persistent = {
        name
        for table in tables
        for parent in table.parents
        if parent[1] != table.node[1]
        for name in (parent[0], table.node[0])
    }
    slices = [[t for t in tables if t.node[1] == s] for s in (0, 1)]
    marginals: dict[str, list[np.ndarray]] = {name: [] for name in hidden}
    log_evidence, is_impossible = [], []
    # Unnormalised weight of each trajectory so far, keyed by its last slice only where that is
    # all that the next slice can see.
    paths: list[tuple[tuple[dict[str, int], ...], float]] = [((), 1.0)]
    for t in range(len(evidence)):
        extended = [
            ((*path, values), weight * _weight(slices[min(t, 1)], path[-1] if path else {}, values))
            for path, weight in paths
            for values in _assignments(slices[min(t, 1)], evidence, t)
        ]
        extended = [(path, weight) for path, weight in extended if weight > 0]
        scaled = [(path, weight * _likelihood(evidence, t, path[-1])) for path, weight in extended]
        before = math.fsum(weight for _, weight in extended)
        total = math.fsum(weight for _, weight in scaled)
        is_impossible.append(not total > 0)
        log_evidence.append(math.log(total / before) if total > 0 else 0.0)
        paths = scaled if total > 0 else extended
        now = {name: _marginal(paths, name, _size(tables, name)) for name in hidden}
        for name in hidden:
            marginals[name].append(now[name])
        if method == "assumed_density":
            names = sorted(persistent)
            paths = [
                ((dict(zip(names, values, strict=True)),), float(weight))
                for values in itertools.product(*(range(len(now[n])) for n in names))
                if (weight := math.prod(now[n][v] for n, v in zip(names, values, strict=True))) > 0
            ]
    return Beliefs(
        np.arange(len(evidence)),
        {name: np.stack(values) for name, values in marginals.items()},
        np.array(log_evidence),
        np.array(is_impossible),
    )


def _size(tables: Sequence[Table], name: str) -> int:
    return next(t.values.shape[-1] for t in tables if t.node[0] == name)


def _assignments(tables: Sequence[Table], evidence: Evidence, t: int) -> Iterable[dict[str, int]]:
    names = [table.node[0] for table in tables]
    ranges = [
        [int(evidence.inputs[name][t])] if name in evidence.inputs else range(_size(tables, name))
        for name in names
    ]
    for values in itertools.product(*ranges):
        yield dict(zip(names, values, strict=True))


def _weight(tables: Sequence[Table], before: dict[str, int], now: dict[str, int]) -> float:
    """P(now | before) of one slice, the inputs being given."""
    weight = 1.0
    for table in tables:
        if not table.parents and table.node[0].startswith("Input"):
            continue
        index = [now[n] if s == table.node[1] else before[n] for n, s in table.parents]
        weight *= float(table.values[(*index, now[table.node[0]])])
    return weight


def _likelihood(evidence: Evidence, t: int, now: dict[str, int]) -> float:
    likelihood = 1.0
    for key, values in evidence.likelihoods.items():
        names = (key,) if isinstance(key, str) else key
        likelihood *= float(values[(t, *(now[n] for n in names))])
    return likelihood


def _marginal(
    paths: Sequence[tuple[tuple[dict[str, int], ...], float]], name: str, size: int
) -> np.ndarray:
    sums = [math.fsum(w for path, w in paths if path[-1][name] == v) for v in range(size)]
    return np.array(sums) / math.fsum(sums)


# --- networks that nobody thought of -------------------------------------------------------------


@dataclass(frozen=True)
class RandomGraph:
    """What a graph file declares, drawn at random."""

    tables: list[Table]
    hidden: tuple[str, ...]
    observed: tuple[Observed, ...]
    inputs: tuple[str, ...]

    def compiled(self) -> Compiled:
        network = declare(self.tables, self.observed)
        return compile_network(network, self.hidden, self.observed, self.inputs)


@functools.cache
def random_network(seed: int) -> tuple[RandomGraph, Compiled]:
    drawn = draw_graph(np.random.default_rng(seed))
    return drawn, drawn.compiled()


def any_compiled(seed: int) -> Compiled:
    """The paper's graph with random parameters, or one of five random networks."""
    if seed % 2:
        return random_network(seed % 5)[1]
    rng = np.random.default_rng(seed)
    n_lanes = int(rng.integers(1, 6))
    parameters = small_parameters("sensor_failure", n_lanes, rng)
    tables = graph("sensor_failure").tables(n_lanes, parameters)
    return with_tables(template("sensor_failure", n_lanes), tables)


def frames_to_enumerate(compiled: Compiled) -> int:
    """Adding up all trajectories costs the number of states to the power of this."""
    return 3 if compiled.n_states <= 8 else 2


def draw_graph(rng: np.random.Generator) -> RandomGraph:
    """Two or three persistent nodes with edges across and inside the slices, perhaps an input that
    selects transitions, perhaps a function, and observed nodes: alone, one the parent of another,
    two jointly, hidden ones directly."""
    size = {f"P{i}": int(rng.integers(2, 4)) for i in range(rng.integers(2, 4))}
    persistent = list(size)
    inputs = ("Input",) if rng.random() < 0.5 else ()
    tables: list[Table] = []
    if inputs:
        size["Input"] = int(rng.integers(2, 4))
        for s in (0, 1):
            tables.append(Table(("Input", s), (), draw_rows(rng, (), size["Input"])))
    functions: list[str] = []

    def add_function(name: str, of: Sequence[str]) -> None:
        size[name] = int(rng.integers(2, 4))
        shape = [size[n] for n in of]
        values = np.eye(size[name])[rng.integers(size[name], size=shape)]
        tables.extend(within(name, list(of), values))
        functions.append(name)

    across = _draw_edges_across(persistent, rng)
    for i, name in enumerate(persistent):
        inside = [p for p in (*persistent[:i], *functions) if rng.random() < 0.4]
        inside += [n for n in inputs if rng.random() < 0.6 or i == 0]
        tables += prior(name, draw_rows(rng, [size[p] for p in inside], size[name]), inside)
        given = [*(previous(p) for p in across[name]), *inside]
        shape = [size[p] for p in (*across[name], *inside)]
        tables += dynamics(name, given, draw_rows(rng, shape, size[name]))
        if i == 0 and rng.random() < 0.4:
            add_function("F0", [name])
    if rng.random() < 0.5:
        add_function("F1", persistent[: rng.integers(1, len(persistent) + 1)])
    hidden = [*persistent, *functions]
    rng.shuffle(hidden)

    observed: list[Observed] = []
    leaves: list[str] = []
    for name in ("D", "E"):
        size[name] = int(rng.integers(2, 4))
        parents = [h for h in hidden if rng.random() < 0.5] or [hidden[0]]
        parents += [leaf for leaf in leaves if rng.random() < 0.5]
        tables += within(name, parents, draw_rows(rng, [size[p] for p in parents], size[name]))
        leaves.append(name)
    style = rng.integers(4)
    if style == 0:
        observed = ["D", "E"]
    elif style == 1:
        observed = [("E", "D")]
    elif style == 2:
        observed = [(hidden[0], "E"), "D"]
    else:
        observed = ["E", ("D", "E")]
    if rng.random() < 0.3:
        observed.append(hidden[-1])
    rng.shuffle(tables)  # type: ignore[arg-type]
    return RandomGraph(tables, tuple(hidden), tuple(observed), inputs)


def _draw_edges_across(persistent: Sequence[str], rng: np.random.Generator) -> dict[str, list[str]]:
    across = {
        name: [p for p in persistent if rng.random() < (0.8 if p == name else 0.4)]
        for name in persistent
    }
    for name in persistent:
        if not any(name in given or (given and name == child) for child, given in across.items()):
            across[name] = [name]
    return across


def draw_rows(rng: np.random.Generator, shape: Sequence[int], size: int) -> np.ndarray:
    """Random conditional rows, some of them with zeros, some certain."""
    rows = rng.dirichlet(np.ones(size), tuple(shape))
    flat = rows.reshape(-1, size)
    for row in flat:
        if rng.random() < 0.25:
            row[:] = np.eye(size)[rng.integers(size)]
    return rows


def shuffle_axes(tables: Iterable[Table], rng: np.random.Generator) -> list[Table]:
    """The same tables with their parents in another order."""
    shuffled = []
    for table in tables:
        order = rng.permutation(len(table.parents))
        values = table.values.transpose(*order, len(order))
        shuffled.append(Table(table.node, tuple(table.parents[k] for k in order), values))
    return shuffled


# --- the smallest network that filters -----------------------------------------------------------

KEEP = np.array([[0.9, 0.1], [0.2, 0.8]])
SEES = np.array([[0.7, 0.3], [0.4, 0.6]])


def simple_tables(name: str = "A") -> list[Table]:
    """One persistent node and D that sees it."""
    return [
        *prior(name, [0.5, 0.5]),
        *dynamics(name, [previous(name)], KEEP),
        *within("D", [name], SEES),
    ]

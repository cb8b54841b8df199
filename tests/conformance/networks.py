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

from egolane_pgm.contracts import Graph
from egolane_pgm.graphs.cpds import Table, declare, dynamics, previous, prior, within
from egolane_pgm.inference.compile import Compiled, compile, with_tables
from egolane_pgm.inference.filtering import filter_beliefs
from egolane_pgm.parameters import Parameter, Parameters, Value, resolve_parameters
from egolane_pgm.plugins import load_plugin, plugin_names, read_module
from egolane_pgm.types import Beliefs, Evidence, Observed

METHODS = ("assumed_density", "exact")

seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=20, deadline=None)


def graph_names() -> list[str]:
    """Every graph of the package."""
    return plugin_names(Graph)


def graph(name: str) -> Graph:
    return load_plugin(Graph, name, name)


def tables_of(graph: Graph, n_lanes: int, parameters: Parameters) -> Sequence[Table]:
    assert graph.tables is not None
    return graph.tables(n_lanes, parameters)


def compiled_graph(graph: Graph | ModuleType, n_lanes: int, parameters: Parameters) -> Compiled:
    if isinstance(graph, ModuleType):
        graph = read_module(Graph, graph, graph.__name__, "graph")
    assert graph.observed is not None
    network = declare(tables_of(graph, n_lanes, parameters), graph.observed)
    return compile(network, hidden=graph.hidden, observed=graph.observed, inputs=graph.inputs)


def small(name: str) -> dict[str, Value]:
    """Values that keep a graph of the package small."""
    module = importlib.import_module(f"egolane_pgm.graphs.{name}")
    return dict(vars(module).get("SMALL", {}))


@functools.cache
def template(name: str, n_lanes: int) -> Compiled:
    """A graph of the package, small and with its default parameters."""
    values = resolve_parameters(graph(name).parameters, small(name), n_lanes)
    return compiled_graph(graph(name), n_lanes, values)


def small_parameters(name: str, n_lanes: int, rng: np.random.Generator) -> Parameters:
    """Random values that fit the template."""
    return {**draw_parameters(graph(name).parameters, n_lanes, rng), **small(name)}


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
    if spec.kind == "text":
        return spec.default
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
    compiled: Compiled, evidence: Evidence, right: Mapping[str, Beliefs], tolerance: float = 1e-9
) -> None:
    """The filters give the right beliefs, for each method in `right`."""
    for method, beliefs in right.items():
        ours = filter_beliefs(compiled, evidence, method)
        assert_same_beliefs(ours, beliefs, tolerance)


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
    persistent = nodes_across(tables)
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
        now = {n: _marginal(paths, n, _size(tables, n)) for n in {*hidden, *persistent}}
        for name in hidden:
            marginals[name].append(now[name])
        if method == "assumed_density":
            paths = product_of({name: now[name] for name in persistent})
    return Beliefs(
        np.arange(len(evidence)),
        {name: np.stack(values) for name, values in marginals.items()},
        np.array(log_evidence),
        np.array(is_impossible),
    )


def nodes_across(tables: Iterable[Table]) -> list[str]:
    """The nodes with an edge across the slices."""
    edges = [(parent, table.node) for table in tables for parent in table.parents]
    return sorted({name for edge in edges if edge[0][1] != edge[1][1] for name, _ in edge})


def product_of(
    marginals: Mapping[str, np.ndarray],
) -> list[tuple[tuple[dict[str, int], ...], float]]:
    """Paths of one frame whose weights are the product of these marginals."""
    paths = []
    for values in itertools.product(*(range(len(rows)) for rows in marginals.values())):
        at = dict(zip(marginals, values, strict=True))
        weight = math.prod(marginals[name][value] for name, value in at.items())
        if weight > 0:
            paths.append(((at,), float(weight)))
    return paths


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
        return compile(network, hidden=self.hidden, observed=self.observed, inputs=self.inputs)


@functools.cache
def random_network(seed: int) -> tuple[RandomGraph, Compiled]:
    drawn = draw_graph(np.random.default_rng(seed))
    return drawn, drawn.compiled()


def any_compiled(seed: int) -> Compiled:
    """The paper's graph with random parameters, or one of thirteen random networks."""
    if seed % 3:
        return random_network(seed % 13)[1]
    rng = np.random.default_rng(seed)
    n_lanes = int(rng.integers(1, 6))
    parameters = small_parameters("sensor_failure", n_lanes, rng)
    tables = graph("sensor_failure").tables(n_lanes, parameters)
    return with_tables(template("sensor_failure", n_lanes), tables)


def frames_to_enumerate(compiled: Compiled) -> int:
    """Adding up all trajectories costs the number of states to the power of this."""
    return 3 if compiled.n_states <= 8 else 2


#: Random networks have at most so many values of all nodes together, so that adding up every
#: trajectory stays quick.
MOST_VALUES = 48


def draw_graph(rng: np.random.Generator) -> RandomGraph:
    """Any network that compiles, of four to six nodes: hidden ones, observed ones and perhaps an
    input in any order, with edges from any of them to any later one inside a frame, and from any
    but the input to any across the slices.

    What this makes: nodes that persist and nodes that do not, functions, tables that differ in the
    first frame or hold in every one; observed nodes that persist, that hidden ones depend on, that
    an input selects; evidence about several nodes jointly and about hidden ones directly.
    """
    hidden = [f"H{k}" for k in range(rng.integers(2, 4))]
    seen = ["D", "E"][: rng.integers(1, 3)]
    inputs = ("Input",) if rng.random() < 0.4 else ()
    order = [*inputs, *map(str, rng.permutation([*hidden, *seen]))]
    if rng.random() < 0.5:  # the usual case: detections of hidden nodes
        order.sort(key=lambda name: name in seen)
    size: dict[str, int] = {}
    for name in order:
        room = MOST_VALUES // 2 ** (len(order) - len(size) - 1)
        size[name] = 3 if 3 * math.prod(size.values()) <= room and rng.random() < 0.5 else 2
    tables: list[Table] = []
    carried = False
    for k, name in enumerate(order):
        before = [n for n in order if n not in inputs and rng.random() < 0.25]
        persists = name not in inputs and rng.random() < (0.4 if name in seen else 0.6)
        across = list(dict.fromkeys([*before, name])) if persists else []
        if name == order[-1] and not carried and not across:
            across = [name]
        carried = carried or bool(across)
        inside = [] if name in inputs else [n for n in order[:k] if rng.random() < 0.45]
        tables += _draw_tables(rng, name, size, across[:2], inside[:2])
    observed: list[Observed] = list(seen)
    style = rng.integers(5)
    if style == 0:
        observed = [tuple(reversed(seen))] if len(seen) > 1 else ["D"]
    elif style == 1:
        observed = [(hidden[0], seen[0]), *seen[1:]]
    elif style == 2:
        observed.append((seen[-1], hidden[-1]))
    elif style == 3:
        observed.append(hidden[-1])
    rng.shuffle(observed)  # type: ignore[arg-type]
    rng.shuffle(hidden)
    rng.shuffle(tables)  # type: ignore[arg-type]
    return RandomGraph(tables, tuple(hidden), tuple(observed), inputs)


def _draw_tables(
    rng: np.random.Generator,
    name: str,
    size: Mapping[str, int],
    across: Sequence[str],
    inside: Sequence[str],
) -> list[Table]:
    shape = [size[p] for p in inside]
    if not across and rng.random() < 0.7:
        values = draw_rows(rng, shape, size[name])
        if rng.random() < 0.4:
            values = np.eye(size[name])[values.argmax(axis=-1)]
        return within(name, inside, values)
    later = draw_rows(rng, [size[p] for p in (*across, *inside)], size[name])
    return [
        *prior(name, draw_rows(rng, shape, size[name]), inside),
        *dynamics(name, [*map(previous, across), *inside], later),
    ]


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

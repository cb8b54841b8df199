"""A model: evidence rule, graph and parameters of an experiment, compiled."""

from __future__ import annotations

import functools
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.contracts import Graph, Rule, RuleStep
from egolane_pgm.experiment import DETECTOR, FROM_MAP, Experiment, Origin, TrainedOn
from egolane_pgm.graphs.cpds import Table
from egolane_pgm.graphs.from_pgmpy import node_names
from egolane_pgm.graphs.yaml_graph import graph_of
from egolane_pgm.identity import digest_of
from egolane_pgm.inference.compile import (
    LANES,
    Compiled,
    compile,
    compile_tables,
    counted_tables,
    free_parameters,
    with_initial_lane,
    with_tables,
)
from egolane_pgm.inference.filtering import METHODS, harden, joint_input
from egolane_pgm.parameters import Value, resolve_parameters, smoothing_defaults
from egolane_pgm.plugins import (
    OWN_FILES,
    declared_parameters,
    load_plugin,
    plugin_errors,
    plugin_names,
    same,
)
from egolane_pgm.tools.files import to_jsonable
from egolane_pgm.types import (
    Evidence,
    FloatArray,
    InputError,
    IntArray,
    LineLog,
    Observed,
    problems_in,
)

if TYPE_CHECKING:
    from pgmpy.models import DynamicBayesianNetwork


@dataclass(frozen=True, eq=False, repr=False)
class Model:
    """An experiment, ready for inference.

    - rule, graph: the evidence rule and the graph.
    - parameters: the value of every declared parameter.
    - compiled: the graph with these values.
    - unused: evidence of the rule that the graph does not observe.
    - learned_from: what fitted tables were trained on; None for other tables.
    """

    experiment: Experiment
    rule: Rule
    graph: Graph
    parameters: Mapping[str, Value]
    compiled: Compiled
    unused: frozenset[Observed]
    learned_from: Origin | None = None

    @property
    def n_lanes(self) -> int:
        """Number of lanes of the road."""
        return self.experiment.n_lanes

    @property
    def values(self) -> dict[str, list[str]]:
        """The names of the values of each hidden node."""
        return {node: list(self.compiled.values[node]) for node in self.compiled.hidden}

    @property
    def network(self) -> DynamicBayesianNetwork:
        """The graph in pgmpy, with these values and the names of the nodes' values."""
        network = self.compiled.network
        if self.learned_from is not None:
            network.graph["learned_from"] = self.learned_from
        return network

    @property
    def free_parameters(self) -> int:
        """Number of free parameters of the network, see `compile.free_parameters`."""
        return free_parameters(counted_tables(self.compiled))

    def __repr__(self) -> str:
        return f"Model({self.experiment.name!r}: {self.experiment.graph_name}, {self.compiled})"

    def __reduce__(self) -> Any:
        # Functions of users' files are not pickled, but loaded by the names in the experiment.
        e = self.experiment
        parts = self.parameters, self.compiled, self.unused, self.learned_from
        return _unpickled, (e, *parts)


def _unpickled(experiment: Experiment, *parts: Any) -> Model:
    rule = load_plugin(Rule, experiment.evidence, "evidence")
    return Model(experiment, rule, load_plugin(Graph, experiment.graph, "graph"), *parts)


def compile_model(experiment: Experiment) -> Model:
    """Load the evidence rule and the graph of an experiment, and compile them.

    Raises InputError, naming the YAML key, for unknown names and parameters, values out of range,
    and a rule that does not fit the graph.
    """
    e, source = experiment, experiment.source
    if e.n_lanes == FROM_MAP:
        raise InputError(
            f"{source}: n_lanes: map gives several drives, one model needs one number of lanes"
            " (road: null, n_lanes: 3)"
        )
    rule = load_plugin(Rule, e.evidence, f"{source}: evidence")
    graph = load_plugin(Graph, e.graph, f"{source}: graph")
    declared = declared_parameters(rule, graph)
    specs = smoothing_defaults(declared) if e.filter in ("smoothed", "viterbi") else declared
    given = {name: value for name, value in e.parameters.items() if name != DETECTOR}
    parameters = resolve_parameters(specs, given, e.n_lanes, f"{source}: parameters")
    with problems_in(f"{source}: graph {graph.name}"):
        compiled, unused = compile_graph(rule, graph, e.n_lanes, parameters)
        lanes = compiled.cardinality.get("Lane")
        if lanes != e.n_lanes:
            raise InputError(
                f"needs a hidden node Lane with {e.n_lanes} values, has {lanes or 'none'}"
            )
    if e.start_lane is not None:
        lane = np.arange(1, e.n_lanes + 1)
        first = e.start_lane
        start = np.where(lane == first, 1.0, 0.0) if isinstance(first, int) else np.array(first)
        compiled = with_initial_lane(compiled, start)
    return Model(experiment, rule, graph, parameters, compiled, unused, graph.learned_from)


def compile_graph(
    rule: Rule, graph: Graph, n_lanes: int, parameters: Mapping[str, Value]
) -> tuple[Compiled, frozenset[Observed]]:
    """Compile a graph; return it and the evidence of the rule that it does not observe.

    A graph with `tables`, hidden and observed nodes is compiled without pgmpy.
    """
    provides, make, hidden = rule.provides, graph.tables, graph.hidden
    is_plain = make is None or hidden is None or graph.observed is None
    network = build_network(graph, n_lanes, parameters) if is_plain else None
    if graph.observed is not None:
        observed, inputs = graph.observed, graph.inputs
        unused = frozenset(graph.unused).difference(observed)
        if provides and not {*observed} <= {*provides} <= {*observed, *unused}:
            raise InputError(
                f"observes {', '.join(map(str, observed))}, the evidence rule gives"
                f" {', '.join(map(str, provides))}; list in the graph's UNUSED what it ignores"
            )
    else:
        # A plain pgmpy network observes all evidence about its nodes.
        nodes = node_names(network)
        observed = observed_under(rule, network)
        unused = frozenset(provides).difference(observed)
        inputs = tuple(name for name in rule.inputs if name in nodes)
        if not observed:
            raise InputError(
                "observes nothing: the evidence rule gives"
                f" {', '.join(map(str, provides)) or 'nothing (it has no PROVIDES)'}, the graph has"
                f" {', '.join(sorted(nodes))}"
            )
    bounds = graph.bounds or {}
    inputs = tuple(dict.fromkeys((*inputs, *bounds)))
    if network is None and make and hidden:
        with plugin_errors(graph, "graph"):
            tables = make(n_lanes, parameters)
        compiled = compile_tables(
            tables, observed=observed, hidden=hidden, inputs=inputs, values=graph.values
        )
    else:
        compiled = compile(
            network, observed=observed, hidden=hidden, inputs=inputs, values=graph.values
        )
    for name, cuts in bounds.items():
        if not (np.isfinite(cuts).all() and (np.diff(cuts) > 0).all()):
            raise InputError(f"BOUNDS: {name}: {tuple(cuts)} do not increase")
        if (n_values := compiled.cardinality[name]) != len(cuts) + 1:
            raise InputError(f"BOUNDS: {name} has {n_values} values, needs {len(cuts) + 1}")
    return compiled, unused


def build_network(
    graph: Graph, n_lanes: int, parameters: Mapping[str, Value]
) -> DynamicBayesianNetwork:
    """Declare a graph in pgmpy. Raises InputError if `build` does not return a network."""
    if graph.build is None:
        raise InputError(f"{graph.name} defines tables without HIDDEN and OBSERVED")
    with plugin_errors(graph, "graph"):
        network = graph.build(n_lanes, parameters)
    if not hasattr(network, "get_cpds"):
        raise InputError(f"build() returned {type(network).__name__}, not a pgmpy network")
    return network


def observed_under(rule: Rule, network: Any) -> tuple[Observed, ...]:
    """Return the evidence of a rule whose nodes are in the network."""
    nodes = node_names(network)
    return tuple(k for k in rule.provides if nodes.issuperset([k] if isinstance(k, str) else k))


def with_parameters(model: Model, parameters: Mapping[str, Value]) -> Model:
    """Return the model with other values of all parameters.

    Only the tables are computed again, unless an integer or text parameter of the graph changed:
    these may change the shape of the network.
    """
    specs, make = model.graph.parameters, model.graph.tables
    shapes = [spec.name for spec in specs if spec.kind in ("integer", "text")]
    same_shape = all(parameters[name] == model.parameters[name] for name in shapes)
    if same_shape and make is not None:
        with plugin_errors(model.graph, "graph"):
            compiled = with_tables(model.compiled, make(model.n_lanes, parameters))
    else:
        compiled, _ = compile_graph(model.rule, model.graph, model.n_lanes, parameters)
        if model.compiled.start is not None:
            compiled = with_initial_lane(compiled, model.compiled.start)
    return replace(model, parameters=parameters, compiled=compiled)


# --- another graph -------------------------------------------------------------------------------


def with_graph(experiment: Experiment, given: Any) -> Experiment:
    """Return the experiment with another graph.

    - given: a name, a file, a module, a network of pgmpy or compiled, or anything with a model (a
      result, a study, an exploration). The numbers of a network or a model are kept as they are.

    It keeps the parameters that the new plugins declare, and its evidence rule if that fits the
    graph; otherwise it gets the first rule that fits. `tuned_on` is that of a graph with fitted
    tables. Raises InputError for anything else, and for a network that cannot be compiled.
    """
    where = f"{experiment.source}: graph"
    graph = as_graph(given, experiment)
    loaded = load_plugin(Graph, graph, where)
    evidence = matching_evidence_rule(loaded, experiment.n_lanes, experiment.evidence, where)
    rule = load_plugin(Rule, evidence, where)
    known = {DETECTOR, *(spec.name for spec in declared_parameters(rule, loaded))}
    kept = {name: value for name, value in experiment.parameters.items() if name in known}
    changes = {"graph": graph, "evidence": evidence, "parameters": kept}
    origin = {"tuned_on": loaded.learned_from or experiment.tuned_on}
    return experiment.model_copy(update=changes | origin)


def as_graph(given: Any, experiment: Experiment) -> str | Graph:
    """The value of the key `graph` for a graph of any kind."""
    if isinstance(given, (str, os.PathLike)):
        name = os.fspath(given)
        return os.path.abspath(name) if name.endswith(OWN_FILES) else name
    if isinstance(given, Graph):
        return given
    if isinstance(given, ModuleType):
        if given.__name__.startswith("egolane_pgm.graphs."):
            return given.__name__.rpartition(".")[2]
        if not str(given.__file__ if "__file__" in vars(given) else "").endswith(OWN_FILES):
            raise InputError(f"graph: the module {given.__name__} has no file; write it to one")
        return os.path.abspath(str(given.__file__))
    found = model_of(given)
    if isinstance(found, Model):
        # Parameters without fitted tables may have been tuned on any frames.
        return graph_in_memory(found, found.learned_from or "unknown")
    if isinstance(found, Compiled):
        return graph_in_memory(found, "unknown")
    if not hasattr(found, "get_cpds"):
        kind = type(given).__name__
        raise InputError(f"graph: {kind} is not a name, file, module, network or model")
    network = Graph(name="network", build=functools.partial(same, found))
    with problems_in("graph"):
        name = matching_evidence_rule(network, experiment.n_lanes, experiment.evidence, "network")
        rule = load_plugin(Rule, name, "evidence")
        compiled, unused = compile_graph(rule, network, experiment.n_lanes, {})
    model = Model(experiment, rule, network, {}, compiled, unused)
    return graph_in_memory(model, found.graph.get("learned_from", "unknown"))


def graph_in_memory(given: Model | Compiled, origin: Origin) -> Graph:
    """Return a graph with the tables of a model or network, as a YAML graph has them.

    It is for one number of lanes, and has no parameters.

    - origin: what the tables were trained on.
    """
    compiled = given.compiled if isinstance(given, Model) else given
    bounds = (given.graph.bounds if isinstance(given, Model) else None) or {}
    unused = given.unused if isinstance(given, Model) else ()
    by_node = compiled.tables
    names = list(dict.fromkeys(name for name, _ in by_node))
    nodes: dict[str, int | list[str]] = {}
    for name in names:
        values, first = compiled.values[name], int(name in LANES)
        are_default = values == tuple(map(str, range(first, first + len(values))))
        nodes[name] = len(values) if are_default else list(values)
    content: dict[str, Any] = {
        "learned_from": to_jsonable(origin),
        "nodes": nodes,
        "hidden": list(compiled.hidden),
        "observed": [list(key) if isinstance(key, tuple) else key for key in compiled.observed],
        "inputs": list(compiled.inputs),
        "bounds": {key: list(cuts) for key, cuts in bounds.items()},
        "unused": [list(key) if isinstance(key, tuple) else key for key in sorted(unused, key=str)],
        "tables": {
            name: _rows(by_node[name, 1])
            if name in compiled.one_table
            else {"first": _rows(by_node[name, 0]), "next": _rows(by_node[name, 1])}
            for name in names
            if name not in compiled.inputs
        },
    }
    keys = {key: value for key, value in content.items() if value not in ([], {}, None)}
    name = f"network_{digest_of(keys)[:12]}"
    return graph_of(keys, name, name)


def _rows(table: Table) -> dict[str, Any]:
    of = [name if t == table.node[1] else f"{name} before" for name, t in table.parents]
    return {"rows": {**({"of": of} if of else {}), "values": table.values.tolist()}}


def with_own_values(
    model: Model, trained: tuple[TrainedOn, ...], *, has_tables: bool = True
) -> Model:
    """Return the model of an experiment that has the numbers of a fit: the values of all
    parameters, and fitted tables as its graph.

    - trained: the training drives.
    - has_tables: whether tables were fitted.
    """
    e, names = model.experiment, {*model.parameters, DETECTOR}
    # Parameters that this fit keeps may be of an earlier one.
    earlier = e.tuned_on if isinstance(e.tuned_on, tuple) else ()
    changes: dict[str, Any] = {"tuned_on": (*earlier, *trained)}
    if has_tables:
        changes["graph"] = graph_in_memory(model, trained)
        # The graph of learned tables has no parameters; only the rule's remain.
        names = {DETECTOR, *(spec.name for spec in model.rule.parameters)}
    values = {**e.parameters, **model.parameters}
    changes["parameters"] = {name: v for name, v in values.items() if name in names}
    return compile_model(e.model_copy(update=changes))


def model_of(given: Any) -> Any:
    """Return the model of a result, a study or an exploration; anything else as it is."""
    return getattr(given, "model", given)


def matching_evidence_rule(graph: Graph, n_lanes: int, first: str, where: str) -> str:
    """Return the evidence rule that provides what a graph observes, preferably `first`.

    For a plain pgmpy network it is the rule of whose evidence the network observes most.
    """
    names = dict.fromkeys([first, *plugin_names(Rule)])
    rules = {name: load_plugin(Rule, name, where) for name in names}
    if graph.observed is None:
        network = build_network(graph, n_lanes, resolve_parameters(graph.parameters, {}, n_lanes))
        return max(rules, key=lambda name: len(observed_under(rules[name], network)))
    seen = set(graph.observed)
    known = {*seen, *graph.unused}
    fits = (n for n, rule in rules.items() if seen <= {*(rule.provides or seen)} <= known)
    return next(fits, first)


# --- evidence ------------------------------------------------------------------------------------


def online_rule(model: Model) -> RuleStep:
    """Return the evidence rule for frames as they come; it may have a memory.

    A rule without `online` is called for each log separately, without its warnings.
    """
    if model.rule.online is not None:
        with plugin_errors(model.rule, "evidence"):
            return model.rule.online(model.n_lanes, model.parameters)

    def alone(log: LineLog) -> Evidence:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return model.rule.evidence(log, model.n_lanes, model.parameters)

    return alone


def make_evidence(
    model: Model, log: LineLog, rule: RuleStep | None = None
) -> tuple[Evidence, FloatArray | None]:
    """Make the evidence of T frames, and the detector's answer (T, n_lanes) or None.

    - rule: by default the model's rule for a whole drive.

    Filled-in frames (`missing_frames: predict`) get a likelihood of one everywhere. Raises
    InputError, naming the rule's file, if the rule does not return evidence of T frames.
    """
    file = model.rule.file
    with plugin_errors(model.rule, "evidence"):
        if rule is None:
            given = model.rule.evidence(log, model.n_lanes, model.parameters)
        else:
            given = rule(log)
    if not isinstance(given, Evidence):
        raise InputError(f"{file}: evidence() returned {type(given).__name__}, not Evidence")
    if len(given) != len(log):
        raise InputError(f"{file}: evidence() returned {len(given)} frames for {len(log)}")
    tentative = given.likelihoods.get(model.rule.tentative)
    if tentative is not None and tentative.shape[1:] == (model.n_lanes,):
        total = tentative.sum(axis=1, keepdims=True)
        shares = tentative / np.where(total > 0, total, 1)
        tentative = np.where(total > 0, shares, 1 / model.n_lanes)
    else:
        tentative = None
    likelihoods = {k: v for k, v in given.likelihoods.items() if k not in model.unused}
    if log.is_missing.any():
        likelihoods = {k: v.copy() for k, v in likelihoods.items()}
        for values in likelihoods.values():
            values[log.is_missing] = 1.0
    bounds = model.graph.bounds or {}
    own = {name: input_of(log, name, cuts) for name, cuts in bounds.items()}
    used = Evidence(likelihoods, {**given.inputs, **own})
    with problems_in(file):
        joint_input(model.compiled, used)
    if model.experiment.evidence_mode == "hard":
        used = harden(used)
    return used, tentative


def input_of(log: LineLog, name: str, bounds: Sequence[float]) -> IntArray:
    """Return the values of an input that is a column of the recording, (T,): the number of bounds
    that are not larger. Raises InputError for a missing column and for an empty cell."""
    where, needs = f"{log.source}: ", f"an input of the graph (columns: {name}=COLUMN)"
    if name not in log.covariates:
        raise InputError(f"{where}no column {name}, {needs}")
    is_empty = np.isnan(values := log.covariates[name])
    if is_empty.any():
        raise InputError(f"{where}frame {log.frame_id[is_empty.argmax()]}: no {name}, {needs}")
    return np.searchsorted(bounds, values, side="right")


def with_inputs(experiment: Experiment, graph: Graph | None = None) -> Experiment:
    """Return the experiment whose `recording.columns` also name the graph's inputs (BOUNDS)."""
    graph = graph or load_plugin(Graph, experiment.graph, f"{experiment.source}: graph")
    if not (names := {name: name for name in graph.bounds or {}}):
        return experiment
    columns = {**names, **(experiment.recording.columns or {})}
    recording = experiment.recording.model_copy(update={"columns": columns})
    return experiment.model_copy(update={"recording": recording})


def why_not_causal(model: Model) -> list[str]:
    """Return the reasons why posteriors use later frames; empty for a causal model."""
    e, reasons = model.experiment, []
    if e.filter not in METHODS:
        later = "all later" if e.lag is None else f"the next {e.lag}"
        reasons.append(f"{e.filter}: not causal, a frame's belief uses {later} frames too")
    if model.rule.looks_ahead is not None:
        with plugin_errors(model.rule, "evidence"):
            why = model.rule.looks_ahead(model.parameters)
        if why:
            reasons.append(f"{e.evidence}: not causal, {why}")
    return reasons

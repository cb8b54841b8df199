"""A model: evidence rule, graph and parameters of an experiment, compiled."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.experiment import DETECTOR, FROM_MAP, Experiment
from egolane_pgm.graphs.from_pgmpy import node_names
from egolane_pgm.inference.compile import (
    Compiled,
    compile,
    compile_tables,
    with_initial_lane,
    with_tables,
)
from egolane_pgm.inference.expected_counts import counted_tables, free_numbers
from egolane_pgm.inference.filtering import METHODS, harden, joint_input
from egolane_pgm.loading import IN_MEMORY
from egolane_pgm.parameters import Value, resolve_parameters, smoothing_defaults
from egolane_pgm.plugins import (
    declared_parameters,
    load_plugin,
    plugin_errors,
    plugin_names,
)
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

EvidenceRule = Callable[[LineLog], Evidence]

#: Values of `tuned_on`; a model with two origins has the last one.
_ORIGINS = ("not_tuned", "other_frames", "unknown", "same_frames")


@dataclass(frozen=True, eq=False)
class Model:
    """An experiment, ready for inference.

    - rule, graph: modules of the evidence rule and the graph.
    - parameters: the value of every declared parameter.
    - compiled: the graph with these values.
    - unused: evidence of the rule that the graph does not observe.
    - learned_from: `recording_key` of the training recording of fitted tables; empty for several
      recordings, None for tables of the graph.
    """

    experiment: Experiment
    rule: ModuleType
    graph: ModuleType
    parameters: Mapping[str, Value]
    compiled: Compiled
    unused: frozenset[Observed]
    learned_from: str | None = None

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
        """Number of free parameters: the searched numbers of rule and graph.

        Of a graph without parameters, and of fitted tables, `free_numbers` of the tables count.
        """
        own = () if self.learned_from is not None else getattr(self.graph, "PARAMETERS", ())
        specs = {spec.name: spec for spec in (*getattr(self.rule, "PARAMETERS", ()), *own)}
        total = sum(np.size(self.parameters[n]) for n, spec in specs.items() if spec.is_searched)
        return total + (0 if own else free_numbers(counted_tables(self.compiled)))

    def __getstate__(self) -> dict[str, Any]:
        # Modules are not pickled, but loaded by the names in the experiment.
        return {**vars(self), "rule": None, "graph": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        rule = load_plugin("evidence", state["experiment"].evidence, "evidence")
        graph = load_plugin("graphs", state["experiment"].graph, "graph")
        vars(self).update({**state, "rule": rule, "graph": graph})


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
    rule = load_plugin("evidence", e.evidence, f"{source}: evidence")
    graph = load_plugin("graphs", e.graph, f"{source}: graph")
    declared = declared_parameters(rule, graph)
    specs = smoothing_defaults(declared) if e.filter in ("smoothed", "viterbi") else declared
    given = {name: value for name, value in e.parameters.items() if name != DETECTOR}
    parameters = resolve_parameters(specs, given, e.n_lanes, f"{source}: parameters")
    with problems_in(f"{source}: graph {e.graph}"):
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
    learned = getattr(graph, "LEARNED_FROM", None)
    if learned not in (None, "unknown"):
        origins = (e.tuned_on, tuned_on(experiment, learned))
        experiment = e.model_copy(update={"tuned_on": max(origins, key=_ORIGINS.index)})
    return Model(experiment, rule, graph, parameters, compiled, unused, learned)


def compile_graph(
    rule: ModuleType, graph: ModuleType, n_lanes: int, parameters: Mapping[str, Value]
) -> tuple[Compiled, frozenset[Observed]]:
    """Compile a graph; return it and the evidence of the rule that it does not observe.

    A graph that defines `tables`, HIDDEN and OBSERVED is compiled without pgmpy.
    """
    provides = getattr(rule, "PROVIDES", ())
    has_tables = all(hasattr(graph, name) for name in ("tables", "HIDDEN", "OBSERVED"))
    network = None if has_tables else build_network(graph, n_lanes, parameters)
    if hasattr(graph, "OBSERVED"):
        observed, inputs = graph.OBSERVED, getattr(graph, "INPUTS", ())
        unused = frozenset(getattr(graph, "UNUSED", ())).difference(observed)
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
        inputs = tuple(name for name in getattr(rule, "INPUTS", ()) if name in nodes)
        if not observed:
            raise InputError(
                "observes nothing: the evidence rule gives"
                f" {', '.join(map(str, provides)) or 'nothing (it has no PROVIDES)'}, the graph has"
                f" {', '.join(sorted(nodes))}"
            )
    bounds = getattr(graph, "BOUNDS", {})
    inputs = tuple(dict.fromkeys((*inputs, *bounds)))
    roles = {"observed": observed, "inputs": inputs, "values": getattr(graph, "VALUES", {})}
    if network is None:
        with plugin_errors(graph, "graph"):
            tables = graph.tables(n_lanes, parameters)
        compiled = compile_tables(tables, hidden=graph.HIDDEN, **roles)
    else:
        compiled = compile(network, hidden=getattr(graph, "HIDDEN", None), **roles)
    for name, cuts in bounds.items():
        if not (np.isfinite(cuts).all() and (np.diff(cuts) > 0).all()):
            raise InputError(f"BOUNDS: {name}: {tuple(cuts)} do not increase")
        if (n_values := compiled.cardinality[name]) != len(cuts) + 1:
            raise InputError(f"BOUNDS: {name} has {n_values} values, needs {len(cuts) + 1}")
    return compiled, unused


def build_network(
    graph: ModuleType, n_lanes: int, parameters: Mapping[str, Value]
) -> DynamicBayesianNetwork:
    """Declare a graph in pgmpy. Raises InputError if `build` does not return a network."""
    with plugin_errors(graph, "graph"):
        network = graph.build(n_lanes, parameters)
    if not hasattr(network, "get_cpds"):
        raise InputError(f"build() returned {type(network).__name__}, not a pgmpy network")
    return network


def observed_under(rule: ModuleType, network: Any) -> tuple[Observed, ...]:
    """Return the evidence of a rule whose nodes are in the network."""
    nodes, provides = node_names(network), getattr(rule, "PROVIDES", ())
    return tuple(k for k in provides if nodes.issuperset([k] if isinstance(k, str) else k))


def with_parameters(model: Model, parameters: Mapping[str, Value]) -> Model:
    """Return the model with other values of all parameters.

    Only the tables are computed again, unless an integer or text parameter of the graph changed:
    these may change the shape of the network.
    """
    specs = getattr(model.graph, "PARAMETERS", ())
    shapes = [spec.name for spec in specs if spec.kind in ("integer", "text")]
    same_shape = all(parameters[name] == model.parameters[name] for name in shapes)
    if same_shape and hasattr(model.graph, "tables"):
        with plugin_errors(model.graph, "graph"):
            tables = model.graph.tables(model.n_lanes, parameters)
            compiled = with_tables(model.compiled, tables)
    else:
        compiled, _ = compile_graph(model.rule, model.graph, model.n_lanes, parameters)
        if model.compiled.start is not None:
            compiled = with_initial_lane(compiled, model.compiled.start)
    return replace(model, parameters=parameters, compiled=compiled)


# --- another graph -------------------------------------------------------------------------------


def with_graph(experiment: Experiment, graph: str) -> Experiment:
    """Return the experiment with another graph, a name or a file.

    It keeps the parameters that the new plugins declare, and its evidence rule if that fits the
    graph; otherwise it gets the first rule that fits. `tuned_on` follows a graph with learned
    tables.
    """
    where = f"{experiment.source}: graph"
    module = load_plugin("graphs", graph, where)
    evidence = matching_evidence_rule(module, experiment.n_lanes, experiment.evidence, where)
    rule = load_plugin("evidence", evidence, where)
    known = {DETECTOR, *(spec.name for spec in declared_parameters(rule, module))}
    kept = {name: value for name, value in experiment.parameters.items() if name in known}
    changes = {"graph": graph, "evidence": evidence, "parameters": kept}
    changes["tuned_on"] = tuned_on(experiment, getattr(module, "LEARNED_FROM", None))
    return experiment.model_copy(update=changes)


def tuned_on(experiment: Experiment, learned_from: str | None) -> str:
    """Return `tuned_on` for a graph with fitted tables; None keeps the experiment's."""
    if learned_from is None:
        return experiment.tuned_on
    # Lines in memory have no name, so they may be others.
    if learned_from in ("", "unknown", IN_MEMORY):
        return "unknown"
    return "same_frames" if learned_from == recording_key(experiment) else "other_frames"


def recording_key(experiment: Experiment) -> str:
    """Return a text that identifies the recording of an experiment."""
    recording = experiment.recording
    if recording.simulate is not None:
        return f"{recording.simulate}, seed {recording.seed}, {experiment.n_lanes} lanes"
    return str(recording.path)


def training_key(experiments: Iterable[Experiment]) -> str:
    """Return `Model.learned_from` of a fit to the recordings of some experiments."""
    keys = {*map(recording_key, experiments)}
    return keys.pop() if len(keys) == 1 else ""


def matching_evidence_rule(graph: ModuleType, n_lanes: int, first: str, where: str) -> str:
    """Return the evidence rule that provides what a graph observes, preferably `first`.

    For a plain pgmpy network it is the rule of whose evidence the network observes most.
    """
    names = dict.fromkeys([first, *plugin_names("evidence")])
    rules = {name: load_plugin("evidence", name, where) for name in names}
    if not hasattr(graph, "OBSERVED"):
        specs = getattr(graph, "PARAMETERS", ())
        network = build_network(graph, n_lanes, resolve_parameters(specs, {}, n_lanes))
        return max(rules, key=lambda name: len(observed_under(rules[name], network)))
    seen = set(graph.OBSERVED)
    known = {*seen, *getattr(graph, "UNUSED", ())}
    fits = (n for n, rule in rules.items() if seen <= {*getattr(rule, "PROVIDES", seen)} <= known)
    return next(fits, first)


# --- evidence ------------------------------------------------------------------------------------


def online_rule(model: Model) -> EvidenceRule:
    """Return the evidence rule for frames as they come; it may have a memory.

    A rule without `online` is called for each log separately, without its warnings.
    """
    if hasattr(model.rule, "online"):
        with plugin_errors(model.rule, "evidence"):
            found: EvidenceRule = model.rule.online(model.n_lanes, model.parameters)
        return found

    def alone(log: LineLog) -> Evidence:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found: Evidence = model.rule.evidence(log, model.n_lanes, model.parameters)
            return found

    return alone


def make_evidence(
    model: Model, log: LineLog, rule: EvidenceRule | None = None
) -> tuple[Evidence, FloatArray | None]:
    """Make the evidence of T frames, and the detector's answer (T, n_lanes) or None.

    - rule: by default the model's rule for a whole drive.

    Filled-in frames (`missing_frames: predict`) get a likelihood of one everywhere. Raises
    InputError, naming the rule's file, if the rule does not return evidence of T frames.
    """
    file = model.rule.__file__
    with plugin_errors(model.rule, "evidence"):
        if rule is None:
            given = model.rule.evidence(log, model.n_lanes, model.parameters)
        else:
            given = rule(log)
    if not isinstance(given, Evidence):
        raise InputError(f"{file}: evidence() returned {type(given).__name__}, not Evidence")
    if len(given) != len(log):
        raise InputError(f"{file}: evidence() returned {len(given)} frames for {len(log)}")
    tentative = given.likelihoods.get(getattr(model.rule, "TENTATIVE", ""))
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
    bounds = getattr(model.graph, "BOUNDS", {})
    own = {name: input_of(log, name, cuts) for name, cuts in bounds.items()}
    used = Evidence(likelihoods, {**given.inputs, **own})
    with problems_in(str(file)):
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


def with_inputs(experiment: Experiment, graph: ModuleType | None = None) -> Experiment:
    """Return the experiment whose `recording.columns` also name the graph's inputs (BOUNDS)."""
    graph = graph or load_plugin("graphs", experiment.graph, f"{experiment.source}: graph")
    if not (names := {name: name for name in getattr(graph, "BOUNDS", {})}):
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
    if hasattr(model.rule, "looks_ahead"):
        with plugin_errors(model.rule, "evidence"):
            why = model.rule.looks_ahead(model.parameters)
        if why:
            reasons.append(f"{e.evidence}: not causal, {why}")
    return reasons

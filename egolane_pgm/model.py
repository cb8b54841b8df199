"""A model is an experiment's plugins, checked and compiled; it makes the evidence of a log."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from egolane_pgm.evidence.line_geometry.place import place_finder
from egolane_pgm.experiment import FROM_MAP, Experiment
from egolane_pgm.graphs.from_pgmpy import node_names
from egolane_pgm.inference.compile import (
    Compiled,
    compile,
    compile_tables,
    starting_in,
    with_tables,
)
from egolane_pgm.inference.filtering import read_evidence
from egolane_pgm.inference.layout import check_keys
from egolane_pgm.parameters import Value, looking_back, resolve_parameters
from egolane_pgm.plugins import (
    declared_parameters,
    load_plugin,
    load_rule_and_graph,
    plugin_errors,
    plugin_names,
    plugin_place,
)
from egolane_pgm.types import (
    Evidence,
    FloatArray,
    InputError,
    LineLog,
    Observed,
    problems_in,
)

if TYPE_CHECKING:
    from pgmpy.models import DynamicBayesianNetwork


class Roles(NamedTuple):
    """What the nodes of a graph are under an evidence rule.

    - hidden: None for every node that is neither observed nor an input, and Lane.
    - observed, inputs: the parts of the evidence that the graph takes.
    - unused: the other parts.
    """

    hidden: tuple[str, ...] | None
    observed: tuple[Observed, ...]
    inputs: tuple[str, ...]
    unused: tuple[Observed, ...]


@dataclass(frozen=True)
class Model:
    """An experiment's plugins, checked and compiled. It knows nothing of the recording.

    - rule, graph: the modules of the evidence rule and the graph.
    - parameters: the value of every parameter that they declare.
    - compiled: the graph with these values, as inference takes it.
    - roles: of its nodes.
    """

    rule: ModuleType
    graph: ModuleType
    parameters: Mapping[str, Value]
    compiled: Compiled
    n_lanes: int
    roles: Roles

    def __getstate__(self) -> dict[str, Any]:
        # Modules cannot be pickled: a name or a file stands for each.
        rule, graph = plugin_place(self.rule), plugin_place(self.graph)
        return {**self.__dict__, "rule": rule, "graph": graph}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        rule = load_plugin("evidence", state["rule"], Path(), "evidence")
        graph = load_plugin("graphs", state["graph"], Path(), "graph")
        self.__dict__.update({**state, "rule": rule, "graph": graph})

    @property
    def network(self) -> DynamicBayesianNetwork:
        """The graph in pgmpy, with these values and the names of the nodes' values."""
        return self.compiled.network


def prepare_model(experiment: Experiment, n_lanes: int | None = None) -> Model:
    """Load and compile the experiment's plugins.

    - n_lanes: lanes of the road, in place of the experiment's.

    Raises InputError naming the YAML file and key for unknown plugins and parameters, values out
    of range, and an evidence rule that does not fit the graph.
    """
    source = experiment.source
    n_lanes = experiment.n_lanes if n_lanes is None else n_lanes
    if n_lanes == FROM_MAP:
        raise InputError(
            f"{source}: n_lanes: map: only `egolane run` cuts a recording by its road; here give"
            " the number of one road (road: null, n_lanes: 3)"
        )
    rule, graph = load_rule_and_graph(
        experiment.evidence, experiment.graph, experiment.folder, source
    )
    specs = declared_parameters(rule, graph)
    parameters = resolve_parameters(
        looking_back(specs) if experiment.filter == "smoothed" else specs,
        experiment.parameters,
        n_lanes,
        f"{source}: parameters",
    )
    _check_names(rule, graph, source)
    with problems_in(f"{source}: graph {experiment.graph}"):
        roles, compiled = _compiled(graph, rule, n_lanes, parameters, f"{source}: graph")
    lanes = compiled.cardinality.get("Lane")
    if lanes != n_lanes:
        raise InputError(
            f"{source}: graph {experiment.graph}: needs a hidden node Lane with"
            f" {n_lanes} values, has {lanes or 'none'}"
        )
    if experiment.start_lane is not None:
        compiled = starting_in(compiled, _start_of(experiment))
    return Model(rule, graph, parameters, compiled, n_lanes, roles)


def _start_of(experiment: Experiment) -> FloatArray:
    """How probable each of the n lanes is before the first frame."""
    given = experiment.start_lane
    lanes = np.arange(1, experiment.n_lanes + 1)
    return np.where(lanes == given, 1.0, 0.0) if isinstance(given, int) else np.array(given)


def _compiled(
    graph: ModuleType, rule: ModuleType, n_lanes: int, parameters: Mapping[str, Value], where: str
) -> tuple[Roles, Compiled]:
    """What the nodes of a graph are, and the graph compiled: from its tables where it gives them
    and says what they are about, else from its network."""
    if not all(hasattr(graph, name) for name in ("tables", "HIDDEN", "OBSERVED")):
        network = build_network(graph, n_lanes, parameters, where)
        roles = graph_roles(graph, rule, network)
        return roles, compile_graph(graph, roles, network)
    with plugin_errors(graph, where):
        tables = graph.tables(n_lanes, parameters)
    roles = graph_roles(graph, rule, None)
    return roles, compile_tables(
        tables,
        observed=roles.observed,
        hidden=graph.HIDDEN,
        inputs=roles.inputs,
        values=getattr(graph, "VALUES", {}),
    )


def with_parameters(model: Model, parameters: Mapping[str, Value]) -> Model:
    """The same model with other parameters, every one with its value.

    A graph that defines `tables` gets new numbers in the network that is compiled already. The
    network is declared and compiled anew for any other graph, and where a whole number or a
    text that the graph declares has changed, because that may change the network's shape.
    """
    specs = getattr(model.graph, "PARAMETERS", ())
    shapes = [p.name for p in specs if p.kind in ("integer", "text")]
    same_shape = all(parameters[name] == model.parameters[name] for name in shapes)
    if same_shape and hasattr(model.graph, "tables"):
        with plugin_errors(model.graph, "graph"):
            tables = model.graph.tables(model.n_lanes, parameters)
            compiled = with_tables(model.compiled, tables)
    else:
        network = build_network(model.graph, model.n_lanes, parameters, "graph")
        compiled = compile_graph(model.graph, model.roles, network)
        if model.compiled.start is not None:
            compiled = starting_in(compiled, model.compiled.start)
    return replace(model, parameters=parameters, compiled=compiled)


def build_network(
    graph: ModuleType, n_lanes: int, parameters: Mapping[str, Value], where: str
) -> DynamicBayesianNetwork:
    """Declare a graph in pgmpy.

    - parameters: the value of every parameter that the graph declares.
    - where: the beginning of a message about an error in a user's own file.

    Raises InputError as `plugin_errors` does, and for a `build` that gives no pgmpy network.
    """
    with plugin_errors(graph, where):
        network = graph.build(n_lanes, parameters)
    if not hasattr(network, "get_cpds"):
        raise InputError(f"build() gave {type(network).__name__}, not a pgmpy network")
    return network


def compile_graph(graph: ModuleType, roles: Roles, network: DynamicBayesianNetwork) -> Compiled:
    """Compile a graph that `build_network` declared. Raises InputError as `compile`."""
    with warnings.catch_warnings():
        # A network that knows nothing of us has no virtual-evidence nodes.
        warnings.simplefilter("ignore", UserWarning)
        return compile(
            network,
            hidden=roles.hidden,
            observed=roles.observed,
            inputs=roles.inputs,
            values=getattr(graph, "VALUES", {}),
        )


def graph_roles(graph: ModuleType, rule: ModuleType, network: DynamicBayesianNetwork) -> Roles:
    """What the nodes of a graph are: what the graph says (HIDDEN, OBSERVED, INPUTS, UNUSED), and
    where it does not say it, what follows from the evidence rule.

    What the rule gives (PROVIDES) is then observed where the network has such nodes and else
    unused; the rule's INPUTS are inputs. Raises InputError where nothing would be observed.
    """
    hidden = getattr(graph, "HIDDEN", None)
    if hasattr(graph, "OBSERVED"):
        roles = (getattr(graph, "INPUTS", ()), getattr(graph, "UNUSED", ()))
        return Roles(hidden, graph.OBSERVED, *roles)
    if not hasattr(rule, "PROVIDES"):
        raise InputError(
            "the graph does not say what it observes (OBSERVED), nor the evidence rule what it"
            " gives (PROVIDES)"
        )
    observed = observed_under(rule, network)
    nodes = node_names(network)
    if not observed:
        raise InputError(
            f"observes nothing: the evidence rule gives {', '.join(map(str, rule.PROVIDES))}, the"
            f" graph has {', '.join(sorted(nodes))}"
        )
    inputs = tuple(name for name in getattr(rule, "INPUTS", ()) if name in nodes)
    return Roles(hidden, observed, inputs, tuple(k for k in rule.PROVIDES if k not in observed))


def observed_under(rule: ModuleType, network: DynamicBayesianNetwork) -> tuple[Observed, ...]:
    """The keys of a rule's evidence whose nodes are in the network."""
    nodes = node_names(network)
    provides = getattr(rule, "PROVIDES", ())
    return tuple(k for k in provides if nodes.issuperset([k] if isinstance(k, str) else k))


def fitting_rule(graph: ModuleType, n_lanes: int, first: str, folder: Path, where: str) -> str:
    """The evidence rule that goes with a graph: one that gives all that it observes and nothing
    that it does not know; `first` if it does, or where none does.

    Whole numbers shape a graph's nodes: the rule that knows most of them goes before others. For a
    graph that does not say what it observes it is the rule that gives evidence of most nodes.
    """
    names = dict.fromkeys([first, *plugin_names("evidence")])
    rules = {name: load_plugin("evidence", name, folder, where) for name in names}
    specs = getattr(graph, "PARAMETERS", ())
    if not hasattr(graph, "OBSERVED"):
        parameters = resolve_parameters(specs, {}, n_lanes)
        network = build_network(graph, n_lanes, parameters, where)
        return max(rules, key=lambda name: len(observed_under(rules[name], network)))
    seen = set(graph.OBSERVED)
    known = {*seen, *getattr(graph, "UNUSED", ())}
    shapes = {p.name for p in specs if p.kind == "integer"}
    missing = {
        name: len(shapes - {p.name for p in getattr(rule, "PARAMETERS", ())})
        for name, rule in rules.items()
        if seen <= set(getattr(rule, "PROVIDES", seen)) <= known
    }
    return min(missing, key=missing.__getitem__, default=first)


def causality(
    experiment: Experiment, model: Model, found: Sequence[Mapping[str, Value]] = ({},)
) -> dict[str, Any]:
    """Tell whether a belief about a frame uses the frames up to it only, as results say it.

    - found: values that replace the model's own, a mapping for each block that was run with others.

    Returns `is_causal`; `causal`, which says it of `filter` and `evidence` apart; and
    `why_not_causal`, a line for each of them that looks ahead. An evidence rule that looks ahead
    says so itself: its `looks_ahead(parameters)` gives the reason, or None.
    """
    reasons = []
    if not experiment.has_causal_filter:
        later = "all later" if experiment.lag is None else f"the next {experiment.lag}"
        reasons.append(f"{experiment.filter}: not causal, a frame's belief uses {later} frames too")
    looks_ahead = getattr(model.rule, "looks_ahead", lambda parameters: None)
    with plugin_errors(model.rule, "evidence"):
        ahead = dict.fromkeys(looks_ahead({**model.parameters, **each}) for each in found)
    of_evidence = [f"{experiment.evidence}: not causal, {why}" for why in ahead if why]
    return {
        "is_causal": experiment.has_causal_filter and not of_evidence,
        "causal": {"filter": experiment.has_causal_filter, "evidence": not of_evidence},
        "why_not_causal": reasons + of_evidence,
    }


def _check_names(rule: ModuleType, graph: ModuleType, source: str) -> None:
    provides = getattr(rule, "PROVIDES", None)
    if provides is None or not hasattr(graph, "OBSERVED"):
        return
    taken = graph.OBSERVED
    for key in taken:
        if key not in provides:
            raise InputError(
                f"{source}: the graph observes {key}, the evidence rule gives only"
                f" {', '.join(map(str, provides))}"
            )
    known = {*taken, *getattr(graph, "UNUSED", ())}
    for key in provides:
        if key not in known:
            raise InputError(
                f"{source}: the evidence rule gives {key}, which the graph does not observe;"
                " if that is meant, the graph file says so with UNUSED"
            )


@dataclass(frozen=True)
class RuleOutput:
    """What an evidence rule made of T frames.

    - filtered: the evidence as the filter takes it.
    - tentative: (T, n) the rule's own answer over lanes, rows summing to one; or None.
    - notes: what the rule warned of, a line each.
    """

    filtered: Evidence
    tentative: FloatArray | None
    notes: tuple[str, ...] = ()


def online_output(model: Model, reading: str = "soft") -> Callable[[LineLog], RuleOutput]:
    """A function that makes the evidence of frames as they come, one or a few at a time.

    - reading: the experiment's `evidence_reading`.

    A rule whose evidence depends on earlier frames defines `online(n_lanes, parameters)`, which
    returns a function that remembers them. Any other rule is asked for its `evidence`, and what it
    warns of, seeing a frame alone, is not said. The function raises InputError as `make_evidence`.
    """
    give = _online_rule(model)

    def output_of(log: LineLog) -> RuleOutput:
        given = give(log)
        filtered = _filtered(model, log, given, reading)
        return RuleOutput(filtered, _tentative(model.rule, given, model.n_lanes))

    return output_of


def place_by_lines(model: Model) -> Callable[[LineLog], FloatArray | None]:
    """A function that gives the place in the lane of frames as they come, (T,), as
    `line_geometry.place` finds it; None where the graph has a RoadPosition, which tells better."""
    if "RoadPosition" in model.compiled.values:
        return lambda log: None
    return place_finder(model.parameters)


def _online_rule(model: Model) -> Callable[[LineLog], Evidence]:
    rule = model.rule
    with plugin_errors(rule, "evidence"):
        if hasattr(rule, "online"):
            give = rule.online(model.n_lanes, model.parameters)
        else:
            give = partial(_evidence_alone, rule, model)

    def given_for(log: LineLog) -> Evidence:
        with plugin_errors(rule, "evidence"):
            given: Evidence = give(log)
        return given

    return given_for


def _evidence_alone(rule: ModuleType, model: Model, log: LineLog) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return rule.evidence(log, model.n_lanes, model.parameters)


def make_evidence(model: Model, log: LineLog, reading: str = "soft") -> RuleOutput:
    """Make the evidence of a log of T frames for the model's graph.

    - reading: the experiment's `evidence_reading`.

    The evidence of frames that `missing_frames: predict` put in is 1 for every value of a node.
    Raises InputError, naming the rule's file, for what is no evidence of T frames.
    """
    rule = model.rule
    with plugin_errors(rule, "evidence"), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        given = rule.evidence(log, model.n_lanes, model.parameters)
    filtered = _filtered(model, log, given, reading)
    notes = [str(w.message) for w in caught if issubclass(w.category, UserWarning)]
    tentative = _tentative(rule, given, model.n_lanes)
    return RuleOutput(filtered, tentative, tuple(dict.fromkeys(notes)))


def _filtered(model: Model, log: LineLog, given: Evidence, reading: str) -> Evidence:
    """What a rule gave for a log, checked, as the filter takes it."""
    rule = model.rule
    if not isinstance(given, Evidence):
        raise InputError(f"{rule.__file__}: evidence() gave {type(given).__name__}, not Evidence")
    if len(given) != len(log):
        raise InputError(
            f"{rule.__file__}: evidence() gave {len(given)} frames for the {len(log)} recorded"
        )
    unused = set(model.roles.unused).difference(model.roles.observed)
    if not unused.isdisjoint(given.likelihoods):
        used = {key: values for key, values in given.likelihoods.items() if key not in unused}
        given = Evidence(used, given.inputs)
    if log.is_missing.any():
        blank = {
            key: np.where(log.is_missing.reshape(-1, *[1] * (values.ndim - 1)), 1.0, values)
            for key, values in given.likelihoods.items()
        }
        given = Evidence(blank, given.inputs)
    with problems_in(str(rule.__file__)):
        check_keys(model.compiled, given)
    return read_evidence(given, reading)


def _tentative(rule: ModuleType, evidence: Evidence, n_lanes: int) -> FloatArray | None:
    values = evidence.likelihoods.get(getattr(rule, "TENTATIVE", ""))
    if values is None or values.shape[1:] != (n_lanes,):
        return None
    total = values.sum(axis=1, keepdims=True)
    return np.where(total > 0, values / np.where(total > 0, total, 1), 1 / n_lanes)


def value_names(model: Model) -> dict[str, list[str]]:
    """The names of each hidden node's values."""
    return {node: list(model.compiled.values[node]) for node in model.compiled.hidden}

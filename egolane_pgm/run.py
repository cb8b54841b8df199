"""One experiment end to end: recording -> evidence -> beliefs -> scores -> result directory."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from inspect import signature
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from egolane_pgm.experiment import (
    Experiment,
    config_hash,
    load_experiment,
    resolved,
)
from egolane_pgm.inference.compile import Compiled, compile_network, with_tables
from egolane_pgm.inference.filtering import filter_beliefs, read_evidence
from egolane_pgm.loading import Recorded, load_recording
from egolane_pgm.plugins import load_plugin, plugin_errors
from egolane_pgm.provenance import file_sha256, git_state, versions
from egolane_pgm.results import staged, write_result
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.confusion import accuracy, macro_f1
from egolane_pgm.scoring.summary import score_all
from egolane_pgm.types import (
    UNASSIGNED,
    Beliefs,
    Evidence,
    FloatArray,
    InputError,
    LaneTruth,
    LineLog,
    Parameter,
    Value,
    resolve_parameters,
)
from egolane_pgm.validation import BLOCK_FRAMES, bootstrap_interval, confusion_counts


@dataclass(frozen=True)
class Model:
    """An experiment's plugins, checked and compiled: nothing of the recording is in it.

    rule, graph: the plugin modules. parameters: every declared one with its value.
    """

    rule: ModuleType
    graph: ModuleType
    parameters: Mapping[str, Value]
    compiled: Compiled
    n_lanes: int


@dataclass(frozen=True)
class Run:
    """An experiment that was run.

    tentative (T, n): the evidence rule's own answer over lanes, or None. scores: "model" and,
    with a tentative vector, "detector", as `score_all` gives them; empty without ground truth.
    """

    experiment: Experiment
    model: Model
    recorded: Recorded
    evidence: Evidence
    beliefs: Beliefs
    tentative: FloatArray | None
    scores: Mapping[str, Mapping[str, Any]]
    notes: tuple[str, ...]


def run_experiment(
    experiment: Experiment | str | Path,
    *,
    recorded: Recorded | None = None,
    kernel: bool = True,
) -> Run:
    """Run an experiment (or its YAML file). `recorded`: the recording where it is at hand;
    `kernel=False`: the NumPy twins.

    Raises InputError for whatever does not fit, in one line.
    """
    if not isinstance(experiment, Experiment):
        experiment = load_experiment(experiment)
    model = prepare_model(experiment)
    if recorded is None:
        recorded = load_recording(experiment, model.parameters)
    evidence = make_evidence(model, recorded.log, experiment.evidence_reading, kernel=kernel)
    beliefs = filter_beliefs(
        model.compiled,
        evidence.filtered,
        experiment.filter,
        frame_id=recorded.log.frame_id,
        kernel=kernel,
    )
    notes = list(recorded.notes)
    impossible = int(beliefs.is_impossible.sum())
    if impossible:
        notes.append(
            f"{recorded.log.source}: the evidence of {impossible} frame(s) has joint likelihood"
            " zero; they keep their prediction"
        )
    scores: dict[str, Any] = {}
    if recorded.truth is not None:
        named = {"detector": evidence.tentative, "model": beliefs.lane}
        scores = {
            name: score(recorded, belief, experiment.recording.frame_rate)
            for name, belief in named.items()
            if belief is not None
        }
    return Run(
        experiment,
        model,
        recorded,
        evidence.filtered,
        beliefs,
        evidence.tentative,
        scores,
        tuple(notes),
    )


def score(recorded: Recorded, belief: FloatArray, frame_rate: float) -> dict[str, Any]:
    """Every score of a belief (T, n) over the annotated frames of a recording, and `intervals`:
    95 % block-bootstrap intervals [low, high] of accuracy and f1, None for a short drive."""
    assert recorded.truth is not None
    truth = recorded.truth
    belief = belief[recorded.scored]
    scores = score_all(belief, truth.lane, truth.is_crossing, truth.frame_id, frame_rate)
    return {**scores, "intervals": _intervals(belief, truth)}


def _intervals(belief: FloatArray, truth: LaneTruth) -> dict[str, list[float] | None]:
    statistics = {"accuracy": accuracy, "f1": macro_f1}
    if len(truth) < 2 * BLOCK_FRAMES:
        return dict.fromkeys(statistics)
    assigned = assigned_lane(belief)
    counts = confusion_counts(assigned, truth.lane, truth.is_crossing, belief.shape[1])
    found = {name: bootstrap_interval(counts, of) for name, of in statistics.items()}
    return {name: [interval.low, interval.high] for name, interval in found.items()}


def prepare_model(experiment: Experiment) -> Model:
    """Load and compile the experiment's plugins.

    Raises InputError naming the YAML file and key for unknown plugins and parameters, values out
    of range, and an evidence rule that does not fit the graph.
    """
    source = experiment.source
    rule = load_plugin("evidence", experiment.evidence, experiment.folder, f"{source}: evidence")
    graph = load_plugin("graphs", experiment.graph, experiment.folder, f"{source}: graph")
    parameters = resolve_parameters(
        declared_parameters(rule, graph),
        experiment.parameters,
        experiment.n_lanes,
        f"{source}: parameters",
    )
    _check_fit(rule, graph, source)
    try:
        with plugin_errors(graph, f"{source}: graph"):
            network = graph.build(experiment.n_lanes, parameters)
        if not hasattr(network, "get_cpds"):
            raise InputError(f"build() gave {type(network).__name__}, not a pgmpy network")
        compiled = compile_network(
            network, graph.HIDDEN, graph.OBSERVED, getattr(graph, "INPUTS", ())
        )
    except InputError as error:
        raise InputError(f"{source}: graph {experiment.graph}: {error}") from error
    lanes = compiled.cardinality.get("Lane")
    if lanes != experiment.n_lanes:
        raise InputError(
            f"{source}: graph {experiment.graph}: needs a hidden node Lane with"
            f" {experiment.n_lanes} values, has {lanes or 'none'}"
        )
    return Model(rule, graph, parameters, compiled, experiment.n_lanes)


def with_parameters(model: Model, parameters: Mapping[str, Value]) -> Model:
    """The same model with other (resolved) parameters; only a graph without `tables` is declared
    anew."""
    if hasattr(model.graph, "tables"):
        compiled = with_tables(model.compiled, model.graph.tables(model.n_lanes, parameters))
    else:
        compiled = compile_network(
            model.graph.build(model.n_lanes, parameters),
            model.graph.HIDDEN,
            model.graph.OBSERVED,
            getattr(model.graph, "INPUTS", ()),
        )
    return replace(model, parameters=parameters, compiled=compiled)


def declared_parameters(rule: ModuleType, graph: ModuleType) -> list[Parameter]:
    """The parameters of an evidence rule and a graph; one that both declare is shared."""
    for module in (rule, graph):
        for p in getattr(module, "PARAMETERS", ()):
            if not isinstance(p, Parameter):
                raise InputError(f"{module.__file__}: PARAMETERS has {p!r}, which is no Parameter")
    specs = {p.name: p for p in getattr(rule, "PARAMETERS", ())}
    for p in getattr(graph, "PARAMETERS", ()):
        if p.name in specs and specs[p.name].kind != p.kind:
            raise InputError(f"parameters.{p.name}: graph and evidence rule declare it differently")
        specs[p.name] = p
    return list(specs.values())


def _check_fit(rule: ModuleType, graph: ModuleType, source: str) -> None:
    provides = getattr(rule, "PROVIDES", None)
    if provides is None:
        return
    for key in graph.OBSERVED:
        if key not in provides:
            raise InputError(
                f"{source}: the graph observes {key}, the evidence rule gives only"
                f" {', '.join(map(str, provides))}"
            )
    known = {*graph.OBSERVED, *getattr(graph, "UNUSED", ())}
    for key in provides:
        if key not in known:
            raise InputError(
                f"{source}: the evidence rule gives {key}, which the graph does not observe;"
                " if that is meant, the graph file says so with UNUSED"
            )


@dataclass(frozen=True)
class RuleOutput:
    """filtered: what the filter takes. tentative (T, n), rows summing to one: the rule's own
    answer over lanes, or None."""

    filtered: Evidence
    tentative: FloatArray | None


def make_evidence(
    model: Model, log: LineLog, reading: str = "soft", *, kernel: bool = True
) -> RuleOutput:
    """The evidence of a log for the model's graph; frames put in by `missing_frames: predict`
    say nothing about any node."""
    rule = model.rule
    options = {"kernel": kernel} if "kernel" in signature(rule.evidence).parameters else {}
    with plugin_errors(rule, "evidence"):
        given: Evidence = rule.evidence(log, model.n_lanes, model.parameters, **options)
    if not isinstance(given, Evidence):
        raise InputError(f"{rule.__file__}: evidence() gave {type(given).__name__}, not Evidence")
    if len(given) != len(log):
        raise InputError(
            f"{rule.__file__}: evidence() gave {len(given)} frames for the {len(log)} recorded"
        )
    likelihoods = dict(given.likelihoods)
    for key in getattr(model.graph, "UNUSED", ()):
        if key not in model.compiled.observed:
            likelihoods.pop(key, None)
    if log.is_missing.any():
        for key, values in likelihoods.items():
            blank = log.is_missing.reshape(-1, *[1] * (values.ndim - 1))
            likelihoods[key] = np.where(blank, 1.0, values)
    filtered = read_evidence(Evidence(likelihoods, given.inputs), reading)
    return RuleOutput(filtered, _tentative(rule, given, model.n_lanes))


def _tentative(rule: ModuleType, evidence: Evidence, n_lanes: int) -> FloatArray | None:
    values = evidence.likelihoods.get(getattr(rule, "TENTATIVE", ""))
    if values is None or values.shape[1:] != (n_lanes,):
        return None
    total = values.sum(axis=1, keepdims=True)
    return np.where(total > 0, values / np.where(total > 0, total, 1), 1 / n_lanes)


def save_run(run: Run, directory: str | Path, draw: Callable[[Path], None] | None = None) -> Path:
    """Write a result directory (`results` says what is in it); an existing one is replaced as a
    whole. `draw` is given the directory before it has its name, to add figures.

    Raises InputError where it cannot be written.
    """
    directory = Path(directory)
    content = resolved(run.experiment, run.model.parameters)
    with staged(directory) as folder:
        write_result(
            folder,
            experiment=_portable(run, content, folder),
            run=_provenance(run, content),
            scores=summary(run),
            columns=_columns(run),
        )
        if draw is not None:
            draw(folder)
    return directory


def _portable(run: Run, content: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The config as it can be run from the result directory: plugin files of one's own are copied
    into it, files that lay beside the YAML are named in full."""
    portable = {**content}
    for key, module in (("evidence", run.model.rule), ("graph", run.model.graph)):
        if str(content[key]).endswith(".py") and module.__file__:
            copy = f"{key}_{Path(module.__file__).name}"
            shutil.copyfile(module.__file__, folder / copy)
            portable[key] = f"./{copy}"
    if str(content["recording"]["format"]).endswith(".py"):
        reader = (run.experiment.folder / content["recording"]["format"]).absolute()
        content = {**content, "recording": {**content["recording"], "format": str(reader)}}
        portable["recording"] = content["recording"]
    for key in ("recording", "ground_truth"):
        section = content[key]
        if section and section["path"] and (run.experiment.folder / section["path"]).is_file():
            path = (run.experiment.folder / section["path"]).absolute()
            portable[key] = {**section, "path": str(path)}
    return portable


def summary(run: Run) -> dict[str, Any]:
    """What `--json` and scores.json say: plain, unrounded, documented in `results`."""
    content = {
        "name": run.experiment.name,
        "tuned_on": run.experiment.tuned_on,
        "n_lanes": run.experiment.n_lanes,
        "frames": len(run.beliefs),
        "frames_scored": 0,
        "mean_log_evidence": run.beliefs.mean_log_evidence,
        "impossible_frames": int(run.beliefs.is_impossible.sum()),
        "warnings": list(run.notes),
        **run.scores,
    }
    if run.scores:
        content["frames_scored"] = run.scores["model"]["frames_scored"]
    return content


def _provenance(run: Run, content: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "name": run.experiment.name,
        "config_hash": config_hash(content),
        "data": [
            {"path": str(path), "sha256": file_sha256(path), "bytes": path.stat().st_size}
            for path in run.recorded.files
        ],
        "plugins": _plugin_files(run.model),
        "versions": versions(),
        "git": git_state(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "n_lanes": run.experiment.n_lanes,
        "frame_rate": run.experiment.recording.frame_rate,
        "tuned_on": run.experiment.tuned_on,
        "frames": len(run.beliefs),
        "frames_scored": summary(run)["frames_scored"],
        "mean_log_evidence": run.beliefs.mean_log_evidence,
        "impossible_frames": int(run.beliefs.is_impossible.sum()),
        "warnings": list(run.notes),
        "values": value_names(run.model),
    }


def value_names(model: Model) -> dict[str, list[str]]:
    """The names of each hidden node's values: lanes from 1, the graph's VALUES, else 0, 1, ..."""
    named = getattr(model.graph, "VALUES", {})
    names = {}
    for node in model.compiled.hidden:
        size = model.compiled.cardinality[node]
        default = [str(k + 1 if node == "Lane" else k) for k in range(size)]
        names[node] = [str(v) for v in named.get(node, default)]
    return names


def _columns(run: Run) -> dict[str, np.ndarray[Any, Any]]:
    log, beliefs = run.recorded.log, run.beliefs
    columns: dict[str, np.ndarray[Any, Any]] = {"frame_id": log.frame_id, "time_s": log.time_s}
    for node, names in value_names(run.model).items():
        for k, name in enumerate(names):
            columns[f"{node}_{name}"] = beliefs.marginals[node][:, k]
    columns["assigned_lane"] = assigned_lane(beliefs.lane)
    if run.tentative is not None:
        for k in range(run.experiment.n_lanes):
            columns[f"detector_{k + 1}"] = run.tentative[:, k]
        columns["detector_lane"] = assigned_lane(run.tentative)
    columns["log_evidence"] = beliefs.log_evidence
    columns["is_impossible"] = beliefs.is_impossible
    lane = np.full(len(log), UNASSIGNED)
    crossing = np.zeros(len(log), dtype=bool)
    if run.recorded.truth is not None:
        lane[run.recorded.scored] = run.recorded.truth.lane
        crossing[run.recorded.scored] = run.recorded.truth.is_crossing
    unknown = lane == UNASSIGNED
    columns["true_lane"] = np.ma.masked_array(lane, unknown)
    columns["is_crossing"] = np.ma.masked_array(crossing, unknown)
    return columns


def _plugin_files(model: Model) -> dict[str, dict[str, str]]:
    files = {"evidence": model.rule.__file__, "graph": model.graph.__file__}
    return {
        kind: {"file": Path(f).name, "sha256": file_sha256(Path(f))}
        for kind, f in files.items()
        if f
    }

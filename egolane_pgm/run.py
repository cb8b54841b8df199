"""One experiment end to end: recording -> evidence -> beliefs -> scores -> result directory."""

from __future__ import annotations

import hashlib
import platform
import subprocess
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib import metadata
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
from egolane_pgm.plugins import load_plugin
from egolane_pgm.recordings import read_lines
from egolane_pgm.recordings.catalog import find_file
from egolane_pgm.recordings.ground_truth import read_ground_truth
from egolane_pgm.recordings.select import (
    clip_lri,
    fill_missing,
    join,
    recording_warnings,
    select_frames,
)
from egolane_pgm.results import staged, write_result
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.summary import score_all
from egolane_pgm.types import (
    UNASSIGNED,
    Beliefs,
    Evidence,
    FloatArray,
    InputError,
    IntArray,
    LaneTruth,
    LineLog,
    Parameter,
    Value,
    resolve_parameters,
)


@dataclass(frozen=True)
class Recorded:
    """What an experiment is run on.

    log: T frames. truth: the annotated frames among them, in order, or None. scored (K,): which
    frames of the log those are. files: what was read. notes: what is odd about it, a line each.
    """

    log: LineLog
    truth: LaneTruth | None
    scored: IntArray
    files: tuple[Path, ...]
    notes: tuple[str, ...]


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
        recorded = load_recording(experiment)
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
    """Every score of a belief (T, n) over the annotated frames of a recording."""
    assert recorded.truth is not None
    truth = recorded.truth
    return score_all(
        belief[recorded.scored], truth.lane, truth.is_crossing, truth.frame_id, frame_rate
    )


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
        network = graph.build(experiment.n_lanes, parameters)
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
    specs = {p.name: p for p in (*getattr(rule, "PARAMETERS", ()),)}
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
    given: Evidence = rule.evidence(log, model.n_lanes, model.parameters, **options)
    if len(given) != len(log):
        raise InputError(
            f"evidence rule {rule.__name__}: gave {len(given)} frames for the {len(log)} recorded"
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


def load_recording(experiment: Experiment) -> Recorded:
    """Read and select the frames of an experiment, and join its ground truth.

    Raises InputError for files that cannot be used. What is odd but usable is in `notes`.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        log, truth, files = _read_sources(experiment)
    notes = [str(w.message) for w in caught if issubclass(w.category, UserWarning)]
    recording = experiment.recording
    first, stop = recording.frames or (None, None)
    log = select_frames(log, first, stop)
    log = fill_missing(log, recording.missing_frames, recording.frame_rate)
    max_lri = float(experiment.parameters.get("max_lri", 10))
    if recording.lri == "clip":
        log = clip_lri(log, max_lri)
    notes += recording_warnings(log, experiment.n_lanes, max_lri)
    if truth is None:
        return Recorded(log, None, np.zeros(0, dtype=np.int64), tuple(files), tuple(notes))
    truth.check_lanes(experiment.n_lanes)
    both = join(log, truth)
    if both.log_dropped:
        notes.append(
            f"{log.source}: {both.log_dropped} of {len(log)} frames have no ground truth;"
            " filtered, not scored"
        )
    return Recorded(log, truth.take(both.truth), both.log, tuple(files), tuple(notes))


def _read_sources(experiment: Experiment) -> tuple[LineLog, LaneTruth | None, list[Path]]:
    recording = experiment.recording
    files: list[Path] = []
    truth = None
    if recording.simulate is not None:
        from egolane_pgm.simulation import simulate

        drive = simulate(recording.simulate, seed=recording.seed, n_lanes=experiment.n_lanes)
        log, truth = drive.log, drive.truth
    else:
        assert recording.path is not None
        path = _find(recording.path, experiment, "recording.path")
        files.append(path)
        log = _read_log(path, experiment)
    if experiment.ground_truth is not None:
        path = _find(experiment.ground_truth.path, experiment, "ground_truth.path")
        files.append(path)
        truth = read_ground_truth(path, experiment.ground_truth.extra_rows)
    return log, truth, files


def _find(path: str, experiment: Experiment, key: str) -> Path:
    try:
        return find_file(path, experiment.folder)
    except InputError as error:
        raise InputError(f"{experiment.source}: {key}: {error}") from error


def _read_log(path: Path, experiment: Experiment) -> LineLog:
    recording = experiment.recording
    options: dict[str, Any] = {"frame_rate": recording.frame_rate}
    if recording.topic is not None:
        options["topic"] = recording.topic
    if recording.frame_id != "way_id":
        options["frame_id"] = recording.frame_id
    if recording.format is not None and recording.format.endswith(".py"):
        where = f"{experiment.source}: recording.format"
        reader = load_plugin("recordings", recording.format, experiment.folder, where)
        log: LineLog = reader.read(path, **options)
        return log
    return read_lines(path, recording.format, **options)


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
            experiment=content,
            run=_provenance(run, content),
            scores=summary(run),
            columns=_columns(run),
        )
        if draw is not None:
            draw(folder)
    return directory


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


def file_sha256(path: Path) -> str:
    """The checksum of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _plugin_files(model: Model) -> dict[str, dict[str, str]]:
    files = {"evidence": model.rule.__file__, "graph": model.graph.__file__}
    return {
        kind: {"file": Path(f).name, "sha256": file_sha256(Path(f))}
        for kind, f in files.items()
        if f
    }


def versions(
    packages: Sequence[str] = ("egolane-pgm", "numpy", "numba", "pgmpy", "rosbags", "pyarrow"),
) -> dict[str, str]:
    """Versions of Python and of the packages that numbers depend on."""
    found = {"python": platform.python_version()}
    for name in packages:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


def git_state() -> dict[str, Any] | None:
    """Commit and whether the package's own checkout is dirty; None where it is no checkout."""
    folder = Path(__file__).parent

    def git(*words: str) -> str | None:
        try:
            done = subprocess.run(
                ["git", "-C", str(folder), *words], capture_output=True, text=True, timeout=10
            )
        except (OSError, subprocess.SubprocessError):
            return None
        return done.stdout.strip() if done.returncode == 0 else None

    # An installed package may lie in somebody else's checkout: that commit says nothing of ours.
    if git("ls-files", "--error-unmatch", "run.py") is None:
        return None
    commit, status = git("rev-parse", "HEAD"), git("status", "--porcelain")
    return {"commit": commit, "dirty": bool(status)} if commit else None

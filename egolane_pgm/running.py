"""One experiment end to end: recording -> evidence -> beliefs -> scores -> result directory."""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.experiment import (
    Experiment,
    config_hash,
    load_experiment,
    resolved,
)
from egolane_pgm.inference.events import (
    SURE,
    crossing_probability,
    in_tracks,
    lane_events,
    lane_stretches,
    tracks_of,
)
from egolane_pgm.inference.smoothing import infer_beliefs
from egolane_pgm.inference.viterbi import disagreement, viterbi_path
from egolane_pgm.lane_count import doubt_of_lanes
from egolane_pgm.loading import (
    Recorded,
    as_name,
    data_entries,
    drive_key,
    file_entry,
    files_in_full,
    load_recording,
    name_of,
    with_video_rate,
)
from egolane_pgm.maps.steps import LanesAlong
from egolane_pgm.model import (
    Model,
    RuleOutput,
    causality,
    make_evidence,
    model_to_run,
    prepare_model,
    value_names,
    with_map,
    with_positions,
)
from egolane_pgm.plugins import OWN_FILES, source_files
from egolane_pgm.results import (
    SCHEMA_VERSION,
    Result,
    check_writable,
    provenance,
    read_said,
    staged,
    versions,
    write_result,
)
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.events import event_scores
from egolane_pgm.scoring.road import road_scores
from egolane_pgm.scoring.summary import score_with_intervals, stability_scores
from egolane_pgm.tools.files import code_checksum, plain
from egolane_pgm.tools.jobs import Jobs, in_order, is_elsewhere
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import (
    UNASSIGNED,
    Beliefs,
    Evidence,
    FloatArray,
    InputError,
    IntArray,
    LaneEvents,
    LaneTruth,
    without_passwords,
)

#: Adds figures of a result to the directory that it is given.
Draw = Callable[[Result, Path], None]


@dataclass(frozen=True)
class Run:
    """An experiment that was run.

    experiment: with the frame rate that was counted with.
    evidence, beliefs: of the T frames of the log.
    assigned (T,): the lane that is answered, 1..n or UNASSIGNED.
    tentative (T, n): the evidence rule's own answer over lanes, or None.
    scores: "model" and, with a tentative vector, "detector", as `score_with_intervals` gives them;
        empty without ground truth.
    sure: the share of frames whose lane has a probability of at least SURE; None of no frames.
    lanes: the lane over time (`lane_stretches`); none of several clips.
    events: `told`, how many lane changes the beliefs tell of; with ground truth the scores of
        `event_scores`.
    notes: warnings, a line each.
    seconds: that reading, filtering and scoring took.
    """

    experiment: Experiment
    model: Model
    recorded: Recorded
    evidence: Evidence
    beliefs: Beliefs
    assigned: IntArray
    tentative: FloatArray | None
    scores: Mapping[str, Mapping[str, Any]]
    sure: float | None
    lanes: Sequence[tuple[int, float, float]]
    events: Mapping[str, Any]
    notes: tuple[str, ...]
    seconds: float


def run_experiment(
    experiment: Experiment | str | Path,
    *,
    recorded: Recorded | None = None,
) -> Run:
    """Run an experiment.

    - experiment: an experiment, or its YAML file.
    - recorded: its recording, where it was read already.

    Raises InputError, one line, for whatever does not fit.
    """
    begun = time.perf_counter()
    if not isinstance(experiment, Experiment):
        experiment = load_experiment(experiment)
    experiment = with_map(experiment)
    model = model_to_run(experiment) if recorded is None else prepare_model(experiment)
    if recorded is None:
        experiment = with_video_rate(experiment)
        recorded = load_recording(experiment, model.parameters, clips=True)
    # Each clip of a recording is filtered from the prior on, as a drive of its own.
    logs = [recorded.log.take(piece) for piece in recorded.log.pieces()]
    made: list[RuleOutput] = []
    found: list[Beliefs] = []
    for log in bar(logs, None if len(logs) > 1 else False, unit="clip"):
        made.append(make_evidence(model, log, experiment.evidence_reading, recorded.road))
        of_lines = made[-1].filtered
        if experiment.gnss is not None and recorded.across is not None:
            joint = with_positions(model, log, of_lines, recorded.across, experiment.gnss)
            made[-1] = replace(made[-1], filtered=joint)
        filtered, method, lag = made[-1].filtered, experiment.filter, experiment.lag
        found.append(infer_beliefs(model.compiled, filtered, method, lag, frame_id=log.frame_id))
    evidence, beliefs = joined_outputs(made), Beliefs.joined(found)
    notes = [*recorded.notes, *evidence.notes]
    notes += note_of_impossible(recorded.log.source, int(beliefs.is_impossible.sum()))
    if recorded.log.clip is None and recorded.road is None:
        doubt = doubt_of_lanes(experiment, model, recorded.log, of_lines)
        notes.extend([doubt] if doubt else [])
    assigned = assigned_lane(beliefs.lane, experiment.unassigned_below)
    if experiment.decode == "viterbi":
        assigned = np.zeros(0, dtype=np.int64)
        for log, each, belief in zip(logs, made, found, strict=True):
            path = viterbi_path(model.compiled, each.filtered, frame_id=log.frame_id)
            assigned = np.concatenate([assigned, path.lane])
            doubt = disagreement(path, belief).warning
            notes.extend([doubt] if doubt else [])
    rate = experiment.recording.frame_rate
    road, truth, answered = recorded.road, recorded.truth, assigned
    if road is not None:
        # Lanes that begin and end at the left change numbers, and that is no change of lane.
        found = [in_tracks(beliefs, road.origin)]
        tracks = tracks_of(road.origin)
        answered = np.where(assigned == UNASSIGNED, UNASSIGNED, assigned + tracks)
        if truth is not None:
            rows = recorded.scored
            unsure = truth.is_crossing | road.is_renumbering[rows]
            truth = replace(truth, lane=truth.lane + tracks[rows], is_crossing=unsure)
    changes = LaneEvents.joined(
        [
            lane_events(each, rate, lag=experiment.lag, time_s=log.time_s)
            for each, log in zip(found, logs, strict=True)
        ]
    )
    scores: dict[str, Any] = {}
    events: dict[str, Any] = {"told": len(changes)}
    if recorded.truth is not None and truth is not None:
        crossing = crossing_probability(beliefs.take(recorded.scored).marginals)
        events = event_scores(changes, crossing, truth, rate)
        named = {"detector": evidence.tentative, "model": beliefs.lane}
        # A tentative vector is no belief: the reject option and the path are the model's.
        answers = {"detector": None, "model": assigned[recorded.scored]}
        scores = {
            name: score_with_intervals(
                belief[recorded.scored], recorded.truth, rate, assigned=answers[name]
            )
            for name, belief in named.items()
            if belief is not None
        }
        if road is not None:
            over_time = stability_scores(
                answered[rows], truth.lane, truth.is_crossing, truth.frame_id, rate
            )
            scores["model"] |= over_time
            scores["model"]["road"] = road_scores(
                assigned[rows],
                recorded.truth,
                road.n_lanes[rows],
                road.changes,
                log_frames=rows,
                frame_rate=rate,
            )
    return Run(
        experiment,
        model,
        recorded,
        evidence.filtered,
        beliefs,
        assigned,
        evidence.tentative,
        scores,
        float((beliefs.lane.max(axis=1) >= SURE).mean()) if len(beliefs) else None,
        [] if len(found) > 1 else _stretches(found[0], changes, recorded.log.time_s, road),
        events,
        tuple(notes),
        time.perf_counter() - begun,
    )


def _stretches(
    beliefs: Beliefs, changes: LaneEvents, time_s: FloatArray, road: LanesAlong | None
) -> list[tuple[int, float, float]]:
    """The lane over time; on a road whose lanes change by its number when the stretch begins."""
    found = lane_stretches(beliefs, changes, time_s)
    if road is None:
        return found
    tracks = tracks_of(road.origin)
    frames = np.searchsorted(time_s, [begin for _, begin, _ in found])
    return [
        (lane - int(tracks[k]), begin, end)
        for k, (lane, begin, end) in zip(frames, found, strict=True)
    ]


def joined_outputs(outputs: Sequence[RuleOutput]) -> RuleOutput:
    """What an evidence rule made of several clips, one after the other. Of notes that differ the
    first is kept."""
    first = outputs[0]
    if len(outputs) == 1:
        return first
    vectors = [each.tentative for each in outputs if each.tentative is not None]
    notes = list(dict.fromkeys(note for each in outputs for note in each.notes))
    if len(notes) > 1:
        notes = [f"{notes[0]}; and {len(notes) - 1} more of the like in other clips"]
    return RuleOutput(
        Evidence.joined([each.filtered for each in outputs]),
        np.concatenate(vectors) if len(vectors) == len(outputs) else None,
        tuple(notes),
    )


def save_run(run: Run, directory: str | Path, draw: Draw | None = None) -> Path:
    """Write a result directory; `results` says what is in it. An older one is replaced;
    files of others in it stay.

    - draw: adds figures to the directory before that has its final name.

    Raises InputError where the directory cannot be written. Where only the figures cannot be drawn
    it raises InputError too, and the result is kept without them.
    """
    return save_result(result_of(run), run.experiment, run.model, directory, draw)


def save_result(
    result: Result,
    experiment: Experiment,
    model: Model,
    directory: str | Path,
    draw: Draw | None = None,
) -> Path:
    """Write the result of an experiment as `save_run` does.

    - experiment: knows the folder in which the files lie that the result's config names.
    """
    directory = Path(directory)
    undrawn: InputError | None = None
    with staged(directory) as folder:
        write_result(folder, result, portable(experiment, model, result.experiment, folder))
        try:
            if draw is not None:
                draw(result, folder)
        except InputError as error:
            shutil.rmtree(folder / "figures", ignore_errors=True)
            undrawn = InputError(str(error).replace(str(folder), str(directory)))
    if undrawn is not None:
        raise InputError(f"{undrawn}; the result without figures is in {directory}")
    return directory


def result_of(run: Run) -> Result:
    """What the result directory of a run says."""
    content = resolved(run.experiment, run.model.parameters)
    return make_result(
        run.experiment,
        run.model,
        run.recorded,
        run.beliefs,
        run.tentative,
        run.assigned,
        content=content,
        scores=summary(run),
        notes=run.notes,
        found={"seconds": round(run.seconds, 3)},
    )


def portable(
    experiment: Experiment, model: Model, content: Mapping[str, Any], folder: Path
) -> dict[str, Any]:
    """The resolved config in a form that can be run from a result directory.

    - content: the resolved config.
    - folder: the result directory. The user's own plugin files are copied into it; recordings and
      other files that lie beside the YAML are named by their whole path.
    """
    portable = {**content}
    for key, module in (("evidence", model.rule), ("graph", model.graph)):
        if str(content[key]).endswith(OWN_FILES) and module.__file__:
            copy = f"{key}_{Path(module.__file__).name.removeprefix(f'{key}_')}"
            shutil.copyfile(module.__file__, folder / copy)
            portable[key] = f"./{copy}"
    for key in ("recording", "ground_truth"):
        if content[key]:
            portable[key] = files_in_full(content[key], experiment.folder)
    if content.get("road"):
        portable["road"] = str((experiment.folder / content["road"]).absolute())
    return portable


def summary(run: Run) -> dict[str, Any]:
    """What `--json` and scores.json say: plain, unrounded, documented in `results`."""
    content = {
        "name": run.experiment.name,
        **said_of(run.experiment, run.model, counts_of(run.beliefs, run.recorded.truth), run.notes),
        **run.scores,
        "sure": run.sure,
        "lanes": list(run.lanes),
        "events": dict(run.events),
    }
    if run.recorded.log.clip is not None:
        content["clips"] = len(run.recorded.log.pieces())
    return content


def counts_of(beliefs: Beliefs, truth: LaneTruth | None) -> dict[str, Any]:
    """What run.json and scores.json count: of the beliefs about T frames, and the truth of those
    that are annotated."""
    return {
        "frames": len(beliefs),
        "frames_scored": 0 if truth is None else int(np.count_nonzero(~truth.is_crossing)),
        "mean_log_evidence": beliefs.mean_log_evidence,
        "impossible_frames": int(beliefs.is_impossible.sum()),
    }


def said_of(
    experiment: Experiment, model: Model, counts: Mapping[str, Any], notes: Sequence[str]
) -> dict[str, Any]:
    """What run.json and scores.json both say. counts: as `counts_of`; notes: a line each."""
    return {
        "n_lanes": experiment.n_lanes,
        "tuned_on": experiment.tuned_on,
        **causality(experiment, model),
        **counts,
        "warnings": list(notes),
    }


def provenance_of(
    experiment: Experiment,
    model: Model,
    files: Sequence[Path],
    content: Mapping[str, Any],
    counts: Mapping[str, Any],
    notes: Sequence[str],
) -> dict[str, Any]:
    """The content of run.json, as `results` documents it.

    - files: that were read.
    - content: the resolved config.
    - counts: as `counts_of`.
    - notes: the warnings, a line each.
    """
    return {
        **provenance(experiment.name, content, data_entries(experiment, files)),
        "plugins": plugin_files(model),
        "frame_rate": experiment.recording.frame_rate,
        **said_of(experiment, model, counts, notes),
        "values": value_names(model),
    }


def note_of_impossible(source: str, n_frames: int) -> list[str]:
    """What is noted of frames that the model does not allow, if there are any."""
    said = f"{source}: the evidence of {n_frames} frame(s) has joint likelihood zero; they keep"
    return [f"{said} their prediction"] if n_frames else []


def make_result(
    experiment: Experiment,
    model: Model,
    recorded: Recorded,
    beliefs: Beliefs,
    tentative: FloatArray | None,
    assigned: IntArray | None = None,
    *,
    content: Mapping[str, Any],
    scores: Mapping[str, Any],
    notes: Sequence[str],
    found: Mapping[str, Any] | None = None,
    block: IntArray | None = None,
) -> Result:
    """What a result directory says.

    - beliefs, tentative: of the T frames of the log.
    - assigned: (T,) the lanes that are answered; by default those that the beliefs assign.
    - content: the resolved config.
    - notes: the warnings, a line each.
    - found: keys of run.json beside those of `provenance_of`, or in their place.
    - block: (T,) see `Result`.
    """
    counts = counts_of(beliefs, recorded.truth)
    run = provenance_of(experiment, model, recorded.files, content, counts, notes)
    version = {"schema_version": SCHEMA_VERSION}
    return replace(
        result_rows(experiment, model, recorded, beliefs, tentative, assigned),
        experiment=plain(content),
        run=plain({**version, **run, **(found or {})}),
        scores=plain({**version, **scores}),
        block=block,
    )


def result_rows(
    experiment: Experiment,
    model: Model,
    recorded: Recorded,
    beliefs: Beliefs,
    tentative: FloatArray | None,
    assigned: IntArray | None = None,
) -> Result:
    """What `make_result` says of each frame; of the whole it has the number of lanes only."""
    log, truth = recorded.log, recorded.truth
    if assigned is None:
        assigned = assigned_lane(beliefs.lane, experiment.unassigned_below)
    lane = np.full(len(log), UNASSIGNED)
    crossing = np.zeros(len(log), dtype=bool)
    if truth is not None:
        lane[recorded.scored] = truth.lane
        crossing[recorded.scored] = truth.is_crossing
    values = value_names(model)
    return Result(
        Path(experiment.source),
        {},
        {"n_lanes": experiment.n_lanes},
        {},
        log.frame_id,
        log.time_s,
        {node: beliefs.marginals[node] for node in values},
        {node: tuple(names) for node, names in values.items()},
        tentative,
        assigned,
        None if tentative is None else assigned_lane(tentative),
        lane,
        crossing,
        beliefs.log_evidence,
        beliefs.is_impossible,
        clip=log.clip,
        road_lanes=None if recorded.road is None else recorded.road.n_lanes,
        origin=None if recorded.road is None else recorded.road.origin,
        lines=log,
    )


def plugin_files(model: Model) -> dict[str, dict[str, str]]:
    """The file, or the folder of several, in which a model's evidence rule and graph stand: its
    name and the sha256 of what is in it."""
    found = {}
    for kind, module in (("evidence", model.rule), ("graph", model.graph)):
        files = source_files(module)
        named = files[0].parent if len(files) > 1 else files[0]
        content = b"".join(file.read_bytes() for file in files)
        found[kind] = {"file": named.name, "sha256": hashlib.sha256(content).hexdigest()}
    return found


@dataclass(frozen=True)
class PlannedRun:
    """One of several runs that are to be done.

    - title: its name in messages.
    - directory: of its result.
    - experiment: None where it could not be used; then `error` says why.
    """

    title: str
    directory: Path
    experiment: Experiment | None
    error: str | None = None


@dataclass(frozen=True)
class FinishedRun:
    """What became of a planned run: its `summary`, or else why it failed, in one line; the run
    itself, where it was kept instead of written; the seconds that it took; whether its result was
    there already; and of one of a fleet which drive it is of, see `loading.drive_key`."""

    title: str
    directory: Path
    summary: Mapping[str, Any] | None
    error: str | None
    run: Run | None = None
    seconds: float | None = None
    was_there: bool = False
    drive: str | None = None


def name_runs(
    experiments: Sequence[str], recordings: Sequence[str]
) -> list[tuple[str, str, str | None, str | None]]:
    """Name each of several runs: several experiments, or one on several recordings.

    Returns per run its title, the file of its experiment, its recording and its name. A recording
    of None is the experiment's own, a name of None the one that the run has without it; `*` in a
    name stands for the experiment's. Recordings with the same file name are named after their
    folders too. Raises InputError for a recording that is given twice.
    """
    places = [os.path.realpath(recording) for recording in recordings]
    for k, place in enumerate(places):
        if place in places[:k]:
            raise InputError(f"--recording {recordings[k]}: is named twice")
    stems = [name_of(recording) for recording in recordings]
    if len(experiments) > 1 or not recordings:
        given, name = (recordings[0], f"{stems[0]}_*") if recordings else (None, None)
        return [(path, path, given, name) for path in experiments]
    folders = [Path(without_passwords(name)).absolute().parent.name for name in recordings]
    names = [
        as_name(f"{folder}_{stem}") if stems.count(stem) > 1 else None
        for folder, stem in zip(folders, stems, strict=True)
    ]
    return [
        (given, experiments[0], given, name) for given, name in zip(recordings, names, strict=True)
    ]


def plan_runs(
    sources: Sequence[tuple[str, Callable[[], Experiment]]], folder: Path | None = None
) -> list[PlannedRun]:
    """Plan one run per source.

    - sources: title of each, and a function that loads its experiment. What cannot be loaded
      becomes a run that fails.
    - folder: each result is written to `folder`/<name of the experiment>; None where they are kept.

    Raises InputError where two would write the same directory, or `folder` cannot be written.
    """
    runs: list[PlannedRun] = []
    taken: dict[Path, str] = {}
    for title, load in sources:
        try:
            experiment = load()
        except InputError as error:
            lines = "\n".join(error.lines)
            runs.append(PlannedRun(title, folder or Path(), None, lines))
            continue
        directory = (folder or Path()) / experiment.name
        if taken.get(directory) == title:
            raise InputError(f"{title}: is named twice")
        if directory in taken:
            raise InputError(
                f"{title}: would write {directory}, as {taken[directory]} does; give one of them"
                " another `name`"
            )
        if folder is not None:
            check_writable(directory)
        taken[directory] = title
        runs.append(PlannedRun(experiment.name, directory, experiment))
    return runs


def run_all(
    runs: Sequence[PlannedRun],
    *,
    jobs: Jobs = 1,
    draw: Draw | None = None,
    keep: bool = False,
    resume: bool = False,
) -> Iterator[FinishedRun]:
    """Do several runs and write their results; yields what became of each, in order, as soon as
    those before it are done.

    - jobs: number of processes that share the runs, or a cluster.
    - draw: as in `save_run`.
    - keep: whether runs are kept instead of written.
    - resume: whether a result that is there already is taken, where it was made from the same
      files, with the same config and the same code; and each tells its drive.

    A run for which another machine read other files than lie here under their names fails.
    """
    work = partial(_finish, draw=draw, keep=keep, resume=resume)
    found = in_order(work, runs, jobs, died=_failed)
    yield from map(_checked, runs, found) if is_elsewhere(jobs) else found


def _failed(run: PlannedRun, error: str) -> FinishedRun:
    return FinishedRun(run.title, run.directory, None, error)


def _finish(run: PlannedRun, draw: Draw | None, keep: bool, resume: bool) -> FinishedRun:
    if run.experiment is None:
        return _failed(run, run.error or "")
    try:
        stored = stored_result(run.experiment, run.directory) if resume else None
        if stored is None:
            done = run_experiment(run.experiment)
            if not keep:
                save_run(done, run.directory, draw)
        # Labels are read anew for it, so only where somebody asks.
        drive = drive_key(run.experiment) if resume else None
    except InputError as error:
        return _failed(run, "\n".join(error.lines))
    except Exception as error:
        # A fault of ours in one run must not cost the others what they computed.
        return _failed(run, " ".join(f"{type(error).__name__}: {error}".split()))
    if stored is not None:
        said, scores = stored
        del scores["schema_version"]
        seconds = said.get("seconds")
        return FinishedRun(run.title, run.directory, scores, None, None, seconds, True, drive)
    kept = done if keep else None
    found = plain(summary(done))
    seconds = round(done.seconds, 3)
    return FinishedRun(run.title, run.directory, found, None, kept, seconds, False, drive)


def _checked(run: PlannedRun, done: FinishedRun) -> FinishedRun:
    """What another machine made of a run, if it read what lies here."""
    if run.experiment is None or done.error is not None or done.run is not None:
        return done
    try:
        other = _other_file(run.experiment, read_said(done.directory)[0])
    except (InputError, OSError) as error:
        return _failed(run, f"cannot be compared with what its worker read: {error}")
    if other is None:
        return done
    return _failed(run, f"{other}: its worker read another content under this name than lies here")


def _other_file(experiment: Experiment, said: Mapping[str, Any]) -> str | None:
    """The first file whose content is another than run.json says that it was, or None."""
    has_pictures = experiment.recording.detector is not None
    for entry in said["data"]:
        if file_entry(Path(entry["path"]), pictures=has_pictures) != entry:
            return str(entry["path"])
    return None


def stored_result(
    experiment: Experiment, directory: Path
) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """What run.json and scores.json say of the result in a directory, where it is whole and was
    made with this config, from these files as they are now, and with this code; else None."""
    try:
        said, scores = read_said(directory)
        experiment = with_map(experiment)
        model = model_to_run(experiment)
        content = resolved(with_video_rate(experiment), model.parameters)
        made_by: dict[str, Any] = {
            "config_hash": config_hash(content),
            "code": code_checksum(),
            "plugins": plugin_files(model),
            "versions": versions(),
        }
        is_same = all(said.get(key) == value for key, value in made_by.items())
        is_same = is_same and _other_file(experiment, said) is None
    except (InputError, OSError):
        return None
    return (said, scores) if is_same else None

"""One experiment end to end: recording -> evidence -> beliefs -> scores; or several of them."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.drive import (
    Drive,
    Recorded,
    as_name,
    data_entries,
    drive_key,
    evidence_on,
    file_entry,
    most_lanes,
    name_of,
    open_drive,
    source_of,
    with_own_rate,
)
from egolane_pgm.experiment import (
    FROM_MAP,
    Experiment,
    config_hash,
    load_experiment,
    resolved,
)
from egolane_pgm.inference.events import (
    SURE,
    across_lanes,
    lane_stretches,
)
from egolane_pgm.inference.filtering import piece_frames, step
from egolane_pgm.inference.layout import FilterState
from egolane_pgm.inference.smoothing import infer_beliefs
from egolane_pgm.inference.viterbi import disagreement, viterbi
from egolane_pgm.model import (
    Model,
    causality,
    online_output,
    place_by_lines,
    prepare_model,
    value_names,
)
from egolane_pgm.recordings.source import Read
from egolane_pgm.results import (
    BELIEFS,
    SCHEMA_VERSION,
    Result,
    check_writable,
    git_state,
    provenance,
    read_said,
    staged,
    versions,
    write_rest,
)
from egolane_pgm.scoring.assign import assigned_lane
from egolane_pgm.scoring.events import event_scores
from egolane_pgm.scoring.summary import score_with_intervals, stability_scores
from egolane_pgm.tools.files import arrow_table, parquet_writer, plain
from egolane_pgm.tools.jobs import Jobs, in_order
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import (
    NOTE,
    UNASSIGNED,
    Beliefs,
    BoolArray,
    Evidence,
    FloatArray,
    InputError,
    IntArray,
)

#: The keys that run.json and scores.json share.
_SHARED_KEYS = (
    *("n_lanes", "tuned_on", "is_causal", "causal", "why_not_causal", "frames", "frames_scored"),
    *("mean_log_evidence", "impossible_frames", "warnings"),
)

#: A drive that is run in parts has about this many frames in each.
PART_FRAMES = 2**14

#: A warning in a result that was run in parts.
LEFT_OUT = (
    f"{NOTE}run in parts: what is noted of all lines together (lane width, number of lanes) is left"
    " out"
)


@dataclass(frozen=True)
class Believed:
    """What a model made of T frames.

    - beliefs: with the ids of the frames.
    - assigned (T,): the lane that is answered, 1..n or UNASSIGNED.
    - tentative (T, n): the evidence rule's own answer, or None.
    - crossing, place_in_lane (T,): see `Result`.
    - evidence: what was filtered; None where it was not kept, or is of several numbers of lanes.
    - notes: warnings, a line each.
    """

    beliefs: Beliefs
    assigned: IntArray
    tentative: FloatArray | None = None
    crossing: FloatArray | None = None
    place_in_lane: FloatArray | None = None
    evidence: Evidence | None = None
    notes: tuple[str, ...] = ()

    @classmethod
    def joined(cls, parts: Sequence[Believed]) -> Believed:
        """What was made of several clips, or parts of a drive, one after the other. Of notes that
        differ the first is kept."""
        if len(parts) == 1:
            return parts[0]
        notes = list(dict.fromkeys(note for part in parts for note in part.notes))
        if len(notes) > 1:
            notes = [f"{notes[0]}; and {len(notes) - 1} more of the like in other clips"]
        evidence = [part.evidence for part in parts if part.evidence is not None]
        return cls(
            Beliefs.joined([part.beliefs for part in parts]),
            np.concatenate([part.assigned for part in parts]),
            _joined([part.tentative for part in parts]),
            _joined([part.crossing for part in parts]),
            _joined([part.place_in_lane for part in parts]),
            Evidence.joined(evidence) if len(evidence) == len(parts) else None,
            tuple(notes),
        )


def _joined(parts: Sequence[FloatArray | None]) -> FloatArray | None:
    there = [part for part in parts if part is not None]
    return np.concatenate(there) if len(there) == len(parts) else None


def run_experiment(
    experiment: Experiment | str | Path,
    *,
    recorded: Recorded | None = None,
    read: Read | None = None,
) -> Result:
    """Run an experiment.

    - experiment: an experiment, or its YAML file.
    - recorded: its recording, where it was read and joined already.
    - read: lines and lanes in memory, see `recordings.memory.in_memory`.

    Raises InputError, one line, for whatever does not fit.
    """
    begun = time.perf_counter()
    if not isinstance(experiment, Experiment):
        experiment = load_experiment(experiment)
    drive = open_drive(experiment, recorded=recorded, read=read, clips=True)
    # Each clip is filtered from the prior on, as a drive of its own.
    clips = drive.recorded.clips()
    shown = bar(clips, None if len(clips) > 1 else False, unit="clip")
    parts = [believe(replace(drive, recorded=clip)) for clip in shown]
    return scored_result(drive, Believed.joined(parts), begun)


def believe(drive: Drive) -> Believed:
    """Filter a drive of T frames: what the experiment's model makes of its lines."""
    if drive.recorded.road_lanes is not None:
        n_lanes = int(drive.recorded.road_lanes[0])
        if n_lanes != drive.n_lanes:
            narrow = replace(drive, model=prepare_model(drive.experiment, n_lanes))
            return _widened(_believe(narrow), drive.model)
    return _believe(drive)


def _widened(believed: Believed, model: Model) -> Believed:
    """What was made of a road with fewer lanes than a model's: those that it lacks, and other
    values that it lacks, have probability 0."""

    def wide(values: FloatArray, size: int) -> FloatArray:
        return np.pad(values, ((0, 0), (0, size - values.shape[1])))

    size, beliefs = model.compiled.cardinality, believed.beliefs
    marginals = {node: wide(each, size[node]) for node, each in beliefs.marginals.items()}
    tentative = None if believed.tentative is None else wide(believed.tentative, model.n_lanes)
    beliefs = replace(beliefs, marginals=marginals, values={})
    return replace(believed, beliefs=beliefs, tentative=tentative, evidence=None)


def _believe(drive: Drive) -> Believed:
    experiment, model, log = drive.experiment, drive.model, drive.recorded.log
    output = evidence_on(drive, model)
    filtered, method = output.filtered, experiment.filter
    beliefs = infer_beliefs(model.compiled, filtered, method, experiment.lag, frame_id=log.frame_id)
    notes = [*output.notes]
    if experiment.decode == "viterbi":
        path = viterbi(model.compiled, filtered, frame_id=log.frame_id)
        assigned = path.lane
        notes += filter(None, [disagreement(path, beliefs)])
    else:
        assigned = assigned_lane(beliefs.lane, experiment.unassigned_below)
    return Believed(
        beliefs,
        assigned,
        output.tentative,
        **across_lanes(beliefs.marginals, place_by_lines(model)(log)),
        evidence=filtered,
        notes=tuple(notes),
    )


# --- the result --------------------------------------------------------------------------------


def scored_result(drive: Drive, believed: Believed, begun: float) -> Result:
    """The result of a run.

    - believed: all T frames of the drive.
    - begun: `time.perf_counter()` when it began.
    """
    recorded = drive.recorded
    n_impossible = int(believed.beliefs.is_impossible.sum())
    notes = [*recorded.notes, *believed.notes]
    if n_impossible:
        notes.append(
            f"{recorded.log.source}: the evidence of {n_impossible} frame(s) has joint likelihood"
            " zero; they keep their prediction"
        )
    rows = result_rows(drive, believed)
    run = run_document(drive, rows, notes)
    rows = replace(rows, run=run, config=plain(resolved(drive.experiment, drive.model.parameters)))
    scores = scores_document(rows, drive)
    seconds = round(time.perf_counter() - begun, 3)
    return replace(rows, run=plain({**run, "seconds": seconds}), scores=plain(scores))


def result_rows(drive: Drive, believed: Believed) -> Result:
    """A result with the columns only: of config, run.json and scores.json it has n_lanes."""
    recorded, beliefs = drive.recorded, believed.beliefs
    log, truth = recorded.log, recorded.truth
    lane = np.full(len(log), UNASSIGNED)
    crossing = np.zeros(len(log), dtype=bool)
    if truth is not None:
        lane[recorded.scored] = truth.lane
        crossing[recorded.scored] = truth.is_crossing
    names = {n: tuple(v) for n, v in value_names(drive.model).items() if n in beliefs.marginals}
    return Result(
        directory=Path(drive.experiment.source),
        experiment=drive.experiment,
        config={},
        run={"n_lanes": drive.n_lanes},
        scores={},
        frame_id=log.frame_id,
        time_s=log.time_s,
        marginals={node: beliefs.marginals[node] for node in names},
        values=names,
        tentative=believed.tentative,
        assigned_lane=believed.assigned,
        true_lane=lane,
        is_crossing=crossing,
        log_evidence=beliefs.log_evidence,
        is_impossible=beliefs.is_impossible,
        crossing=believed.crossing,
        place_in_lane=believed.place_in_lane,
        clip=log.clip,
        road_lanes=recorded.road_lanes,
        lines=log,
        evidence=believed.evidence,
        compiled=drive.model,
    )


def run_document(
    drive: Drive, rows: Result, notes: Sequence[str], **changes: Any
) -> dict[str, Any]:
    """The content of run.json.

    - notes: warnings, a line each.
    - changes: keys of the config that are not the experiment's.
    """
    experiment, model = drive.experiment, drive.model
    content = {**resolved(experiment, model.parameters), **changes}
    files = data_entries(experiment, drive.recorded.files)
    return {
        "schema_version": SCHEMA_VERSION,
        **provenance(experiment.name, content, files),
        "frame_rate": experiment.recording.frame_rate,
        "n_lanes": drive.n_lanes,
        "tuned_on": experiment.tuned_on,
        **causality(experiment, model),
        "frames": len(rows),
        "frames_scored": int(np.count_nonzero(~rows.is_crossing[rows.scored])),
        "mean_log_evidence": rows.beliefs.mean_log_evidence,
        "impossible_frames": int(rows.is_impossible.sum()),
        "warnings": list(notes),
        "values": value_names(model),
    }


def scores_document(result: Result, drive: Drive, kept: BoolArray | None = None) -> dict[str, Any]:
    """The content of scores.json, from the columns and the run.json of a result.

    - kept (K,): the annotated frames that are scored; all by default.
    """
    rate, told, lane = float(result.run["frame_rate"]), result.told, result.marginals["Lane"]
    truth, rows = result.truth, result.scored
    scores: dict[str, Any] = {}
    events: dict[str, Any] = {"told": len(told)}
    if truth is not None and kept is not None:
        truth, rows = truth.take(kept), rows[kept]
    if truth is not None:
        moved = result.renumbered[rows]
        same = replace(truth, lane=truth.lane + moved)
        crossing = None if result.crossing is None else result.crossing[rows]
        events = event_scores(result.with_same_lanes(told), crossing, same, rate)
        assigned = result.assigned_lane[rows]
        if result.tentative is not None:
            # A tentative vector is no belief: the reject option and the path are the model's.
            scores["detector"] = score_with_intervals(result.tentative[rows], truth, rate)
        scores["model"] = score_with_intervals(lane[rows], truth, rate, assigned=assigned)
        if result.road_lanes is not None:
            answered = np.where(assigned == UNASSIGNED, UNASSIGNED, assigned + moved)
            crosses, ids = truth.is_crossing, truth.frame_id
            scores["model"] |= stability_scores(answered, same.lane, crosses, ids, rate)
    is_one = result.clip is None
    stretches = lane_stretches(result.beliefs, told, result.time_s) if is_one else []
    content = {
        "schema_version": SCHEMA_VERSION,
        "name": drive.experiment.name,
        **{key: result.run[key] for key in _SHARED_KEYS},
        "frames_scored": 0 if truth is None else int(np.count_nonzero(~truth.is_crossing)),
        **scores,
        "sure": float((lane.max(axis=1) >= SURE).mean()) if len(lane) else None,
        "lanes": stretches,
        "events": events,
    }
    if not is_one:
        content["clips"] = len(drive.recorded.log.pieces())
    return content


# --- a long drive ------------------------------------------------------------------------------


def run_in_parts(
    experiment: Experiment, directory: str | Path, advance: Callable[[int], Any] = int
) -> Result:
    """Run an experiment on a long drive: beliefs are made and written part after part, so that not
    all of them are held at once. An older result is replaced; other files are left alone.

    - advance: called after each part with the number of its frames.

    The numbers are those of `run_experiment`; of the result that is returned `marginals` has Lane
    only. Raises InputError, one line, for whatever does not fit, for what needs the whole drive,
    and where the directory cannot be written: then it is as it was.
    """
    begun, directory = time.perf_counter(), Path(directory)
    drive = open_drive(experiment, check=_check_parts)
    ahead = causality(drive.experiment, drive.model)["why_not_causal"]
    if ahead:
        raise InputError(
            *(f"{experiment.source}: evidence: {why}; that is not run in parts" for why in ahead)
        )
    kept: list[Believed] = []
    with staged(directory) as folder:
        with parquet_writer(folder / BELIEFS) as write:
            for part, believed in _parts(drive):
                write(arrow_table(result_rows(replace(drive, recorded=part), believed).columns()))
                beliefs = replace(believed.beliefs, marginals={"Lane": believed.beliefs.lane})
                kept.append(replace(believed, beliefs=beliefs, evidence=None))
                advance(len(believed.beliefs))
        whole = replace(Believed.joined(kept), notes=(LEFT_OUT,))
        result = replace(scored_result(drive, whole, begun), directory=directory)
        write_rest(folder, result)
    return result


def _check_parts(experiment: Experiment) -> None:
    """Raise InputError, naming the key, where a belief needs more than the frames up to its own."""
    why = ""
    if not experiment.has_causal_filter:
        why = f"filter: {experiment.filter} uses later frames"
    elif experiment.n_lanes == FROM_MAP:
        why = "n_lanes: map: a recording is cut as a whole"
    if why:
        raise InputError(f"{experiment.source}: {why}; that is not run in parts")


def _parts(drive: Drive) -> Iterator[tuple[Recorded, Believed]]:
    """The parts of a drive, each believed with what is known from those before it."""
    model, experiment, recorded = drive.model, drive.experiment, drive.recorded
    piece = piece_frames(model.compiled)
    size = max(1, PART_FRAMES // piece) * piece
    # The last part has up to half a piece more, so that the filter cuts as it does a whole drive.
    last = max(1, -((piece // 2 - len(recorded.log)) // size))
    borders = [*range(0, last * size, size), len(recorded.log)]
    output_of = online_output(model, experiment.evidence_reading)
    place_of = place_by_lines(model)
    state: FilterState | None = None
    for start, stop in pairwise(borders):
        part = recorded.take(slice(start, stop))
        output = output_of(part.log)
        state, beliefs = step(model.compiled, state, output.filtered, experiment.filter)
        beliefs = replace(beliefs, frame_id=part.log.frame_id)
        assigned = assigned_lane(beliefs.lane, experiment.unassigned_below)
        across = across_lanes(beliefs.marginals, place_of(part.log))
        yield part, Believed(beliefs, assigned, output.tentative, **across)


# --- several runs ------------------------------------------------------------------------------

#: How an experiment becomes a result: `run_experiment`, or `held_out.run_held_out`.
Way = Callable[..., Result]


@dataclass(frozen=True)
class OneOfSeveral:
    """One of several runs, planned or done.

    - title: its name in messages.
    - directory: of its result.
    - experiment: None where it could not be loaded.
    - error: why it failed, in one line or several; None of one that did not.
    - scores: what scores.json says, once it is done.
    - result: where it was kept instead of written.
    - seconds: how long it took.
    - was_there: whether its result was there already.
    - drive: key of the drive (fleets only), see `drive.drive_key`.
    - read: lines and lanes in memory, see `run_experiment`.
    """

    title: str
    directory: Path
    experiment: Experiment | None
    error: str | None = None
    scores: Mapping[str, Any] | None = None
    result: Result | None = None
    seconds: float | None = None
    was_there: bool = False
    drive: str | None = None
    read: Read | None = None


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
            raise InputError(f"recording: {recordings[k]}: is named twice")
    stems = [name_of(recording) for recording in recordings]
    if len(experiments) > 1 or not recordings:
        given, name = (recordings[0], f"{stems[0]}_*") if recordings else (None, None)
        return [(path, path, given, name) for path in experiments]
    folders = [Path(name).absolute().parent.name for name in recordings]
    names = [
        as_name(f"{folder}_{stem}") if stems.count(stem) > 1 else None
        for folder, stem in zip(folders, stems, strict=True)
    ]
    return [
        (given, experiments[0], given, name) for given, name in zip(recordings, names, strict=True)
    ]


def plan_runs(
    sources: Sequence[tuple[str, Callable[[], Experiment]]], folder: Path | None = None
) -> list[OneOfSeveral]:
    """Plan one run per source.

    - sources: title of each, and a function that loads its experiment. What cannot be loaded
      becomes a run that fails.
    - folder: each result is written to `folder`/<name of the experiment>; None where they are kept.

    Raises InputError where two would write the same directory, or `folder` cannot be written.
    """
    runs: list[OneOfSeveral] = []
    taken: dict[Path, str] = {}
    for title, load in sources:
        try:
            experiment = load()
        except InputError as error:
            runs.append(OneOfSeveral(title, folder or Path(), None, str(error)))
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
        runs.append(OneOfSeveral(experiment.name, directory, experiment))
    return runs


def run_all(
    runs: Sequence[OneOfSeveral],
    way: Way = run_experiment,
    *,
    jobs: Jobs = 1,
    figures: bool = False,
    keep: bool = False,
    resume: bool = False,
) -> Iterator[OneOfSeveral]:
    """Do several runs and write their results; yields each, in order, as soon as those before it
    are done.

    - way: makes the result of each.
    - jobs: number of processes that share the runs, or a cluster.
    - figures: as in `Result.save`.
    - keep: whether results are kept instead of written.
    - resume: whether a result that is there already is taken, where it was made from the same
      files, with the same config and versions; and each tells its drive.
    """
    work = partial(_finish, way=way, figures=figures, keep=keep, resume=resume)
    yield from in_order(work, runs, jobs, died=lambda run, error: replace(run, error=error))


def _finish(run: OneOfSeveral, way: Way, figures: bool, keep: bool, resume: bool) -> OneOfSeveral:
    if run.experiment is None:
        return run
    try:
        # Labels are read anew for it, so only where somebody asks.
        drive = drive_key(run.experiment) if resume else None
        stored = stored_result(run.experiment, run.directory) if resume else None
        if stored is not None:
            said, scores = stored
            seconds = said.get("seconds")
            return replace(run, scores=scores, seconds=seconds, was_there=True, drive=drive)
        done = way(run.experiment, read=run.read)
        if not keep:
            done.save(run.directory, figures=figures)
    except InputError as error:
        return replace(run, error=str(error))
    except Exception as error:
        # A fault of ours in one run must not cost the others what they computed.
        return replace(run, error=" ".join(f"{type(error).__name__}: {error}".split()))
    kept = done if keep else None
    seconds = done.run["seconds"]
    return replace(run, scores=done.scores, result=kept, seconds=seconds, drive=drive)


def stored_result(
    experiment: Experiment, directory: Path
) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """What run.json and scores.json say of the result in a directory, where it is whole and was
    made with this config and these versions, from these files as they are now; else None."""
    try:
        said, scores = read_said(directory)
        experiment = with_own_rate(experiment)
        model = prepare_model(experiment, most_lanes(experiment))
        made_by: dict[str, Any] = {
            "config_hash": config_hash(resolved(experiment, model.parameters)),
            "versions": versions(),
            "git": git_state(),
        }
        files_in = source_of(experiment).files_in
        is_same = all(said.get(key) == value for key, value in made_by.items()) and all(
            file_entry(Path(entry["path"]), files_in) == entry for entry in said["data"]
        )
    except (InputError, OSError):
        return None
    return (said, scores) if is_same else None

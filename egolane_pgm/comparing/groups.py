"""Experiments side by side, held out, recording by recording."""

from __future__ import annotations

import itertools
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.comparing.choose import Known, experiment_key, losses_by_experiment, plan
from egolane_pgm.comparing.detector_health import detector_answers, detector_health, model_health
from egolane_pgm.comparing.in_sample import with_graph
from egolane_pgm.comparing.placing import load_for_scoring, on_recording, recording_key
from egolane_pgm.comparing.saving import folder_of, save_comparison
from egolane_pgm.comparing.side import Side, held_out_side
from egolane_pgm.experiment import Experiment, load_experiment
from egolane_pgm.loading import Recorded
from egolane_pgm.model import Drive, causality, prepare_model
from egolane_pgm.paper import load_published, paper_experiment, parameters_for
from egolane_pgm.parallel import in_order
from egolane_pgm.results import SCHEMA_VERSION
from egolane_pgm.scoring.bootstrap import score_counts, score_intervals
from egolane_pgm.scoring.health import detector_errors
from egolane_pgm.scoring.held_out import N_BLOCKS
from egolane_pgm.scoring.summary import score_with_intervals
from egolane_pgm.types import BoolArray, InputError


@dataclass(frozen=True)
class Group:
    """Experiments on one recording; differences are to the first.

    title: names the recording in tables and directories.
    run: the number of the paper's run, or None.
    detector: experiments of which the first with a tentative vector says what the detector alone
        answers.
    """

    title: str
    run: int | None
    experiments: tuple[Experiment, ...]
    detector: tuple[Experiment, ...] = ()


@dataclass(frozen=True)
class Options:
    """How experiments are compared.

    blocks: the number of blocks, each held out in turn.
    trials: the trials of each search; None for what the experiment says.
    health: whether to score how well each experiment tells that the detector is wrong.
    out: where result directories go; None for nowhere.
    """

    blocks: int = N_BLOCKS
    trials: int | None = None
    health: bool = False
    out: Path | None = None


def by_recording(experiments: Sequence[Experiment]) -> list[Group]:
    """Group experiments by what they are run on. Raises InputError for a name that occurs twice in
    a group."""
    found: dict[str, list[Experiment]] = {}
    for experiment in experiments:
        found.setdefault(recording_key(experiment), []).append(experiment)
    groups = []
    for mine in found.values():
        recording = mine[0].recording
        title = Path(recording.path).stem if recording.path else f"{recording.simulate}"
        if recording.simulate:
            title += f", seed {recording.seed}"
        run = next((n for n in map(_paper_run, mine) if n is not None), None)
        groups.append(_checked(Group(title, run, tuple(mine), tuple(mine))))
    return _with_own_titles(groups)


def _with_own_titles(groups: Sequence[Group]) -> list[Group]:
    """Give recordings of one name (`a/lines.csv`, `b/lines.csv`) the name of their folder too, and
    a number where that is not enough: rows of a table and result directories go by the title."""
    titles = [group.title for group in groups]
    found: dict[str, Group] = {}
    for group in groups:
        first, title = group.experiments[0], group.title
        if first.recording.path and titles.count(title) > 1:
            title = f"{(first.folder / first.recording.path).absolute().parent.name} {title}"
        numbered = (f"{title} ({k})" for k in itertools.count(2))
        title = next(t for t in itertools.chain([title], numbered) if folder_of(t) not in found)
        found[folder_of(title)] = replace(group, title=title)
    return list(found.values())


def on_runs(
    models: Sequence[Experiment],
    numbers: Sequence[int],
    *,
    with_paper: bool = False,
    which: str = "published",
) -> list[Group]:
    """Put each model (evidence, graph, filter, parameters, fit) on the recording of each of the
    paper's runs.

    with_paper: whether the run's own experiment comes first, with its `which` parameters.

    Raises InputError for a model that does not go with a run's number of lanes.
    """
    groups = []
    checked: set[tuple[str, int]] = set()
    for number in numbers:
        own = _own_experiment(number, which)
        placed = [on_recording(model, own) for model in models]
        for model in placed:
            if (model.source, own.n_lanes) not in checked:
                checked.add((model.source, own.n_lanes))
                try:
                    prepare_model(model)
                except InputError as error:
                    raise InputError(f"run {number}, {own.n_lanes} lanes: {error}") from error
        first = [own.model_copy(update={"name": "paper"})] if with_paper else []
        groups.append(_checked(Group(f"run {number}", number, (*first, *placed), (own,))))
    return groups


def graphs_on_runs(graphs: Sequence[str], numbers: Sequence[int], fit: str) -> list[Group]:
    """Put each graph on the recording of each of the paper's runs, with the run's evidence rule
    where that fits the graph, else with one that does."""
    groups = []
    for number in numbers:
        own = _own_experiment(number, "published")
        placed = [
            with_graph(own, graph, own.parameters).model_copy(
                update={"name": Path(graph).stem, "fit": fit}
            )
            for graph in graphs
        ]
        groups.append(_checked(Group(f"run {number}", number, tuple(placed), (own,))))
    return groups


def _own_experiment(number: int, which: str) -> Experiment:
    own = load_experiment(paper_experiment(number))
    entry = load_published().get(number)
    if entry is None or which == "published":
        return own
    return own.model_copy(update={"parameters": parameters_for(entry, which)})


def _paper_run(experiment: Experiment) -> int | None:
    match = re.fullmatch(r"run(\d\d)_.*", experiment.name)
    return int(match.group(1)) if match else None


def _checked(group: Group) -> Group:
    names = [experiment.name for experiment in group.experiments]
    for experiment in group.experiments:
        if names.count(experiment.name) > 1:
            raise InputError(
                f"{experiment.source}: {group.title}: two experiments have the name"
                f" {experiment.name}; give one another `name`"
            )
    return group


def compare_groups(
    groups: Sequence[Group],
    options: Options | None = None,
    *,
    jobs: int = 1,
    known: Known | None = None,
) -> Iterator[dict[str, Any]]:
    """Yield each group's part of the document (see `document`), in order; of a group that failed,
    which stops no other, its `title`, `run` and `error`.

    jobs: the number of processes that share the groups.
    known: the losses for experiments that say `fit: choose`, where they were computed already.
    """
    options = options or Options()
    if known is None:
        tasks = plan([e for group in groups for e in group.experiments], options.blocks)
        known = losses_by_experiment(tasks, jobs)
    work = partial(_tried, options=options, known=known)
    yield from in_order(work, groups, jobs, died=_failed)


def _tried(group: Group, options: Options, known: Known) -> dict[str, Any]:
    try:
        return compare_group(group, options, known)
    except InputError as error:
        return _failed(group, " ".join(str(error).split()))


def _failed(group: Group, error: str) -> dict[str, Any]:
    return {"title": group.title, "run": group.run, "error": error}


def compare_group(group: Group, options: Options, known: Known | None = None) -> dict[str, Any]:
    """Compare the experiments of one recording; see `document` for the keys. Raises InputError as
    the experiments do."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        sides, recorded = _sides(group, options, known or {})
        errors = tentative = None
        if options.health:
            tentative = detector_answers(group.detector or group.experiments, recorded)
            truth = sides[0].truth
            errors = detector_errors(tentative, truth.lane, truth.is_crossing)
    notes = [str(w.message) for w in caught if issubclass(w.category, UserWarning)]
    notes += [note for side in sides for note in side.notes]
    keep = _subsets(sides)
    entries = []
    for side in sides:
        entry = _entry(side, sides[0], keep)
        if errors is not None:
            entry["health"] = {k: model_health(side, errors, kept) for k, kept in keep.items()}
        entries.append(entry)
    health = None
    if errors is not None:
        health = {key: detector_health(errors, kept) for key, kept in keep.items()}
    part = {
        "title": group.title,
        "run": group.run,
        "frames": len(sides[0].truth),
        "blocks": options.blocks,
        "health": health,
        "experiments": entries,
        "notes": list(dict.fromkeys([*recorded.notes, *notes])),
    }
    if options.out is not None:
        save_comparison(options.out, part, sides, tentative)
    return part


def _sides(group: Group, options: Options, known: Known) -> tuple[list[Side], Recorded]:
    """Believe the recording under every experiment. It is read once for all that read it alike."""
    read: dict[str, Recorded] = {}
    sides: list[Side] = []
    for experiment in group.experiments:
        key = repr(
            (
                experiment.recording,
                experiment.ground_truth,
                experiment.folder,
                experiment.recording.lri == "clip" and experiment.parameters.get("max_lri"),
            )
        )
        drive = load_for_scoring(experiment, read.get(key))
        read[key] = drive.recorded
        if sides:
            _check_same_frames(sides[0].drive, drive)
        losses = known.get(experiment_key(experiment))
        sides.append(
            held_out_side(drive, n_blocks=options.blocks, trials=options.trials, losses=losses)
        )
    return sides, next(iter(read.values()))


def _check_same_frames(first: Drive, drive: Drive) -> None:
    for name in ("frame_id", "lane", "is_crossing"):
        if not np.array_equal(getattr(first.truth, name), getattr(drive.truth, name)):
            raise InputError(
                f"{drive.experiment.source}: {name} of the {len(drive)} annotated frames is not"
                f" that of {first.experiment.source} ({len(first)} frames); a difference needs the"
                " same frames, missing_frames and ground_truth"
            )


def _subsets(sides: Sequence[Side]) -> dict[str, BoolArray]:
    """Which frames count: all, and, where an experiment names untrusted labels, the others."""
    trusted = np.logical_and.reduce([side.drive.may_fit for side in sides])
    keep = {"all_frames": np.ones(len(trusted), dtype=bool)}
    return keep if trusted.all() else {**keep, "without_never_fit": trusted}


def _entry(side: Side, first: Side, keep: Mapping[str, BoolArray]) -> dict[str, Any]:
    experiment = side.experiment
    return {
        "name": experiment.name,
        "source": Path(experiment.source).name,
        "evidence": experiment.evidence,
        "graph": experiment.graph,
        "filter": experiment.filter,
        "fit": experiment.fit,
        "tuned_on": side.tuned_on,
        **causality(experiment, side.drive.model, side.held_out.parameters),
        "unassigned_below": experiment.unassigned_below,
        "free_parameters": side.free_parameters,
        "microseconds_per_frame": 1e6 * side.seconds_per_frame,
        "chosen": list(experiment.choice.grid)
        if experiment.fit == "choose" and experiment.choice is not None
        else [],
        "parameters": [dict(found) for found in side.held_out.parameters],
        "scores": {key: _scores(side, kept) for key, kept in keep.items()},
        "difference_to": None if side is first else first.experiment.name,
        "difference": None
        if side is first
        else {key: _difference(side, first, kept) for key, kept in keep.items()},
        "health": None,
    }


def _scores(side: Side, kept: BoolArray) -> dict[str, Any]:
    experiment, beliefs = side.experiment, side.beliefs.take(kept)
    rate, below = experiment.recording.frame_rate, experiment.unassigned_below
    log_evidence = beliefs.mean_log_evidence
    return {
        **score_with_intervals(beliefs.lane, side.truth.take(kept), rate, below),
        "mean_log_evidence": None if np.isnan(log_evidence) else log_evidence,
    }


def _difference(side: Side, first: Side, kept: BoolArray) -> dict[str, Any]:
    """The side less the first, per score [estimate, low, high]; None for a short drive."""
    mine, theirs = (
        score_counts(
            each.beliefs.lane[kept],
            each.truth.lane[kept],
            each.truth.is_crossing[kept],
            each.experiment.unassigned_below,
        )
        for each in (side, first)
    )
    intervals = score_intervals([mine], [theirs])
    return {name: i and [i.estimate, i.low, i.high] for name, i in intervals.items()}


def document(groups: Sequence[Mapping[str, Any]], options: Options) -> dict[str, Any]:
    """What `egolane compare --json` writes for held-out comparisons.

    `schema_version`, `held_out` (true), `blocks`, `recordings`: a list of `title`, `run` (the
    paper's, or null), `frames` (annotated), `notes`, `health` (of the detector, per subset, see
    `health.detector_health`; null unless asked for) and `experiments`: a list of `name`, `source`,
    `evidence`, `graph`, `filter`, `fit`, `tuned_on` (same_frames: in-sample), `is_causal`,
    `causal` and `why_not_causal` (as `model.causality`),
    `unassigned_below`, `free_parameters` (numbers fitted to labels), `microseconds_per_frame`
    (evidence and filter), `chosen` (the parameters that `fit: choose` chose), `parameters` (per
    block, those that were fitted without it), `scores` (per subset, as
    `scoring.summary.score_with_intervals` and `mean_log_evidence`),
    `difference_to` (name of the first experiment, null for itself), `difference` (per subset and
    score [estimate, low, high], paired block bootstrap, 95 %; null for short drives) and `health`
    (per subset, see `health.model_health`). Subsets: `all_frames`, and, where an experiment's
    `tuning.never_fit` names frames with untrusted labels, `without_never_fit`. `failed`: a list of
    `title`, `run` and `error` of the recordings that could not be compared.
    """
    return {
        "schema_version": SCHEMA_VERSION,
        "held_out": True,
        "blocks": options.blocks,
        "recordings": [part for part in groups if "error" not in part],
        "failed": [part for part in groups if "error" in part],
    }

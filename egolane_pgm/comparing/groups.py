"""Experiments side by side, held out, recording by recording."""

from __future__ import annotations

import contextlib
import itertools
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from egolane_pgm.comparing.detector_health import detector_answers, detector_health, model_health
from egolane_pgm.comparing.events import side_events
from egolane_pgm.comparing.graphs import with_graphs
from egolane_pgm.comparing.lags import lag_scores
from egolane_pgm.comparing.placing import (
    load_for_scoring,
    on_recording,
    recording_key,
    timeline,
)
from egolane_pgm.comparing.saving import folder_of, results_of, save_recording
from egolane_pgm.comparing.side import Search, Side, held_out_side, search_blocks
from egolane_pgm.drive import Drive, Recorded, drive_key
from egolane_pgm.experiment import Experiment, Overrides, load_experiment
from egolane_pgm.fleet import FleetDrive, drive_experiment, first_names
from egolane_pgm.learning import Found
from egolane_pgm.model import causality, prepare_model
from egolane_pgm.paper import load_published, paper_experiment, parameters_for
from egolane_pgm.results import SCHEMA_VERSION
from egolane_pgm.scoring.bootstrap import INTERVAL_STATISTICS, score_counts
from egolane_pgm.scoring.health import detector_errors
from egolane_pgm.scoring.held_out import N_BLOCKS
from egolane_pgm.scoring.seeds import (
    mean_of,
    on_timeline,
    over_seeds,
    resampled_scores,
    spread,
    with_bounds,
)
from egolane_pgm.scoring.summary import score_with_intervals
from egolane_pgm.tools.jobs import Jobs, in_order
from egolane_pgm.types import BoolArray, FloatArray, InputError, all_problems, problems_in


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
    trials_per_number: instead, the trials for each number that is searched.
    seeds: each search is repeated with each of these; empty: the experiment's own.
    health: whether to score how well each experiment notices that the detector is wrong.
    events: whether to score the lane changes that each experiment reports.
    out: where result directories go; None for nowhere.
    lags: seconds, increasing: beliefs that wait this long are scored too.
    """

    blocks: int = N_BLOCKS
    trials: int | None = None
    health: bool = False
    out: Path | None = None
    trials_per_number: int | None = None
    seeds: tuple[int, ...] = ()
    events: bool = False
    lags: tuple[float, ...] = ()


#: Per score the values of all frames and of each resample (1 + R,); None for a short drive.
Means = Mapping[str, FloatArray] | None

#: What a search found for each block, or why it could not.
Searched = list[Found] | InputError


def by_recording(experiments: Sequence[Experiment]) -> list[Group]:
    """Group experiments by what they are run on. Raises InputError for a name that occurs twice in
    a group, and for models that `prepare_model` refuses."""
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
        groups.append(Group(title, run, tuple(mine), tuple(mine)))
    return _with_own_titles(_checked(groups))


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
    for number in numbers:
        own = _own_experiment(number, which)
        placed = [on_recording(model, own) for model in models]
        first = [own.model_copy(update={"name": "paper"})] if with_paper else []
        groups.append(Group(f"run {number}", number, (*first, *placed), (own,)))
    return _checked(groups, on_runs=True)


def on_fleet(
    models: Sequence[Experiment], drives: Sequence[FleetDrive], overrides: Overrides = ()
) -> list[Group]:
    """Put each model on every drive of a fleet; the groups are named as the drives.

    overrides: keys that were overridden in the models.

    Raises InputError for a drive that does not fit.
    """
    groups = []
    for drive in drives:
        placed = [
            drive_experiment(model, drive, overrides).model_copy(update={"name": model.name})
            for model in models
        ]
        groups.append(Group(drive.name, None, tuple(placed), tuple(placed)))
    return _checked(groups)


def graphs_on_runs(
    graphs: Sequence[str], numbers: Sequence[int], fit: str, overrides: Overrides = ()
) -> list[Group]:
    """Put each graph on the recording of each of the paper's runs, with the run's evidence rule
    where that fits the graph, else with one that does.

    graphs: as `graphs.named_graphs` takes them.
    overrides: of the runs' experiments.

    Raises InputError for graphs that cannot be used.
    """
    groups = []
    for number in numbers:
        own = load_experiment(paper_experiment(number), overrides)
        placed = with_graphs([own], graphs, fit=fit)
        groups.append(Group(f"run {number}", number, tuple(placed), (own,)))
    return _checked(groups, on_runs=True)


def _own_experiment(number: int, which: str) -> Experiment:
    own = load_experiment(paper_experiment(number))
    entry = load_published().get(number)
    if entry is None or which == "published":
        return own
    return own.model_copy(update={"parameters": parameters_for(entry, which)})


def _paper_run(experiment: Experiment) -> int | None:
    match = re.fullmatch(r"run(\d\d)_.*", experiment.name)
    return int(match.group(1)) if match else None


def _checked(groups: list[Group], on_runs: bool = False) -> list[Group]:
    """The same groups. Raises InputError for a name that occurs twice in one, and for all models
    that cannot be used, so that it is known before a recording is read.

    on_runs: whether to say on which of the paper's runs a model cannot be used.
    """
    seen: set[str] = set()
    with all_problems() as part:
        for group in groups:
            names = [experiment.name for experiment in group.experiments]
            for experiment in group.experiments:
                if names.count(experiment.name) > 1:
                    raise InputError(
                        f"{experiment.source}: {group.title}: two experiments have the name"
                        f" {experiment.name}; give one another `name`"
                    )
                model = (experiment.source, experiment.evidence, experiment.graph)
                key = repr((*model, experiment.parameters, experiment.n_lanes))
                if key in seen:
                    continue
                seen.add(key)
                where = f"{group.title}, {experiment.n_lanes} lanes"
                with part(), problems_in(where) if on_runs else contextlib.nullcontext():
                    prepare_model(experiment)
    return groups


def compare_groups(
    groups: Sequence[Group],
    options: Options | None = None,
    *,
    jobs: Jobs = 1,
    show: Callable[[Iterator[Searched], int], Iterable[Searched]] = lambda found, total: found,
) -> Iterator[dict[str, Any]]:
    """Yield each group's part of the document (see `document`), in order; of a group that failed,
    which stops no other, its `title`, `run` and `error`.

    jobs: the number of processes that share the searches (one for each seed of an experiment), or,
        where nothing is searched, the groups.
    show: is given the searches as they are done and how many there will be, for a progress bar.
    """
    options = options or Options()
    work = partial(_tried, options=options)
    searches = [
        [(e, seed) for e in group.experiments if e.fit == "tune" for seed in _seeds(e, options)]
        for group in groups
    ]
    todo = list(itertools.chain.from_iterable(searches))
    if not todo:
        yield from in_order(work, groups, jobs, died=_failed)
        return
    search = partial(_search, options=options)
    with contextlib.closing(
        in_order(search, todo, jobs, died=lambda _, error: InputError(error))
    ) as found:
        shown = iter(show(found, len(todo)))
        for group, mine in zip(groups, searches, strict=True):
            at_hand = {(e.name, seed): next(shown) for e, seed in mine}
            yield work(group, searched=at_hand)


def _seeds(experiment: Experiment, options: Options) -> tuple[int | None, ...]:
    """The seeds of an experiment's search; None for its own."""
    return options.seeds if experiment.fit == "tune" and options.seeds else (None,)


def _search(task: tuple[Experiment, int | None], options: Options) -> Searched:
    experiment, seed = task
    try:
        drive = load_for_scoring(experiment)
        how = Search(options.trials, options.trials_per_number, seed)
        return search_blocks(drive, options.blocks, how)
    except InputError as error:
        return error


def _tried(
    group: Group,
    options: Options,
    searched: Mapping[tuple[str, int | None], Searched] | None = None,
) -> dict[str, Any]:
    try:
        return compare_group(group, options, searched)
    except InputError as error:
        return _failed(group, "; ".join(error.lines))


def _failed(group: Group, error: str) -> dict[str, Any]:
    return {"title": group.title, "run": group.run, "error": error}


def compare_group(
    group: Group,
    options: Options,
    searched: Mapping[tuple[str, int | None], Searched] | None = None,
) -> dict[str, Any]:
    """Compare the experiments of one recording; see `document` for the keys. In addition
    `resampled` has what `together` needs, and `results` the result of each experiment, by name,
    where they are not written to `options.out`.

    searched: what the searches found, by the experiment's name and the seed, where they are done.

    Raises InputError as the experiments do.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        columns, recorded = _columns(group, options, searched or {})
        first = columns[0][0]
        errors = tentative = None
        if options.health:
            tentative = detector_answers(group.detector or group.experiments, recorded)
            errors = detector_errors(tentative, first.truth.lane, first.truth.is_crossing)
    notes = [str(w.message) for w in caught if issubclass(w.category, UserWarning)]
    notes += [note for sides in columns for side in sides for note in side.notes]
    keep = _subsets([sides[0] for sides in columns])
    means = [
        {key: _means(sides, kept, group.title) for key, kept in keep.items()} for sides in columns
    ]
    entries = []
    for sides, mine in zip(columns, means, strict=True):
        entry = _entry(sides, keep, mine)
        if sides is not columns[0]:
            entry["difference_to"] = first.experiment.name
            entry["difference"] = {key: _bounds(_minus(mine[key], means[0][key])) for key in keep}
        if errors is not None:
            entry["health"] = {
                key: mean_of([model_health(side, errors, kept) for side in sides])
                for key, kept in keep.items()
            }
        if options.events:
            entry["events"] = {
                key: mean_of([side_events(side, kept) for side in sides])
                for key, kept in keep.items()
            }
        entries.append(entry)
    health = None
    if errors is not None:
        health = {key: detector_health(errors, kept) for key, kept in keep.items()}
    part = {
        "title": group.title,
        "run": group.run,
        "frames": len(first.truth),
        "blocks": options.blocks,
        "health": health,
        "experiments": entries,
        "notes": list(dict.fromkeys([*recorded.notes, *notes])),
    }
    results = results_of(part, columns, tentative)
    if options.out is not None:
        save_recording(options.out, part, results)
        results = {}
    trusted = list(keep.values())[-1]
    drive = drive_key(first.experiment)
    resampled = [_means(sides, trusted, group.title, drive) for sides in columns]
    return {**part, "drive": drive, "resampled": resampled, "results": results}


def _columns(
    group: Group,
    options: Options,
    searched: Mapping[tuple[str, int | None], Searched],
) -> tuple[list[list[Side]], Recorded]:
    """Believe the recording under every experiment, once for each seed of its search. It is read
    once for all that read it alike."""
    read: dict[str, Recorded] = {}
    columns: list[list[Side]] = []
    for experiment in group.experiments:
        recording = experiment.recording
        largest = recording.lri == "clip" and experiment.parameters.get("max_lri")
        key = repr((recording, experiment.ground_truth, experiment.folder, largest))
        drive = load_for_scoring(experiment, read.get(key))
        read[key] = drive.recorded
        if columns:
            _check_same_frames(columns[0][0].drive, drive)
        sides = []
        for seed in _seeds(experiment, options):
            found = searched.get((experiment.name, seed))
            if isinstance(found, InputError):
                raise found
            how = Search(options.trials, options.trials_per_number, seed)
            n_blocks, lags = options.blocks, options.lags
            side = held_out_side(drive, n_blocks=n_blocks, search=how, searched=found, lags=lags)
            sides.append(side)
        columns.append(sides)
    return columns, next(iter(read.values()))


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


def _entry(
    sides: Sequence[Side], keep: Mapping[str, BoolArray], means: Mapping[str, Means]
) -> dict[str, Any]:
    """An experiment's part of the document: `sides` are alike but for the seed of the search."""
    side = sides[0]
    experiment = side.experiment
    parameters = [found for each in sides for found in each.held_out.parameters]
    each = [{key: _scores(one, kept) for key, kept in keep.items()} for one in sides]
    scores = {key: mean_of([found[key] for found in each]) for key in keep}
    if len(sides) > 1:
        for key, found in scores.items():
            bounds = _bounds(means[key])
            found["intervals"] = {
                name: (bounds[name] or [])[1:] or None for name in ("accuracy", "f1")
            }
    graph = experiment.graph
    return {
        "name": experiment.name,
        "source": Path(experiment.source).name,
        "evidence": experiment.evidence,
        "graph": Path(graph).name if Path(graph).is_absolute() else graph,
        "filter": experiment.filter,
        "fit": experiment.fit,
        "tuned_on": side.tuned_on,
        **causality(experiment, side.drive.model, parameters),
        "unassigned_below": experiment.unassigned_below,
        "free_parameters": side.free_parameters,
        "fixed_parameters": side.fixed_parameters,
        "trials": side.trials,
        "microseconds_per_frame": 1e6 * min(one.seconds_per_frame for one in sides),
        "parameters": list(map(dict, side.held_out.parameters)) if len(sides) == 1 else [],
        "scores": scores,
        "spread": {key: _spread([found[key] for found in each]) for key in keep},
        "seeds": [
            {
                "seed": one.seed,
                "parameters": [dict(found) for found in one.held_out.parameters],
                "scores": found,
            }
            for one, found in zip(sides, each, strict=True)
            if experiment.fit == "tune"
        ],
        "lags": {key: _lag_scores(sides, kept) for key, kept in keep.items()}
        if side.lagged
        else None,
        "difference_to": None,
        "difference": None,
        "health": None,
        "events": None,
    }


def _lag_scores(sides: Sequence[Side], kept: BoolArray) -> dict[str, Any]:
    found = mean_of([lag_scores(side.drive, side.lagged, kept) for side in sides])
    # The mean of the seeds' intervals is none of the mean.
    return found if len(sides) == 1 else {**found, "intervals": None}


def _scores(side: Side, kept: BoolArray) -> dict[str, Any]:
    experiment, beliefs = side.experiment, side.beliefs.take(kept)
    rate, below = experiment.recording.frame_rate, experiment.unassigned_below
    log_evidence = beliefs.mean_log_evidence
    return {
        **score_with_intervals(beliefs.lane, side.truth.take(kept), rate, below),
        "mean_log_evidence": None if np.isnan(log_evidence) else log_evidence,
    }


def _spread(scores: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    return {name: spread([each[name] for each in scores]) for name in INTERVAL_STATISTICS}


def _means(sides: Sequence[Side], kept: BoolArray, title: str, drive: str | None = None) -> Means:
    """The scores of the frames that are kept, the mean over the seeds: of all and of each resample.

    title: the recording's.
    drive: the drive's key, to draw from all its frames, so that the draws are the same ones for
        all its recordings.
    """
    counts = [
        score_counts(
            side.beliefs.lane[kept],
            side.truth.lane[kept],
            side.truth.is_crossing[kept],
            side.experiment.unassigned_below,
        )
        for side in sides
    ]
    if drive is None:
        values = resampled_scores(counts)
    else:
        frames, every = sides[0].truth.frame_id[kept], timeline(sides[0].drive)
        values = resampled_scores(
            [on_timeline(each, frames, every) for each in counts], [*drive.encode()]
        )
    chance = f"{title}: {sides[0].experiment.name}"
    return values and {name: over_seeds(found, chance) for name, found in values.items()}


def _minus(mine: Means, theirs: Means) -> Means:
    if mine is None or theirs is None:
        return None
    return {name: values - theirs[name] for name, values in mine.items()}


def _bounds(means: Means) -> dict[str, list[float] | None]:
    """Per score [estimate, low, high]; None for a short drive."""
    return {name: with_bounds(means[name]) if means else None for name in INTERVAL_STATISTICS}


#: The keys of a group's part that are not in the document.
_NOT_WRITTEN = ("resampled", "results")


def document(groups: Sequence[Mapping[str, Any]], options: Options) -> dict[str, Any]:
    """What `egolane compare --json` writes for held-out comparisons; its keys are those of
    `comparing.document.Comparison`. Subsets of the frames are `all_frames` and, where an
    experiment's `tuning.never_fit` names frames with untrusted labels, `without_never_fit`."""
    done = [part for part in groups if "error" not in part]
    of = first_names([part["title"] for part in done], [part["drive"] for part in done])
    return {
        "schema_version": SCHEMA_VERSION,
        "held_out": True,
        "blocks": options.blocks,
        "recordings": [
            {**{k: v for k, v in part.items() if k not in _NOT_WRITTEN}, "drive": first}
            for part, first in zip(done, of, strict=True)
        ],
        "together": together(done),
        "failed": [part for part in groups if "error" in part],
    }


def together(groups: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Several recordings as one: of each experiment, the plain means over the recordings.

    groups: what `compare_groups` yields of those that did not fail.

    `name`, `recordings` and `drives` (how many there are), `scores` and `difference`, to the first
    experiment (per score [estimate, low, high], or null where a drive is short), and `spread` (per
    score the standard deviation over the seeds of this mean).

    Recordings of one drive by several detectors share its luck: their frames are resampled
    together. Frames of untrusted labels (`tuning.never_fit`) are left out. Empty for one recording,
    or where the recordings do not have the same experiments.
    """
    names = {tuple(entry["name"] for entry in part["experiments"]) for part in groups}
    if len(groups) < 2 or len(names) > 1:
        return []
    found: list[dict[str, Any]] = []
    means: list[Means] = []
    for k, name in enumerate(next(iter(names))):
        entries = [part["experiments"][k] for part in groups]
        values = [part["resampled"][k] for part in groups]
        means.append(
            None
            if any(each is None for each in values)
            else {n: np.mean([each[n] for each in values], axis=0) for n in INTERVAL_STATISTICS}
        )
        found.append(
            {
                "name": name,
                "recordings": len(groups),
                "drives": len({part["drive"] for part in groups}),
                "scores": _bounds(means[k]),
                "spread": _spread_of_means(entries),
                "difference": _bounds(_minus(means[k], means[0])) if k else None,
            }
        )
    return found


def _spread_of_means(entries: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    """The spread over the seeds of the mean over recordings. Searches are independent: which of
    them are taken together does not matter, and the k-th seeds are."""
    runs = [[list(one["scores"].values())[-1] for one in entry["seeds"]] for entry in entries]
    means = [
        {name: float(np.mean([scores[name] for scores in each])) for name in INTERVAL_STATISTICS}
        for each in zip(*runs, strict=True)
    ]
    return _spread(means) if means else dict.fromkeys(INTERVAL_STATISTICS)

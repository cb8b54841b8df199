"""Which experiments are compared on which recording: each is run held out, and the results of a
recording are put side by side."""

from __future__ import annotations

import contextlib
import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from egolane_pgm.comparing.compared import compare_results, detector_alone
from egolane_pgm.comparing.document import folder_of
from egolane_pgm.comparing.graphs import with_graphs
from egolane_pgm.comparing.placing import on_recording, recording_key
from egolane_pgm.drive import Recorded, load_drive
from egolane_pgm.experiment import Experiment, Given, Overrides, load_experiment
from egolane_pgm.fleet import FleetDrive, drive_experiment
from egolane_pgm.held_out import held_out_result
from egolane_pgm.model import prepare_model
from egolane_pgm.paper import load_published, paper_experiment, parameters_for
from egolane_pgm.results import Result
from egolane_pgm.scoring.held_out import N_BLOCKS
from egolane_pgm.tools.jobs import Jobs, in_order
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError, problems_in


@dataclass(frozen=True)
class Group:
    """Experiments on one recording; differences are to the first.

    - title: names the recording in tables and directories.
    - run: the number of the paper's run, or None.
    - with_detector: whether what the detector alone answers comes last.
    """

    title: str
    run: int | None
    experiments: tuple[Experiment, ...]
    with_detector: bool = False


def planned(
    experiments: Sequence[Given],
    *,
    graphs: Sequence[str] = (),
    numbers: Sequence[int] | None = None,
    drives: Sequence[FleetDrive] = (),
    overrides: Overrides = (),
) -> list[Group]:
    """The experiments that are compared, by recording.

    - experiments: each once with each of the graphs. Without experiments the graphs take the place
      of the paper's on its runs.
    - graphs: as `graphs.named_graphs` takes them.
    - numbers: of the paper's runs, on whose recordings each is put; None for its own.
    - drives: of a fleet, on each of which the experiments are put.

    Raises InputError for whatever does not fit, before a recording is read.
    """
    if not experiments:
        return _checked(
            [_graphs_on_run(graphs, n, overrides) for n in numbers or range(1, 11)], on_runs=True
        )
    models = [load_experiment(given, overrides) for given in experiments]
    if graphs:
        is_placed = numbers is not None or bool(drives)
        places = 1 if is_placed else len({recording_key(model) for model in models})
        models = with_graphs(models, graphs, is_shared=places < len(models))
    if drives:
        return _checked([_on_drive(models, drive, overrides) for drive in drives])
    if numbers is None:
        return by_recording(models)
    return _checked([_on_run(models, n) for n in numbers], on_runs=True)


def by_recording(experiments: Sequence[Experiment]) -> list[Group]:
    """Group experiments by what they are run on. Raises InputError for a name that occurs twice in
    a group, and for models that `prepare_model` refuses."""
    return _checked(_grouped(experiments))


def results_by_recording(results: Sequence[Result]) -> list[tuple[str, list[Result]]]:
    """Stored results of each recording, with its title. Where no recording has two results, they
    are put side by side all the same: of one drive by several detectors, say. Raises InputError for
    less than two."""
    if len(results) < 2:
        raise InputError("compare: needs two result directories or more")
    groups = _grouped([each.experiment for each in results])
    if all(len(group.experiments) == 1 for group in groups):
        return [(groups[0].title, list(results))]
    found = []
    for group in groups:
        mine = {id(experiment) for experiment in group.experiments}
        found.append((group.title, [each for each in results if id(each.experiment) in mine]))
    return found


def _grouped(experiments: Sequence[Experiment]) -> list[Group]:
    """Groups by recording. Recordings of one name (`a/lines.csv`, `b/lines.csv`) have the name of
    their folder too, and a number where that is not enough: rows of a table and result directories
    go by the title."""
    found: dict[str, list[Experiment]] = {}
    for experiment in experiments:
        found.setdefault(recording_key(experiment), []).append(experiment)
    short = [_title(mine[0]) for mine in found.values()]
    groups: dict[str, Group] = {}
    for mine, title in zip(found.values(), short, strict=True):
        first = mine[0]
        if first.recording.path and short.count(title) > 1:
            title = f"{(first.folder / first.recording.path).absolute().parent.name} {title}"
        numbered = (f"{title} ({k})" for k in itertools.count(2))
        title = next(t for t in itertools.chain([title], numbered) if folder_of(t) not in groups)
        runs = (re.fullmatch(r"run(\d\d)_.*", each.name) for each in mine)
        run = next((int(match[1]) for match in runs if match), None)
        groups[folder_of(title)] = Group(title, run, tuple(mine))
    return list(groups.values())


def _title(experiment: Experiment) -> str:
    recording = experiment.recording
    if recording.path:
        return Path(recording.path).stem
    return f"{recording.simulate}, seed {recording.seed}"


def _on_run(models: Sequence[Experiment], number: int) -> Group:
    """Each model (evidence, graph, filter, parameters, fit) on the recording of a paper's run."""
    own = _of_paper(number)
    return Group(f"run {number}", number, tuple(on_recording(model, own) for model in models))


def _on_drive(models: Sequence[Experiment], drive: FleetDrive, overrides: Overrides) -> Group:
    placed = [
        drive_experiment(model, drive, overrides).model_copy(update={"name": model.name})
        for model in models
    ]
    return Group(drive.name, None, tuple(placed))


def _graphs_on_run(graphs: Sequence[str], number: int, overrides: Overrides) -> Group:
    """Each graph on the recording of a paper's run, with the run's evidence rule where that fits
    the graph, else with one that does. With the paper's parameters, tuned on the very frames, the
    detector is shown as well."""
    own = load_experiment(_of_paper(number), overrides)
    placed = with_graphs([own], graphs)
    return Group(f"run {number}", number, tuple(placed), with_detector=own.fit == "none")


def _of_paper(number: int) -> Experiment:
    own = load_experiment(paper_experiment(number))
    entry = load_published().get(number)
    if entry is None:
        return own
    return own.model_copy(update={"parameters": parameters_for(entry, "recovered")})


def _checked(groups: list[Group], on_runs: bool = False) -> list[Group]:
    """The same groups. Raises InputError for a name that occurs twice in one, and for a model that
    cannot be used, so that it is known before a recording is read.

    on_runs: whether to say on which of the paper's runs a model cannot be used.
    """
    seen: set[str] = set()
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
            with problems_in(where) if on_runs else contextlib.nullcontext():
                prepare_model(experiment)
    return groups


# --- run and compared --------------------------------------------------------------------------

#: Experiments on one recording.
Work = Sequence[Experiment]


def compare_groups(
    groups: Sequence[Group],
    *,
    events: bool = False,
    n_blocks: int = N_BLOCKS,
    jobs: Jobs = 1,
    progress: bool | None = False,
) -> Iterator[dict[str, Any]]:
    """Run the experiments of each group held out and yield its part of the document, as
    `compare_results` makes it, in order; of a group that failed, which stops no other, its `title`,
    `run` and `error`.

    - events: as `compare_results` takes it.
    - jobs: the number of processes that share the experiments, or, where nothing is searched, the
      groups.
    - progress: whether a bar shows how far it is; None for in a terminal.
    """
    is_searched = any(e.fit == "tune" for group in groups for e in group.experiments)
    runs: list[list[Work]] = [
        [[each] for each in group.experiments] if is_searched else [group.experiments]
        for group in groups
    ]
    work = [each for mine in runs for each in mine]
    with contextlib.closing(
        in_order(
            partial(_held_out, n_blocks=n_blocks),
            work,
            jobs,
            died=lambda _, error: InputError(error),
        )
    ) as found:
        shown = iter(bar(found, progress, total=len(work), unit="run"))
        for group, mine in zip(groups, runs, strict=True):
            yield _compared(group, [next(shown) for _ in mine], events)


def _held_out(work: Work, n_blocks: int) -> list[Result] | InputError:
    """The result of each experiment, or why one has none. The recording is read once for all that
    read it alike."""
    read: dict[str, Recorded] = {}
    results = []
    try:
        for experiment in work:
            recording = experiment.recording
            largest = recording.lri == "clip" and experiment.parameters.get("max_lri")
            key = repr((recording, experiment.ground_truth, experiment.folder, largest))
            needs = "a comparison scores against it"
            drive = load_drive(experiment, needs_truth=needs, recorded=read.get(key))
            read[key] = drive.recorded
            results.append(held_out_result(drive, n_blocks=n_blocks))
    except InputError as error:
        return error
    return results


def _compared(
    group: Group, done: Sequence[list[Result] | InputError], events: bool
) -> dict[str, Any]:
    """The group's part of the document."""
    results: list[Result] = []
    try:
        for each in done:
            if isinstance(each, InputError):
                raise each
            results += each
        alone = detector_alone(results[0]) if group.with_detector else None
        given = results if alone is None else [*results, alone]
        part = compare_results(group.title, given, events=events, run=group.run)
        if alone is not None:
            # It stands in the others' results.
            del part["results"][alone.name]
        return part
    except InputError as error:
        return {"title": group.title, "run": group.run, "error": str(error)}

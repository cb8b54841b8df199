"""The verb `compare`."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Ge

from egolane_pgm.comparing.graphs import with_graphs
from egolane_pgm.comparing.groups import (
    Group,
    Options,
    by_recording,
    compare_groups,
    document,
    graphs_on_runs,
    on_fleet,
    on_runs,
)
from egolane_pgm.comparing.in_sample import compare_graphs, compare_json
from egolane_pgm.comparing.lags import check_lags
from egolane_pgm.comparing.placing import recording_key
from egolane_pgm.comparing.result import Comparison
from egolane_pgm.comparing.stored import compare_results
from egolane_pgm.experiment import Given, Overrides, load_experiment
from egolane_pgm.fleet import FleetDrive, read_fleet
from egolane_pgm.paper import Runs, parse_runs
from egolane_pgm.results import read_result
from egolane_pgm.tools.files import check_place
from egolane_pgm.tools.progress import bar
from egolane_pgm.types import InputError
from egolane_pgm.verbs.given import (
    Blocks,
    Fleet,
    Jobs,
    Option,
    Progress,
    StrPath,
    path_of,
    several_of,
)

EXAMPLES = (
    "egolane compare experiments/quickstart.yaml --graphs sensor_failure,lane_only",
    "egolane compare experiments/zero_label.yaml --runs 1-10 --with-paper --wide > table.md",
)

#: The graphs that are compared where none is named.
DEFAULT_GRAPHS = ("sensor_failure", "wor_on_lane", "no_wor", "lane_only")


def compare(
    experiments: Annotated[Given | Sequence[Given], Option("EXPERIMENT|RESULT...", many=True)] = (),
    *,
    graphs: Annotated[
        str | Sequence[StrPath] | None,
        Option("NAME,...", plugins=("graphs",), said=",".join(DEFAULT_GRAPHS)),
    ] = None,
    runs: Annotated[Runs | None, Option("TEXT", said="with graphs alone: 1-10")] = None,
    held_out: bool = False,
    with_paper: bool = False,
    parameters: Literal["recovered", "published"] = "recovered",
    health: bool = False,
    events: bool = False,
    lags: Annotated[str | Sequence[float] | None, Option("SECONDS,...")] = None,
    blocks: Blocks = 5,
    trials: Annotated[int | None, Ge(1)] = None,
    trials_per_number: Annotated[int | None, Ge(1), Option("K")] = None,
    seeds: Annotated[str | int | Sequence[int] | None, Option("N|LIST")] = None,
    fleet: Fleet = None,
    jobs: Jobs = 1,
    overrides: Overrides = (),
    out: Annotated[StrPath | None, Option("DIR")] = None,
    figure: Annotated[StrPath | None, Option("FILE")] = None,
    differences: Annotated[StrPath | None, Option("FILE")] = None,
    progress: Progress = None,
) -> Comparison:
    """Experiments side by side on frames that their parameters have not seen.

    Each of the experiments (its `fit` says how parameters are found) is put on its own recording,
    or on those of the paper's runs, or on every drive of a fleet; with graphs each of them once
    with each graph. Without experiments the graphs are put on the paper's runs, with the paper's
    parameters, in-sample, or held out. Result directories, two or more, are compared as they are
    stored, on the annotated frames that they share.

    - experiments: one, or a list of several; or result directories.
    - graphs: graphs, names or files.
    - runs: runs of the paper, e.g. 1-5,7.
    - held_out: tune each graph without the block that is scored.
    - with_paper: with runs: the paper's model first.
    - parameters: the paper's, for graphs and with_paper: recovered (by a search; run 5 from the
      authors' code), or as printed (truncated).
    - health: as well: how well each tells that the detector is wrong.
    - events: instead: how well each tells lane changes.
    - lags: instead: accuracy of beliefs that wait, e.g. 0,0.5,1,2,5; figure draws that.
    - blocks: blocks held out in turn.
    - trials: of each block's search (fit: tune).
    - trials_per_number: instead: K for each number that a graph's search moves.
    - seeds: search with seeds 0 to N-1, or those of a list (3,7); means.
    - fleet: a table with a row per drive (.csv, .parquet, .yaml): recording, n_lanes, tag.X, ...
    - jobs: processes that share the work.
    - overrides: override the YAMLs.
    - out: keep a result directory for each recording.
    - figure: draw accuracy.
    - differences: draw how accuracy differs from the first one's.
    - progress: whether a bar shows how far it is; None for in a terminal.

    Returns a `Comparison`. Raises InputError for whatever does not fit. A recording that fails does
    not stop the others.

    >>> import egolane_pgm as ego
    >>> one = ego.load_experiment("quickstart", {"recording.frames": [0, 400]})
    >>> other = ego.load_experiment(one, {"name": "exact", "filter": "exact"})
    >>> compared = ego.compare([one, other], blocks=2)
    >>> compared.to_pandas()["value"].xs("f1", level="score").round(3).to_list()
    [0.728, 0.727]
    >>> late = ego.compare(one, blocks=2, lags=[0, 1]).to_pandas("lags")
    >>> late["accuracy"].round(3).to_list()
    [0.902, 0.911]
    """
    given = several_of(experiments)
    waits = () if lags is None else check_lags(lags.split(",") if isinstance(lags, str) else lags)
    apart = {
        "health": health, "events": events, "lags": waits, "overrides": overrides,
        "trials": trials, "trials_per_number": trials_per_number, "seeds": seeds,
        "figure": figure, "differences": differences, "out": out,
    }  # fmt: skip
    if any(isinstance(each, (str, os.PathLike)) and Path(each).is_dir() for each in given):
        others = {"graphs": graphs, "runs": runs, "held_out": held_out, "fleet": fleet}
        _refuse({**others, "with_paper": with_paper, **apart}, "experiments, not with results")
        return Comparison(compare_results([read_result(each) for each in given]))
    if with_paper and not (given and runs):
        raise InputError("with_paper: goes with experiments and runs")
    if trials and trials_per_number:
        raise InputError("trials_per_number: goes instead of trials, not with it")
    if fleet is not None and (not given or runs):
        raise InputError("fleet: goes with experiments, without runs")
    _check_places(figure, differences, out)
    names = graph_names(graphs, bool(given))
    chosen = () if seeds is None else _seeds(seeds)
    numbers = parse_runs(runs) if runs else None
    if not given and not held_out:
        _refuse(apart, "experiments or with held_out")
        shows = bar(numbers or parse_runs("1-10"), progress, desc="runs", unit="run")
        compared = [compare_graphs(number, names, parameters) for number in shows]
        return Comparison(compare_json(compared, parameters))
    drives = () if fleet is None else read_fleet(path_of(fleet, "fleet"))
    fit = "tune" if held_out else None
    groups = groups_of(given, names, fit, numbers, with_paper, parameters, overrides, drives)
    if differences and all(len(group.experiments) < 2 for group in groups):
        raise InputError("differences: need two experiments or graphs on one recording")
    is_searched = any(e.fit == "tune" for group in groups for e in group.experiments)
    for name, value in (("seeds", seeds), ("trials_per_number", trials_per_number)):
        if value and not is_searched:
            raise InputError(f"{name}: nothing is searched; take held_out, or fit: tune")
    folder = None if out is None else Path(path_of(out, "out"))
    settings = Options(blocks, trials, health, folder, trials_per_number, chosen, events, waits)
    found = _compared(groups, settings, jobs, progress, tuple(drives))
    if figure or differences:
        _draw(found, figure, differences)
    return found


def _refuse(options: Mapping[str, Any], what: str) -> None:
    """Raise InputError for the first option that is given, and goes with something else."""
    for name, value in options.items():
        if value:
            raise InputError(f"{name}: goes with {what}")


def _check_places(figure: Any, differences: Any, out: Any) -> None:
    """Raise InputError, before anything is computed, for what cannot be written."""
    for place in filter(None, (figure, differences)):
        # matplotlib is imported only for a figure.
        from egolane_pgm.views.style import check_figure_path

        check_figure_path(path_of(place, "figure"))
        check_place(Path(place))
    if out is not None:
        check_place(Path(path_of(out, "out"), "recording"))


def _compared(
    groups: Sequence[Group],
    settings: Options,
    jobs: Jobs,
    progress: bool | None,
    drives: tuple[FleetDrive, ...],
) -> Comparison:
    """Compare the experiments of each recording held out.

    Raises InputError where no recording could be compared; Ctrl-C where none was.
    """

    def show(found: Iterator[Any], total: int) -> Iterable[Any]:
        shows: Iterable[Any] = bar(found, progress, desc="searching", total=total, unit="search")
        return shows

    done = compare_groups(groups, settings, jobs=jobs, show=show)
    compared: list[Any] = []
    stopped = None
    try:
        compared.extend(bar(done, progress, total=len(groups), unit="recording"))
    except KeyboardInterrupt:
        # The recordings that were compared before the interruption are kept.
        if not compared:
            raise
        n_done = f"{len(compared)} of {len(groups)} recordings"
        stopped = KeyboardInterrupt(f"this is {n_done}; the same command begins anew")
    found = document(compared, settings)
    if not found["recordings"]:
        raise InputError(found["failed"][0]["error"])
    results = {
        (part["title"], name): result
        for part in compared
        for name, result in part.get("results", {}).items()
    }
    return Comparison(found, results, settings.out, drives, stopped)


def _draw(found: Comparison, figure: StrPath | None, differences: StrPath | None) -> None:
    from egolane_pgm.views import comparison_figures as draws
    from egolane_pgm.views.comparison_tables import lag_curves

    accuracy = draws.draw_lags if lag_curves(found.document) else draws.draw_comparison
    for draw, path in ((accuracy, figure), (draws.draw_differences, differences)):
        if path is not None:
            draw(found.document, os.fspath(path))


def _seeds(given: str | int | Sequence[int]) -> tuple[int, ...]:
    """5 or "5" -> (0, 1, 2, 3, 4), [3, 7] or "3,7" -> (3, 7)."""
    if isinstance(given, str):
        words = [word.strip() for word in given.split(",")]
        if words[0] and all(word.isdecimal() for word in words if word):
            numbers = [int(word) for word in words if word]
            return _seeds(numbers if "," in given else numbers[0])
    elif isinstance(given, int) and given > 0:
        return tuple(range(given))
    elif isinstance(given, Sequence) and all(isinstance(seed, int) for seed in given):
        return tuple(dict.fromkeys(map(int, given)))
    raise InputError(f"seeds: {given} is neither how many, 5, nor which, 3,7")


def graph_names(graphs: Any, has_experiments: bool) -> list[str]:
    """The graphs that are named, in a list or with commas; without experiments by default some."""
    if isinstance(graphs, str):
        names = [name.strip() for name in graphs.split(",") if name.strip()]
    else:
        names = [os.fspath(graph) for graph in several_of(graphs)]
    return names if names or has_experiments else list(DEFAULT_GRAPHS)


def groups_of(
    experiments: Sequence[Given],
    graphs: Sequence[str],
    fit: str | None,
    numbers: Sequence[int] | None,
    with_paper: bool,
    which: str,
    overrides: Overrides,
    drives: Sequence[FleetDrive] = (),
) -> list[Group]:
    """The experiments that `compare` compares, by recording.

    - graphs: each experiment once with each of them; without experiments, on the paper's runs.
    - fit: of the experiments with these graphs, None for their own.
    - numbers: of the paper's runs; None for the experiments' own recordings.
    - which: the parameters of the paper's model.
    - drives: of a fleet, on each of which the experiments are put.
    """
    if not experiments:
        return graphs_on_runs(graphs, numbers or range(1, 11), "tune", overrides)
    models = [load_experiment(given, overrides) for given in experiments]
    if graphs:
        is_placed = numbers is not None or bool(drives)
        places = 1 if is_placed else len({recording_key(model) for model in models})
        models = with_graphs(models, graphs, fit=fit, is_shared=places < len(models))
    if drives:
        return on_fleet(models, drives, overrides)
    if numbers is None:
        return by_recording(models)
    return on_runs(models, numbers, with_paper=with_paper, which=which)

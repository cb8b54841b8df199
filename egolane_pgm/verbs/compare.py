"""The verb `compare`."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from egolane_pgm.comparing.compared import compare_results, document
from egolane_pgm.comparing.planning import (
    compare_groups,
    planned,
    results_by_recording,
)
from egolane_pgm.comparing.result import Comparison, is_comparison
from egolane_pgm.experiment import Given, Overrides
from egolane_pgm.fleet import read_fleet
from egolane_pgm.paper import Runs, parse_runs
from egolane_pgm.results import check_writable, read_result
from egolane_pgm.tools.files import check_place
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
    "egolane compare experiments/zero_label.yaml --runs 1-10 --wide > table.md",
)

#: The graphs that are compared where none is named.
DEFAULT_GRAPHS = ("sensor_failure", "wor_on_lane", "no_wor", "lane_only")


def compare(
    experiments: Annotated[Given | Sequence[Given], Option("EXPERIMENT|RESULT...", many=True)] = (),
    *,
    graphs: Annotated[
        str | Sequence[StrPath] | None,
        Option("NAME,...", said=",".join(DEFAULT_GRAPHS)),
    ] = None,
    runs: Annotated[Runs | None, Option("TEXT", said="with graphs alone: 1-10")] = None,
    events: bool = False,
    blocks: Blocks = 5,
    fleet: Fleet = None,
    jobs: Jobs = 1,
    overrides: Overrides = (),
    out: Annotated[StrPath | None, Option("DIR")] = None,
    figures: Annotated[StrPath | None, Option("DIR")] = None,
    progress: Progress = None,
) -> Comparison:
    """Results side by side, on the annotated frames that they share.

    Result directories, two or more, are compared as they are stored, recording by recording.
    Experiments are run first, each block of a drive held out in turn (their `fit` says how
    parameters are found without it): on their own recordings, on those of the paper's runs, or on
    every drive of a fleet; with graphs each of them once with each graph. Without experiments the
    graphs are put on the paper's runs, with the paper's parameters, in-sample (fit=none), or
    searched (fit=tune).

    - experiments: one, or a list of several; or result directories.
    - graphs: graphs, names or files.
    - runs: runs of the paper, e.g. 1-5,7.
    - events: instead: how well each tells lane changes.
    - blocks: blocks held out in turn.
    - fleet: a table with a row per drive (.csv, .parquet, .yaml): recording, n_lanes, tag.X, ...
    - jobs: processes that share the work.
    - overrides: override the YAMLs, e.g. fit=tune tuning.trials=300.
    - out: keep the results, the numbers and the figures.
    - figures: draw accuracy, and how it differs from the first one's, in this folder.
    - progress: whether a bar shows how far it is; None for in a terminal.

    Returns a `Comparison`. Raises InputError for whatever does not fit. A recording that fails does
    not stop the others.

    >>> import egolane_pgm as ego
    >>> one = ego.load_experiment("quickstart", {"recording.frames": [0, 400]})
    >>> other = ego.load_experiment(one, {"name": "exact", "filter": "exact"})
    >>> compared = ego.compare([one, other], blocks=2)
    >>> compared.to_pandas()["value"].xs("f1", level="score").round(3).to_list()
    [0.728, 0.727]
    """
    given = several_of(experiments)
    place = None if out is None else Path(path_of(out, "out"))
    drawn = None if figures is None else Path(path_of(figures, "figures"))
    if place is not None:
        check_writable(place, is_comparison)
    if drawn is not None:
        check_place(drawn)
    if any(isinstance(each, (str, os.PathLike)) and Path(each).is_dir() for each in given):
        of_experiments = {
            "graphs": graphs, "runs": runs, "fleet": fleet, "overrides": overrides,
        }  # fmt: skip
        for name, value in of_experiments.items():
            if value:
                raise InputError(f"{name}: goes with experiments, not with results")
        stored = results_by_recording([read_result(each) for each in given])
        found = _comparison(
            [compare_results(title, results, events=events) for title, results in stored]
        )
    else:
        if fleet is not None and (not given or runs):
            raise InputError("fleet: goes with experiments, without runs")
        drives = () if fleet is None else read_fleet(path_of(fleet, "fleet"))
        groups = planned(
            given,
            graphs=graph_names(graphs, bool(given)),
            numbers=parse_runs(runs) if runs else None,
            drives=drives,
            overrides=overrides,
        )
        done = compare_groups(groups, events=events, n_blocks=blocks, jobs=jobs, progress=progress)
        found = replace(_compared(done, len(groups)), drives=drives)
    if place is not None:
        found.save(place)
    if drawn is not None:
        # matplotlib is imported only for a figure.
        from egolane_pgm.views.comparison_figures import draw_all

        draw_all(found.document, drawn)
    return found


def _compared(done: Iterator[dict[str, Any]], n_groups: int) -> Comparison:
    """What is compared of each recording, as it is done.

    Raises InputError where no recording could be compared; Ctrl-C where none was.
    """
    parts: list[Any] = []
    stopped = None
    try:
        parts.extend(done)
    except KeyboardInterrupt:
        # The recordings that were compared before the interruption are kept.
        if not parts:
            raise
        n_done = f"{len(parts)} of {n_groups} recordings"
        stopped = KeyboardInterrupt(f"this is {n_done}; the same command begins anew")
    return replace(_comparison(parts), stopped=stopped)


def _comparison(parts: Sequence[Mapping[str, Any]]) -> Comparison:
    found = document(parts)
    if not found["recordings"]:
        raise InputError(found["failed"][0]["error"])
    results = {
        (part["title"], name): result
        for part in parts
        for name, result in part.get("results", {}).items()
    }
    return Comparison(found, results)


def graph_names(graphs: Any, has_experiments: bool) -> list[str]:
    """The graphs that are named, in a list or with commas; without experiments by default some."""
    if isinstance(graphs, str):
        names = [name.strip() for name in graphs.split(",") if name.strip()]
    else:
        names = [os.fspath(graph) for graph in several_of(graphs)]
    return names if names or has_experiments else list(DEFAULT_GRAPHS)

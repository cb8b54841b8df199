"""The command `egolane compare`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import click

from egolane_pgm.api.comparisons import (
    DEFAULT_GRAPHS,
    check_options,
    compare_on_runs,
    compare_recordings,
    fleet_of,
    graph_names,
    groups_of,
)
from egolane_pgm.cli import options
from egolane_pgm.cli.completion import plugins
from egolane_pgm.cli.options import write_json
from egolane_pgm.comparing import compare_rows
from egolane_pgm.comparing.groups import Group, Options
from egolane_pgm.comparing.lags import check_lags
from egolane_pgm.comparing.stored import compare_results, stored_rows
from egolane_pgm.fleet import FleetDrive
from egolane_pgm.paper import parse_runs
from egolane_pgm.report import comparison_tables as rows_of
from egolane_pgm.report import events as lane_changes
from egolane_pgm.report.fleet_table import FLEET_LEGEND, fleet_comparison_rows
from egolane_pgm.report.tables import Table, page
from egolane_pgm.results import read_result
from egolane_pgm.tools.files import check_not_read, check_place
from egolane_pgm.tools.jobs import Jobs
from egolane_pgm.types import InputError

TITLES = {"accuracy": "Accuracy", "f1": "F1 (mean over lanes)", "log_loss": "Log-loss (all frames)"}


class Figures(NamedTuple):
    """Where the figures go; None for one that is not drawn."""

    accuracy: str | None
    differences: str | None


@click.command()
@options.experiments(required=False, folders=True)
@click.option(
    "--graphs",
    shell_complete=plugins("graphs"),
    help=f"Graphs, names or files.  [default: {','.join(DEFAULT_GRAPHS)}]",
)
@click.option("--runs", help="Runs of the paper, e.g. 1-5,7.  [default with --graphs: 1-10]")
@click.option("--held-out", is_flag=True, help="Tune each graph without the block that is scored.")
@click.option("--with-paper", is_flag=True, help="With --runs: the paper's model first.")
@options.parameters("The paper's, for --graphs and --with-paper.")
@click.option(
    "--health", is_flag=True, help="As well: how well each tells that the detector is wrong."
)
@click.option("--events", is_flag=True, help="Instead: how well each tells lane changes.")
@click.option(
    "--lags",
    metavar="SECONDS,...",
    help="Instead: accuracy of beliefs that wait, e.g. 0,0.5,1,2,5; --figure draws that.",
)
@click.option(
    "--blocks",
    type=click.IntRange(2),
    default=5,
    show_default=True,
    help="Blocks held out in turn.",
)
@click.option("--trials", type=click.IntRange(1), help="Of each block's search (fit: tune).")
@click.option(
    "--trials-per-number",
    type=click.IntRange(1),
    metavar="K",
    help="Instead: K for each number that a graph's search moves.",
)
@click.option(
    "--seeds", metavar="N|LIST", help="Search with seeds 0 to N-1, or those of a list (3,7); means."
)
@options.fleet
@options.jobs
@options.overrides("Override the YAMLs.")
@options.tables
@click.option(
    "--out", type=click.Path(file_okay=False), help="Keep a result directory for each recording."
)
@click.option("--figure", type=click.Path(dir_okay=False), metavar="FILE", help="Draw accuracy.")
@click.option(
    "--differences",
    type=click.Path(dir_okay=False),
    metavar="FILE",
    help="Draw how accuracy differs from the first one's.",
)
@options.json_file
def compare(
    experiments: tuple[str, ...],
    graphs: str | None,
    runs: str | None,
    held_out: bool,
    with_paper: bool,
    which: str,
    health: bool,
    events: bool,
    lags: str | None,
    blocks: int,
    trials: int | None,
    trials_per_number: int | None,
    seeds: str | None,
    fleet: str | None,
    jobs: Jobs,
    overrides: tuple[str, ...],
    style: str,
    wide: bool,
    out: str | None,
    figure: str | None,
    differences: str | None,
    json_file: Path | None,
) -> None:
    """Experiments side by side on frames that their parameters have not seen.

    Each of EXPERIMENTS (a YAML whose `fit` says how parameters are found) on its own recording,
    or, with --runs, on those of the paper's runs, or, with --fleet, on every drive of a table; with
    --graphs each of them once with each graph.
    Without experiments the graphs are put on the paper's runs, and without --held-out with the
    paper's parameters, in-sample. Result directories, two or more, are compared as they are stored,
    on the annotated frames that they share.
    """
    if any(Path(each).is_dir() for each in experiments):
        context = click.get_current_context()
        free = ("experiments", "style", "wide", "json_file", "which", "blocks", "jobs")
        asked = [name for name, value in context.params.items() if value and name not in free]
        _stored(experiments, asked, style, wide, json_file)
        return
    check_options(bool(experiments), runs, with_paper, trials, trials_per_number)
    drawn = _seeds(seeds) if seeds is not None else ()
    waits = check_lags(lags.split(",")) if lags is not None else ()
    figures = Figures(figure, differences)
    if any(figures):
        # matplotlib is imported only for a figure.
        from egolane_pgm.report.style import check_figure_path

        for path in filter(None, figures):
            check_figure_path(path)
    for place in (*figures, out and str(Path(out) / "recording")):
        if place:
            check_place(Path(place))
    if json_file:
        check_not_read(json_file, map(Path, experiments))
    names = graph_names(graphs, bool(experiments))
    drives = fleet_of(fleet, bool(experiments), runs)
    if not experiments and not held_out:
        many = (health, events, lags, overrides, trials, trials_per_number, seeds, *figures, out)
        if any(many):
            raise InputError(
                "compare: --health, --events, --lags, --set, --trials, --trials-per-number,"
                " --seeds, --figure, --differences and --out go with experiments or with --held-out"
            )
        _in_sample(names, parse_runs(runs or "1-10"), which, style, wide, json_file)
        return
    numbers = parse_runs(runs) if runs else None
    fit = "tune" if held_out else None
    groups = groups_of(experiments, names, fit, numbers, with_paper, which, overrides, drives)
    if differences and all(len(group.experiments) < 2 for group in groups):
        raise InputError("--differences: needs two experiments or graphs on one recording")
    is_searched = any(e.fit == "tune" for group in groups for e in group.experiments)
    for option, given in (("--seeds", seeds), ("--trials-per-number", trials_per_number)):
        if given and not is_searched:
            raise InputError(f"{option}: nothing is searched; take --held-out, or fit: tune")
    settings = Options(
        blocks,
        trials,
        health,
        Path(out) if out else None,
        trials_per_number,
        drawn,
        events,
        waits,
    )
    _held_out(groups, settings, jobs, style, wide, figures, json_file, drives)


def _stored(
    directories: Sequence[str], given: Sequence[str], style: str, wide: bool, json_file: Path | None
) -> None:
    if given:
        option = given[0].replace("_", "-")
        raise InputError(f"--{option}: goes with experiments, not with stored results")
    found = compare_results([read_result(each) for each in directories])
    unwritten = _write_first(json_file, found)
    note = (
        f"{found['frames']} annotated frames; crossing ones count in the log-loss only. Intervals"
        " are 95 %, those of the differences paired. * in-sample, or not known to be held out"
    )
    click.echo(page([Table(*stored_rows(found)), note], style, wide))
    if unwritten is not None:
        raise unwritten


def _seeds(text: str) -> tuple[int, ...]:
    """`"5"` -> (0, 1, 2, 3, 4), `"3,7"` -> (3, 7)."""
    words = [word.strip() for word in text.split(",")]
    if not all(word.isdecimal() for word in words if word) or not words[0] or words == ["0"]:
        raise InputError(f"--seeds {text}: write how many, 5, or which with commas, 3,7")
    numbers = [int(word) for word in words if word]
    return tuple(dict.fromkeys(numbers)) if "," in text else tuple(range(numbers[0]))


def _held_out(
    groups: Sequence[Group],
    settings: Options,
    jobs: Jobs,
    style: str,
    wide: bool,
    figures: Figures,
    json_file: Path | None,
    drives: Sequence[FleetDrive],
) -> None:
    done = compare_recordings(groups, settings, jobs=jobs)
    found = done.document
    unwritten = _write_first(json_file, found)
    for recording in found["recordings"]:
        for note in recording["notes"]:
            options.warn(note, recording["title"])
    if drives:
        parts: list[str | Table] = [
            Table(*fleet_comparison_rows(found, drives), labels=2),
            FLEET_LEGEND,
        ]
    else:
        parts = _parts(found, settings)
        if style != "markdown" and not _instead(found, settings):
            parts.insert(0, Table(*rows_of.full_rows(found)))
    click.echo(page(parts, style, wide))
    if any(figures):
        from egolane_pgm.report import comparison_figures as draws

        accuracy = draws.draw_lags if settings.lags else draws.draw_comparison
        for draw, path in zip((accuracy, draws.draw_differences), figures, strict=True):
            if path:
                draw(found, path)
    for failed in found["failed"]:
        options.failed(failed["title"], failed["error"])
    if unwritten is not None:
        raise unwritten
    if done.stopped is not None:
        n_done = len(found["recordings"]) + len(found["failed"])
        raise KeyboardInterrupt(
            f"this is {n_done} of {len(groups)} recordings; the same command begins anew"
        )
    if found["failed"]:
        raise SystemExit(1)


def _parts(found: Mapping[str, Any], settings: Options) -> list[str | Table]:
    parts: list[str | Table] = []
    instead = _instead(found, settings)
    together = [] if instead else rows_of.together_tables(found)
    searched = rows_of.search_rows(found)
    parts += [Table(*searched)] if searched[1] else []
    parts += [Table(*each) for each in together]
    legends = []
    if instead:
        parts += [*instead, rows_of.marks_text(found)]
        legends += [rows_of.LAGS_LEGEND] if settings.lags else []
        legends += [lane_changes.LEGEND] if settings.events else []
    elif rows_of.is_repeated(found):
        parts += [Table(*rows_of.seeds_rows(found), labels=2), rows_of.marks_text(found)]
        legends += [rows_of.LEGEND, rows_of.SEEDS_LEGEND]
    else:
        parts += [Table(*rows_of.accuracy_rows(found)), rows_of.marks_text(found)]
        if rows_of.has_untrusted(found):
            parts.append(
                "Above without the frames of tuning.never_fit, whose labels are not trusted;"
                " with them:"
            )
            parts.append(Table(*rows_of.accuracy_rows(found, "all_frames")))
        parts += rows_of.full_tables(found)
        legends.append(rows_of.LEGEND)
    legends += [rows_of.TOGETHER_LEGEND] if together else []
    if settings.health:
        parts.append(Table(*rows_of.health_rows(found)))
        legends.append(rows_of.HEALTH_LEGEND)
    # They are wrapped as wide as the terminal is.
    return parts + [" ".join(legend.split()) for legend in legends]


def _instead(found: Mapping[str, Any], settings: Options) -> list[Table]:
    """The tables that were asked for instead of those of all scores."""
    asked = []
    if settings.lags:
        header, rows = rows_of.lag_rows(found)
        asked.append(Table(header, rows, labels=1 + ("experiment" in header)))
    if settings.events:
        asked.append(Table(*lane_changes.event_comparison_rows(found), labels=2, leaves_out=True))
    return asked


def _write_first(json_file: Path | None, found: Mapping[str, Any]) -> InputError | None:
    """Write the numbers before anything is printed, because a reader may close the pipe. An error
    is returned, to be raised after the numbers are printed."""
    try:
        if json_file:
            write_json(json_file, found)
    except InputError as error:
        return error
    return None


def _in_sample(
    names: Sequence[str],
    numbers: Sequence[int],
    which: str,
    style: str,
    wide: bool,
    json_file: Path | None,
) -> None:
    found = compare_on_runs(names, numbers, which).document
    unwritten = _write_first(json_file, found)
    parts: list[str | Table] = []
    for key, title in TITLES.items():
        header, rows = compare_rows(found, key)
        parts += [title, Table(header, rows)]
    parts.append(
        f"Parameters: the paper's ({which}), as far as a graph has them; in-sample: the authors"
        " tuned them for sensor_failure on these very frames."
    )
    if "wor_on_lane" in names and "sensor_failure" in names:
        parts.append(
            "wor_on_lane is sensor_failure until its p3 and p4 differ from lane to lane; the paper"
            " has one value of each. With --held-out they are searched."
        )
    click.echo(page(parts, style, wide))
    if unwritten is not None:
        raise unwritten

"""Writes the page of one or several results."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from egolane_pgm import __version__
from egolane_pgm.inference.events import SURE
from egolane_pgm.page import lists
from egolane_pgm.page.films import films_of
from egolane_pgm.page.packed import Packed, packed
from egolane_pgm.results import Result
from egolane_pgm.tools.extras import needed
from egolane_pgm.tools.files import write_text
from egolane_pgm.types import InputError
from egolane_pgm.views.answers import is_known, percent, title_of
from egolane_pgm.views.events import event_lines
from egolane_pgm.views.reliability import reliability_figure
from egolane_pgm.views.shown import scored
from egolane_pgm.views.style import figure_bytes
from egolane_pgm.views.tables import TUNED_ON, score_rows, score_text

with needed("a page of results", "page"):
    from jinja2 import Environment, StrictUndefined

    from egolane_pgm.page.timeline import Panels, embedded, text_of, timeline


def write_page(results: Sequence[Result], path: str | Path) -> list[str]:
    """Write one HTML file that shows results on one time axis; it needs no network.

    - path: of the file; its folder is made.

    Returns what the page lacks, a line each (pictures that are not there any more). Raises
    InputError for a result without frames, and where the file cannot be written.
    """
    if not results:
        raise InputError("plot: names no result")
    page, lacking = page_of(results)
    write_text(path, page, make_folder=True)
    return lacking


def page_of(results: Sequence[Result]) -> tuple[str, list[str]]:
    """The page, and what it lacks."""
    packs = [packed(result) for result in results]
    titles = _told_apart(results)
    changes = [lists.changes_of(result) for result in results]
    panels = Panels(packs, changes, titles)
    films, lacking = films_of(results, titles)
    scripts, plot = embedded(*timeline(panels))
    # Names that contain HTML are shown as text.
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    page = environment.from_string(text_of("page.html")).render(
        version=__version__,
        title=titles[0] if len(results) == 1 else f"{len(results)} results side by side",
        style=text_of("page.css"),
        results=list(map(_part, results, titles, changes)),
        warnings=_warnings(results, titles),
        notes=[*_notes(results, packs, titles), *lacking],
        has_truth=any(result.truth is not None for result in results),
        timeline=plot,
        height=panels.height,
        panels=list(zip(panels.all, panels.top, strict=True)),
        legend=_legend(panels),
        films=films,
        scores=_scores(results, titles),
        parameters=_beside("parameter", list(map(_parameters, results)), titles, " (differs)"),
        provenance=_beside("", list(map(_provenance_of, results)), titles),
        names=[
            {"title": title if len(results) > 1 else "", "curves": pack.curves}
            for title, pack in zip(titles, packs, strict=True)
        ],
        scripts=scripts,
    )
    return page, lacking


def _told_apart(results: Sequence[Result]) -> list[str]:
    """The results' titles; those of the same name with their directory."""
    titles = [title_of(result) for result in results]
    return [
        f"{title} ({result.directory})" if titles.count(title) > 1 else title
        for title, result in zip(titles, results, strict=True)
    ]


def _warnings(results: Sequence[Result], titles: Sequence[str]) -> list[str]:
    several = len(results) > 1
    return [
        f"{title}: {warning}" if several else str(warning)
        for title, result in zip(titles, results, strict=True)
        for warning in result.run.get("warnings", ())
    ]


def _notes(
    results: Sequence[Result], packs: Sequence[Packed], titles: Sequence[str]
) -> Iterator[str]:
    """What the timeline does not show as it is, a line each."""
    latest = max(float(pack.columns["t"][0]) for pack in packs)
    if latest > min(float(pack.columns["t"][-1]) for pack in packs):
        yield "Not all of these results have a time in common: they are of different drives."
    for result, pack, title in zip(results, packs, titles, strict=True):
        if pack.frames_per_step > 1:
            yield (
                f"{title}: too long to show every frame. A step of the timeline stands for"
                f" {pack.frames_per_step} frames: beliefs are their means; answers, truth and lines"
                " are those of one (the first that the model answers wrong, if any). Scores and"
                " lists are of all frames."
            )
        if result.lines is None:
            yield (
                f"{title}: its directory has no lines (it was written by an older version); run"
                " the experiment again to see them."
            )


def _legend(panels: Panels) -> list[tuple[str, tuple[tuple[str, str], ...]]]:
    """What the colours mean in each kind of panel."""
    found = {panel.legend: panel.title for panel in panels.all if panel.legend}
    return [(title.split(":")[0], legend) for legend, title in found.items()]


def _part(result: Result, title: str, changes: lists.Changes) -> dict[str, Any]:
    """What the page says of one result."""
    said, header, places = lists.worst_stretches(result)
    change_header, change_places = lists.change_places(changes.listed)
    clip_header, clips = lists.clip_places(result)
    events = result.scores.get("events", {})
    return {
        "title": title,
        "figures": list(_figures(result, changes, places)),
        "lead": _lead(result),
        "stretches": {"said": said, "header": header, "places": places},
        "changes": _first(change_header, change_places),
        "clips": _first(clip_header, clips),
        "event_lines": event_lines(events) if "within" in events else [],
        "confusions": _confusions(result),
        "reliability": _reliability(result),
        "experiment": yaml.safe_dump(
            json.loads(json.dumps(result.config)), sort_keys=False, allow_unicode=True
        ),
    }


def _reliability(result: Result) -> str | None:
    """The picture of the calibration, as an address that holds it whole; None without truth."""
    if not is_known(result).any():
        return None
    picture = figure_bytes(lambda: reliability_figure(result), ".svg")
    return f"data:image/svg+xml;base64,{base64.b64encode(picture).decode()}"


def _first(header: Sequence[str], places: Sequence[lists.Place]) -> dict[str, Any]:
    more = max(len(places) - lists.ROWS, 0)
    return {"header": header, "places": places[: lists.ROWS], "more": more}


def _figures(
    result: Result, changes: lists.Changes, worst: Sequence[lists.Place]
) -> Iterator[tuple[str, str, lists.Place | None]]:
    """A result in a few figures: each with what it is, and the place that a click on it goes to."""
    scores = scored(result)
    if "model" in scores:
        said = "lane right"
        if interval := scores["model"].get("intervals", {}).get("accuracy"):
            said += f" ({100 * interval[0]:.1f} to {100 * interval[1]:.1f})"
        if "detector" in scores:
            said += f"; detector alone {percent(scores['detector']['accuracy'])} %"
        yield f"{percent(scores['model']['accuracy'])} %", said, None
    is_sure = result.marginals["Lane"].max(axis=1) >= SURE
    yield f"{percent(is_sure.mean())} %", f"sure: a lane has {SURE:g} or more", None
    said = "lane changes told"
    if result.truth is not None:
        n_right = sum(change.outcome == lists.RIGHT for change in changes.told)
        said += f", {n_right} right; the truth has {len(changes.true)}"
    yield f"{len(changes.told)}", said, None
    if worst:
        said = "where it fails most" if result.truth is not None else "where it is least sure"
        yield f"{worst[0].cells[0]} s", said, worst[0]


def _lead(result: Result) -> str:
    """What a result is of, in one sentence."""
    run, experiment = result.run, result.config
    said = [f"{len(result.frame_id):,} frames, {result.n_lanes} lanes"]
    said.append(f"graph {experiment.get('graph')}, evidence {experiment.get('evidence')}")
    tuned_on = str(run.get("tuned_on", ""))
    has_scores = bool(scored(result))
    said.append(TUNED_ON.get(tuned_on, tuned_on) if has_scores else "no ground truth")
    said.append("causal" if run.get("is_causal") else "not causal")
    return "; ".join(said)


def _scores(results: Sequence[Result], titles: Sequence[str]) -> dict[str, Any]:
    """One table of all scores: a row for each, a column for each answer."""
    header, rows = ["score"], list[list[str]]()
    for result, title in zip(results, titles, strict=True):
        scores = scored(result)
        if not scores:
            continue
        mine, found = score_rows(scores)
        if not rows:
            rows = [[row[0]] for row in found]
        cells = {row[0]: row[1:] for row in found}
        for row in rows:
            row += cells.pop(row[0], ["-"] * (len(mine) - 1))
        # An interval that only later results have.
        rows += [[label, *["-"] * (len(header) - 1), *last] for label, last in cells.items()]
        header += [f"{title}: {who}" if len(results) > 1 else who for who in mine[1:]]
    return {"header": header, "rows": rows}


def _confusions(result: Result) -> list[dict[str, Any]]:
    found = []
    for who, scores in scored(result).items():
        matrix = scores["confusion"]
        n = len(matrix[0])
        total = [max(sum(row[k] for row in matrix), 1) for k in range(n)]
        rows = []
        for r, row in enumerate(matrix):
            cells = []
            for k, count in enumerate(row):
                share = count / total[k]
                said = f"{percent(share)} %" if count else ""
                kind = "right" if r == k else "wrong"
                cells.append({"count": count, "share": share, "said": said, "kind": kind})
            rows.append({"name": f"lane {r + 1}" if r < n else "no answer", "cells": cells})
        name = "Model" if who == "model" else "Detector alone"
        found.append({"who": name, "n": n, "rows": rows})
    return found


def _parameters(result: Result) -> dict[str, str]:
    given = result.config.get("parameters") or {}
    return {key: f"{v:g}" if isinstance(v, float) else str(v) for key, v in given.items()}


def _beside(
    what: str, each: Sequence[Mapping[str, str]], titles: Sequence[str], differs: str = ""
) -> dict[str, Any]:
    """A table of what is known of each result, a row for each thing.

    - differs: what follows the name of a thing that is not the same of all.
    """
    rows = []
    for key in dict.fromkeys(key for found in each for key in found):
        values = [found.get(key, "-") for found in each]
        rows.append([key + differs * (len(set(values)) > 1), *values])
    return {"header": [what, *(titles if len(titles) > 1 else ["value"])], "rows": rows}


def _provenance_of(result: Result) -> dict[str, str]:
    """Where the numbers of a result come from."""
    run = result.run
    found = {
        "directory": str(result.directory),
        "made": str(run.get("created", "-")),
        "parameters": TUNED_ON.get(run.get("tuned_on", ""), str(run.get("tuned_on"))),
        "causal": "; ".join(run.get("why_not_causal") or ["yes: earlier frames only"]),
        "frames": f"{len(result.frame_id)}, {int(is_known(result).sum())} scored",
        "mean log evidence": score_text(run.get("mean_log_evidence")),
        "impossible frames": str(run.get("impossible_frames", "-")),
        "hash of the experiment": str(run.get("config_hash", "-")),
    }
    for k, entry in enumerate(run.get("data", ()), start=1):
        found[f"file {k}"] = f"{entry['path']} ({entry['bytes']:,} bytes, sha256 {entry['sha256']})"
    git = run.get("git")
    if git:
        found["commit"] = f"{git['commit']}{', with changes' if git['dirty'] else ''}"
    found["versions"] = ", ".join(f"{k} {v}" for k, v in run.get("versions", {}).items())
    return found

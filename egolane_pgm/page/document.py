"""Results as a single HTML file: a Bokeh timeline, jump lists, scores, notes and the experiment.

The file needs no network and no other file, and shows names of files without their folders.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from egolane_pgm.inference.events import SURE
from egolane_pgm.page.segments import lane_changes, worst_segments
from egolane_pgm.result import Result
from egolane_pgm.tools.extras import needed
from egolane_pgm.tools.files import write_text
from egolane_pgm.types import InputError
from egolane_pgm.views.events import event_lines
from egolane_pgm.views.result_text import result_title, scores_by_side
from egolane_pgm.views.tables import cell, confusion_table, score_table

with needed("a page of results", "page"):
    from bokeh.embed import file_html
    from bokeh.layouts import gridplot
    from bokeh.models import Range1d
    from bokeh.resources import INLINE

    from egolane_pgm.page.timeline import panels

#: A jump shows so much before and after the place, seconds.
MARGIN_S = 5.0

#: Columns of a list that are not shown.
_HIDDEN = ["begin_s", "end_s", "to_lane", "direction"]


def write_page(results: Sequence[Result], file: Path) -> None:
    """Write the page of results, which share one time axis.

    Raises InputError for a result with several drives, and if the file cannot be written.
    """
    for result in results:
        if "drive" in result.frames:
            raise InputError(
                f"{result.directory or result.name}: has several drives; run one of them for a page"
            )
    is_one = len(results) == 1
    given = {r.name if is_one else f"{k}: {r.name}": r for k, r in enumerate(results, start=1)}
    changes = {name: lane_changes(result) for name, result in given.items()}
    times = pd.concat(result.frames["time_s"] for result in results)
    time = Range1d(times.min(), times.max(), name="time", bounds="auto", min_interval=0.5)
    shown: dict[Any, Any] = {}  # Panels that several results share are shown once.
    scored = {}
    events = []
    for name, result in given.items():
        for key, panel in panels(result, changes[name], "" if is_one else name, time):
            shown.setdefault(key, panel)
        for who, scores in scores_by_side(result).items():
            scored[who if is_one else f"{name}, {who}"] = scores
        if "within" in result.scores["events"]:
            events.append("\n".join([name, *event_lines(result.scores["events"])]))
    last = list(shown.values())[-1]
    last.xaxis.visible = True
    last.height = last.height + 45
    bar = {"toolbar_location": "above", "toolbar_options": {"logo": None}}
    grid = gridplot([[panel] for panel in shown.values()], sizing_mode="stretch_width", **bar)
    grid.name = "timeline"
    notes = [f"{name}: {note}" for name, result in given.items() for note in result.notes]
    notes += [f"{name}: has no lines" for name, result in given.items() if not result.lines]
    words = {
        "results": [result_title(result) for result in results],
        "notes": [without_folders(note) for note in notes],
        "sure": SURE,
        "worst": _jump_list({name: worst_segments(r.frames) for name, r in given.items()}),
        "changes": _jump_list(changes),
        "scores": score_table(scored) if scored else None,
        "confusions": [confusion_table(s["confusion"], who) for who, s in scored.items()],
        "events": events,
        "experiments": [(name, without_folders(_experiment(r))) for name, r in given.items()],
    }
    template = resources.files(__package__).joinpath("page.html").read_text(encoding="utf-8")
    look = {"template": template, "template_variables": words}
    write_text(file, file_html(grid, INLINE, ", ".join(given), **look))


def _jump_list(lists: Mapping[str, pd.DataFrame]) -> dict[str, Any]:
    """The rows of all results as a table; a click on a row shows its place, seconds."""
    table = pd.concat([table.assign(result=name) for name, table in lists.items()])
    if table.empty:
        return {"header": [], "rows": []}
    order, ascending = ("frames", False) if "frames" in table else ("begin_s", True)
    table = table.sort_values(order, ascending=ascending, kind="stable")
    hidden = [*_HIDDEN, "result"] if len(lists) == 1 else _HIDDEN
    shown = table.drop(columns=hidden, errors="ignore")
    times = zip(table["begin_s"], table["end_s"], strict=True)
    shown.insert(0, "time (s)", [f"{begin:.1f} to {end:.1f}" for begin, end in times])
    places = zip(table["begin_s"] - MARGIN_S, table["end_s"] + MARGIN_S, strict=True)
    cells = [[cell(value) for value in row] for row in shown.to_numpy(object)]
    return {"header": list(shown), "rows": list(zip(places, cells, strict=True))}


def _experiment(result: Result) -> str:
    """The experiment as YAML, with its files, the versions and the commit."""
    run = {key: result.run[key] for key in ("created", "data", "git", "versions")}
    run["why_not_causal"] = result.run["why_not_causal"]
    return str(yaml.safe_dump({**result.run["config"], "run": run}, sort_keys=False))


def without_folders(text: str) -> str:
    """Replace absolute paths by the names of their files."""
    return re.sub(r"(?<![\w.])(?:[A-Za-z]:)?(?:[\\/][\w.+@~-]+)*[\\/]([\w.+@~-]+)", r"\1", text)

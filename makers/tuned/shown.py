"""The tables and the figure of what the searches found."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure

import egolane_pgm as ego
from egolane_pgm.types import FloatArray
from egolane_pgm.views.answers import DETECTOR_COLOUR, FAINT, INK, MODEL_COLOUR
from egolane_pgm.views.style import axes_at, new_figure, put_title, text_colour, write_figure
from egolane_pgm.views.tables import markdown
from makers.tuned.measured import Found

#: From 0.3 of accuracy lost, dark orange, to none, white, and 0.1 gained, blue.
LOSS_RANGE = Normalize(-0.3, 0.1)
LOSS = LinearSegmentedColormap.from_list(
    "loss", [(0.0, "#a63a00"), (0.45, "#f5b97f"), (0.75, "#ffffff"), (1.0, "#3f93c7")]
)

#: A row and a column of the figure, inches.
ROW, COLUMN = 0.22, 0.46

ROADS = {"italy": "A4", "spain": "A2"}


def title_of(name: str) -> str:
    """`run01_italy_ml` as `A4 ml`, `detector_ml` as `ml, both`, `all_italy` as `A4, all`."""
    first, *rest = name.split("_")
    if first == "detector":
        return f"{rest[0]}, both"
    if first == "all":
        return f"{ROADS.get(rest[0], rest[0])}, all"
    return " ".join(ROADS.get(part, part) for part in rest) or name


def _number(value: float) -> str:
    return f"{value:.0f}" if value == int(value) else f"{value:.2f}"


def _with_range(values: FloatArray) -> str:
    return f"{values.mean():.3f} ({values.min():.3f} to {values.max():.3f})"


def page(groups: Sequence[Found], on: Mapping[str, ego.Objective]) -> Iterator[str]:
    """The tables, part by part.

    - on: the recordings.
    """
    named, names = [(title_of(group.name), group) for group in groups], list(groups[0].told)
    yield "## What the searches reach"
    yield (
        "Accuracy: mean over the seeds, and their range. The interval is a block bootstrap's (300"
        " frames, 2,000 resamples), mean over the seeds. *the paper's*: in-sample, with the"
        " published parameters of each run."
    )
    header = [
        "searched on",
        "the paper's",
        "in-sample",
        "held out",
        "95 %",
        "in-sample less held out",
    ]
    yield markdown(header, [_reached(group, on) for group in groups])
    yield "Without the frames whose labels are in doubt, on which no held-out study was fitted:"
    trusted = [(title, *map("{:.3f}".format, g.trusted)) for title, g in named if g.trusted]
    yield markdown(["searched on", "in-sample", "held out"], trusted)
    yield "## What transfers"
    yield (
        "A row is what was searched on, a column what is scored. In italics: held out, that"
        " recording was searched on; in brackets in-sample. The detectors of a road saw one drive:"
        " only on the other road are all labels unseen."
    )
    transfers = [[title, *(_transfers(g, name) for name in on)] for title, g in named]
    yield markdown(["searched on", *map(title_of, on)], transfers)
    yield "## The parameters"
    yield (
        "Median (range) of the seeds, and [least, largest] value that the frames do not refute:"
        " with the other parameters searched anew, the accuracy is not below that of the best"
        " search by the whole 95 % interval of their difference. A longer search may find more."
    )
    spreads = [[title, *(_spread(g, name) for name in names)] for title, g in named]
    yield markdown(["searched on", *names], spreads)
    yield "## What the frames tell of them"
    yield (
        "The share of the 10 to 25 values over the range that is not refuted, with the other"
        " parameters held and with them searched anew; how far apart the seeds end: median (range)"
        " of the rows above."
    )
    header = ["parameter", "others held", "others anew", "seeds apart"]
    yield markdown(header, [_told(groups, name) for name in names])


def _reached(group: Found, on: Mapping[str, ego.Objective]) -> list[str]:
    return [
        title_of(group.name),
        f"{np.mean([on[name]({}) for name in group.members]):.3f}",
        _with_range(group.seen),
        _with_range(group.held),
        f"[{group.bounds[0]:.3f}, {group.bounds[1]:.3f}]",
        "{:+.3f} [{:+.3f}, {:+.3f}]".format(*group.lost),
    ]


def _transfers(group: Found, name: str) -> str:
    if name in group.members:
        return f"*{group.held_on[name]:.3f}* ({group.on[name]:.3f})"
    return f"{group.on[name]:.3f}"


def _spread(group: Found, name: str) -> str:
    values = [point[name] for point in group.points]
    low, middle, high = map(_number, (min(values), float(np.median(values)), max(values)))
    anew = group.told[name][1]
    return f"{middle} ({low} to {high}) [{_number(anew.low)}, {_number(anew.high)}]"


def _told(groups: Sequence[Found], name: str) -> list[str]:
    shares = [[group.told[name][k].share for group in groups] for k in (0, 1)]
    apart = [float(np.ptp([point[name] for point in group.points])) for group in groups]
    return [
        name,
        *(f"{np.median(each):.0%} ({min(each):.0%} to {max(each):.0%})" for each in shares),
        f"{np.median(apart):.2f} ({min(apart):.2f} to {max(apart):.2f})",
    ]


# --- the figure -----------------------------------------------------------------------------------


def draw(groups: Sequence[Found], on: Mapping[str, ego.Objective], path: Path) -> None:
    """Draw accuracies, transfer and parameters, each with a row for each group."""
    write_figure(lambda: _figure(groups, on), path)


def _figure(groups: Sequence[Found], on: Mapping[str, ego.Objective]) -> Figure:
    names = list(groups[0].told)
    rows, left, scores = ROW * len(groups), 0.85, 3.7
    matrix, top = COLUMN * len(on), 0.95
    figure = new_figure(left + scores + 0.3 + matrix + 1.0, top + 2 * rows + 1.65)
    put_title(figure, "One parameter set searched for a run, a detector on both roads, or a road")
    _draw_scores(axes_at(figure, left, top, scores, rows), groups)
    start = left + scores + 0.3
    ax = axes_at(figure, start, top, matrix, rows)
    bar = axes_at(figure, start + matrix + 0.12, top, 0.12, rows)
    _draw_transfer(ax, bar, groups, list(on))
    each = (figure.get_figwidth() - left - 0.15) / len(names)
    for k, name in enumerate(names):
        place = axes_at(figure, left + k * each, top + rows + 1.1, each - 0.12, rows)
        _draw_parameter(place, groups, on, name, is_first=k == 0)
    return figure


def _draw_rows(ax: Axes, groups: Sequence[Found], *, is_named: bool) -> None:
    """A row for each group, with a line where the number of its recordings or the road changes."""
    ax.set_ylim(len(groups) - 0.5, -0.5)
    titles = [title_of(group.name) for group in groups]
    ax.set_yticks(range(len(groups)), titles if is_named else [], fontsize=8)
    kinds = [group.name.rsplit("_", 1)[0][5:] for group in groups]
    for k in range(1, len(groups)):
        if kinds[k] != kinds[k - 1]:
            ax.axhline(k - 0.5, color=FAINT, linewidth=0.8, zorder=0)
    ax.tick_params(labelsize=8, length=2)


def _draw_scores(ax: Axes, groups: Sequence[Found]) -> None:
    for k, group in enumerate(groups):
        label = "95 % interval of held out" if k == 0 else None
        ax.plot(group.bounds, [k, k], color=FAINT, linewidth=1.5, zorder=1, label=label)
        for values, colour, marker, what in (
            (group.seen, DETECTOR_COLOUR, "s", "in-sample"),
            (group.held, MODEL_COLOUR, "o", "held out"),
        ):
            ax.plot([min(values), max(values)], [k, k], color=colour, linewidth=4, alpha=0.45)
            label = f"{what}: mean and range of the seeds" if k == 0 else None
            ax.plot(np.mean(values), k, marker, color=colour, markersize=4, label=label)
    _draw_rows(ax, groups, is_named=True)
    ax.set_xlabel("accuracy, share of frames without crossings", fontsize=8)
    ax.grid(axis="x", color="#e8e8e8", linewidth=0.6)
    ax.legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), fontsize=7, frameon=False)


def _draw_transfer(ax: Axes, bar: Axes, groups: Sequence[Found], names: Sequence[str]) -> None:
    """The accuracy of each group on each recording, and how far it is from what a search on that
    recording itself reaches held out."""
    own = {g.name: g.held_on[g.name] for g in groups if g.name in g.held_on}
    value = np.array([[g.held_on.get(name, g.on[name]) for name in names] for g in groups])
    lost = value - np.array([own.get(name, np.nan) for name in names])
    image = ax.imshow(lost, cmap=LOSS, norm=LOSS_RANGE, aspect="auto")
    for k, group in enumerate(groups):
        for j, name in enumerate(names):
            colour = text_colour(LOSS(LOSS_RANGE(lost[k, j]))[:3])
            weight = "bold" if name in group.members else "normal"
            text = f"{value[k, j]:.2f}".lstrip("0")
            ax.text(j, k, text, ha="center", va="center", fontsize=8, color=colour, weight=weight)
    _draw_rows(ax, groups, is_named=False)
    titles = [title_of(name).replace(" ", "\n") for name in names]
    ax.set_xticks(range(len(names)), titles, fontsize=8)
    ax.set_xlabel("scored on", fontsize=8)
    ax.set_title("accuracy; bold: held out, that recording was searched on", fontsize=8)
    ax.figure.colorbar(image, cax=bar, extend="both")
    bar.tick_params(labelsize=7)
    bar.set_ylabel("minus that of a search on that recording, held out", fontsize=7.5)


def _draw_parameter(
    ax: Axes, groups: Sequence[Found], on: Mapping[str, ego.Objective], name: str, *, is_first: bool
) -> None:
    for k, group in enumerate(groups):
        held, anew = group.told[name]
        values = [point[name] for point in group.points]
        papers = [on[group.name].start[name]] if group.name in on else []
        for told, colour, width, what in (
            (anew, "#c9dcea", 7, "others searched anew"),
            (held, MODEL_COLOUR, 2.5, "others held"),
        ):
            label = f"not refuted, {what}" if is_first and k == 0 else None
            ax.plot([told.low, told.high], [k, k], color=colour, linewidth=width, label=label)
        for shown, marker, colour, what in (
            (values, "|", DETECTOR_COLOUR, "best of each seed"),
            (papers, "x", INK, "the paper's"),
        ):
            label = what if is_first and k == 0 else None
            ax.plot(shown, [k] * len(shown), marker, color=colour, markersize=5, label=label)
    _draw_rows(ax, groups, is_named=is_first)
    if name.startswith("sigma"):
        ax.set_xscale("log")
        ax.set_xticks([0.03, 0.1, 0.3, 1, 3], ["0.03", "0.1", "0.3", "1", "3"])
        ax.set_xlim(0.025, 3.6)
        ax.minorticks_off()
    elif name == "bonus_value":
        ax.set_xticks([0, 3, 6, 9])
    else:
        ax.set_xlim(-0.05, 1.05)
    ax.set_xlabel(f"{name}, lanes" if name.startswith("sigma") else name, fontsize=8)
    ax.tick_params(labelsize=7)
    if is_first:
        ax.legend(loc="lower left", bbox_to_anchor=(-0.06, 1.0), ncols=4, fontsize=7, frameon=False)

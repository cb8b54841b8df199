"""The tables of a network as heat maps."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from egolane_pgm.inference.compile import Compiled, compiled_of
from egolane_pgm.views.description import describe_tables, table_frame
from egolane_pgm.views.style import PROBABILITY_RAMP, inline_figure, new_figure, text_colour

#: Width and height of a cell, inches: room for a number of five characters.
_CELL = (0.42, 0.19)

#: Width and height of the largest table, inches: 10 columns and 32 rows with their numbers.
_LARGEST = (4.2, 6.1)

#: Width of the figure, inches.
_WIDE = 10.0

#: Width of a letter, inches, at 8 points.
_LETTER = 0.068

#: Tables with more rows than this are not drawn but named.
MAX_ROWS = 1000


def draw_tables(network: Any) -> Figure:
    """Draw the tables of a network as heat maps: a row per combination of the parents' values.

    - network: as in `draw_network`.

    The numbers are in the cells of tables with up to 32 rows and 10 columns.

    >>> import egolane_pgm as ego
    >>> run = ego.run("quickstart", overrides={"recording.frames": [0, 300]})
    >>> figure = ego.draw_tables(run)
    """
    return inline_figure(lambda: tables_figure(compiled_of(network)))


def tables_figure(compiled: Compiled) -> Figure:
    """Draw the heat maps of `draw_tables`, side by side in as many rows as they need."""
    notes = ["rows: values of the parents; lane 1 is the leftmost"]
    panels = []
    x = 0.0
    y = 0.8
    below = 0.0
    for each in describe_tables(compiled):
        name, frame = table_frame(each, compiled.values)
        name += ", first frame" * (each["frames"] == "first frame")
        if len(frame) > MAX_ROWS:
            notes.append(f"not drawn, {frame.size:,} numbers: {name}")
            continue
        size = np.minimum(_LARGEST, np.multiply(frame.shape[::-1], _CELL))
        margin = 0.2 + _LETTER * max(map(len, frame.index))
        wide = max(margin + size[0], margin + _LETTER * len(name)) + 0.1
        if x > 0 and x + wide > _WIDE:
            x = 0.0
            y = y + below
            below = 0.0
        panels.append((name, frame.rename_axis(columns=each["node"]), x + margin, y, *size))
        x = x + wide
        below = max(below, size[1] + 0.85)
    tall = y + below
    figure = new_figure(_WIDE, tall, layout="none")
    figure.text(0.02, 1 - 0.1 / tall, "\n".join(notes), va="top", fontsize=8)
    for name, frame, left, top, width, height in panels:
        box = left / _WIDE, 1 - (top + height) / tall, width / _WIDE, height / tall
        ax = figure.add_axes(box)
        image = ax.imshow(frame, PROBABILITY_RAMP, vmin=0, vmax=1, aspect="auto")
        ax.set_title(name, fontsize=8, loc="left")
        ax.set_xlabel(frame.columns.name, fontsize=8)
        across, down = (-(-n // most) for n, most in zip(frame.T.shape, (10, 32), strict=True))
        ax.set_xticks(range(0, frame.shape[1], across), frame.columns[::across])
        ax.set_yticks(range(0, len(frame), down), frame.index[::down])
        ax.tick_params(length=0, labelsize=7)
        ax.grid(False)
        for (row, column), p in np.ndenumerate(frame if across == down == 1 else ()):
            text = f"{p:.3f}" if 0 < p < 1 else f"{p:.0f}"
            colour = text_colour(PROBABILITY_RAMP(p))
            ax.text(column, row, text, color=colour, ha="center", va="center", fontsize=6.5)
    if panels:
        bar = figure.add_axes((0.7, 1 - 0.25 / tall, 0.25, 0.1 / tall))
        figure.colorbar(image, bar, orientation="horizontal")
        bar.set_ylabel("probability ", rotation=0, ha="right", va="center")
    return figure

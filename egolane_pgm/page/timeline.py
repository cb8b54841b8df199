"""The timeline of a page: panels in Bokeh that share one time axis."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from bokeh.models import ColumnDataSource, HoverTool, LinearColorMapper, Range1d
from bokeh.palettes import interp_palette
from bokeh.plotting import figure
from numpy.typing import NDArray

from egolane_pgm.result import Result
from egolane_pgm.views import style
from egolane_pgm.views.frames import answers, is_known, true_lane

#: The most steps of a timeline; a step of a longer drive shows one of several frames.
MAX_STEPS = 20_000

#: Value of probability 1 in an image.
CERTAIN = 250

#: Value of a step without a frame or annotation.
BLANK = 255

#: Reach of the image of the lines to either side, metres.
REACH_M = 12.0

#: Resolution of the image of the lines, metres.
PIXEL_M = 0.2

CLEAR = "rgba(0, 0, 0, 0)"
SHADES = interp_palette(style.PROBABILITY_COLOURS, CERTAIN + 1)
ERRORS = [CLEAR, style.DETECTOR_COLOUR, style.UNASSIGNED_COLOUR]
LINES = [CLEAR, style.FAINT, style.MODEL_COLOUR, style.DETECTOR_COLOUR]


def panels(
    result: Result, changes: pd.DataFrame, name: str, time: Range1d
) -> Iterator[tuple[Any, Any]]:
    """Yield the panels of a result from top to bottom, each with a key: equal panels, equal keys.

    - changes: as `segments.lane_changes` lists them.
    - name: in front of each title; may be empty.
    - time: range of the time axis, shared by all panels of the page.
    """
    n = result.n_lanes
    x_s = result.frames["time_s"].to_numpy()
    step_s = max(1 / result.frame_rate, (x_s[-1] - x_s[0]) / MAX_STEPS)
    step, first = np.unique(np.round((x_s - x_s[0]) / step_s).astype(int), return_index=True)
    n_steps = step[-1] + 1
    frames = result.frames.iloc[first]
    known = is_known(frames)
    truth = true_lane(frames)
    hovered, tips = _hovered(frames)

    def image_of(values: NDArray[Any]) -> NDArray[np.uint8]:
        """(T, k) values as an image, (k, steps)."""
        image = np.full((values.shape[1], n_steps), BLANK, dtype=np.uint8)
        image[:, step] = np.nan_to_num(values, nan=BLANK).round().T
        return image

    def panel_of(title: str, rows: float, ticks: Any, y: tuple[float, float]) -> Any:
        """An empty panel, 20 pixels a row. y: bottom and top."""
        panel = figure(
            title=f"{name}: {title}" if name else title,
            height=int(34 + 20 * rows),
            x_range=time,
            y_range=Range1d(*y),
            tools="xpan,xwheel_zoom,xbox_zoom,xzoom_in,xzoom_out,reset",
            active_scroll="xwheel_zoom",
            min_border_left=34,
            sizing_mode="stretch_width",
        )
        panel.xaxis.visible = panel.grid.visible = False
        panel.xaxis.axis_label = "time (s)"
        panel.xaxis.formatter.use_scientific = False
        panel.title.text_font_size = "12px"
        panel.yaxis.ticker = list(ticks)
        dots = panel.scatter("time", sum(y) / 2, source=hovered, size=1, alpha=0)
        look = {"mode": "vline", "limit": 1, "attachment": "horizontal"}
        hover = HoverTool(renderers=[dots], tooltips=tips, point_policy="follow_mouse", **look)
        panel.add_tools(hover)
        return panel

    def draw(panel: Any, image: NDArray[Any], y: float, height: float, colours: Any) -> None:
        """Add an image over the whole time, from y on."""
        mapper = LinearColorMapper(colours, low=0, high=len(colours) - 1, high_color=style.GRID)
        place = {"x": x_s[0] - step_s / 2, "dw": step_s * n_steps, "y": y, "dh": height}
        panel.image([image], color_mapper=mapper, level="image", **place)

    for who, each in reversed(answers(frames).items()):
        image = image_of(CERTAIN * each.belief)
        kind = np.where(each.assigned > 0, 1, 2)
        error = np.where(known & (each.assigned != truth), kind, 0)
        errors = image_of(error[:, None])
        title = f"{who}: probability of each lane"
        panel = panel_of(title, n + 0.6, range(1, n + 1), (n + 1.1, 0.5))
        draw(panel, image, 0.5, n, SHADES)
        draw(panel, errors, n + 0.65, 0.4, ERRORS)
        yield (who, image.tobytes(), errors.tobytes()), panel

    shade = np.where(known, CERTAIN, CERTAIN + 1)[:, None]
    values = np.where(truth[:, None] == np.arange(1, n + 1), shade, 0.0)
    values[np.isnan(truth)] = np.nan
    panel = panel_of("Truth and reported lane changes", n, range(1, n + 1), (n + 0.5, 0.5))
    draw(panel, image_of(values), 0.5, n, [*SHADES, style.CROSSING])
    if len(changes):
        found = changes[changes["direction"] != 0]
        marks = {
            "x": found["end_s"],
            "y": found["to_lane"].where(found["to_lane"] > 0, (n + 1) / 2),
            "colour": found["outcome"].map(style.OUTCOMES),
            "marker": found["direction"].map({-1: "triangle", 1: "inverted_triangle"}),
        }
        source = ColumnDataSource({key: np.asarray(each) for key, each in marks.items()})
        look = {"marker": "marker", "fill_color": "colour", "line_color": "white", "size": 9}
        panel.scatter("x", "y", source=source, **look)
    yield name, panel

    if result.lines:
        [log] = result.lines.values()
        image = np.zeros((round(2 * REACH_M / PIXEL_M), n_steps), dtype=np.uint8)
        at = pd.Series(step, frames.index).reindex(log.frame_id, fill_value=-1).to_numpy()
        frame, line = np.nonzero((at >= 0)[:, None] & (np.abs(log.offset_m) < REACH_M))
        row = ((log.offset_m[frame, line] + REACH_M) / PIXEL_M).astype(int)
        kind = np.where(log.is_valid, 2 + log.is_continuous, 1)[frame, line]
        np.maximum.at(image, (row, at[frame]), kind.astype(np.uint8))
        ticks = np.arange(-REACH_M, REACH_M + 1, 4)
        panel = panel_of("Offsets of the lines, metres", 6, ticks, (REACH_M, -REACH_M))
        draw(panel, image, -REACH_M, 2 * REACH_M, LINES)
        yield image.tobytes(), panel


def _hovered(frames: pd.DataFrame) -> tuple[ColumnDataSource, list[tuple[str, str]]]:
    """The values that hovering shows, and their layout."""
    columns = {"time": frames["time_s"], "frame": frames.index}
    columns["truth"] = frames["true_lane"].astype(object).fillna("-")
    tips = [("time", "@time{0.0} s, frame @frame"), ("true lane", "@truth")]
    for who, each in reversed(answers(frames).items()):
        percent = np.round(100 * each.belief).astype(np.uint8).T
        columns[who] = each.assigned
        columns |= {f"{who}{k}": of_lane for k, of_lane in enumerate(percent, 1)}
        lanes = ", ".join(f"@{who}{k}" for k in range(1, len(percent) + 1))
        tips.append((who.lower(), f"lane @{who} (P in %: {lanes})"))
    return ColumnDataSource({key: np.array(each) for key, each in columns.items()}), tips

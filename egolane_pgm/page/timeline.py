"""The timeline of a page: panels in Bokeh that share one time axis."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
from bokeh.models import (
    ColumnDataSource,
    HoverTool,
    LinearColorMapper,
    Range1d,
)
from bokeh.palettes import interp_palette
from bokeh.plotting import figure
from numpy.typing import NDArray

from egolane_pgm.page.segments import lane_changes
from egolane_pgm.result import Result
from egolane_pgm.views import style
from egolane_pgm.views.answers import answers, is_known, true_lane

#: The most steps of a timeline; a step of a longer drive is the mean of several frames.
MAX_STEPS = 20_000

#: Values of an image: probability 1, and a step without a frame or annotation.
CERTAIN, BLANK = 250, 255

#: Reach and resolution of the image of the lines, metres.
REACH_M, PIXEL_M = 12.0, 0.2

CLEAR = "rgba(0, 0, 0, 0)"
SHADES = interp_palette(style.PROBABILITY_COLOURS, CERTAIN + 1)
ERRORS = [CLEAR, style.DETECTOR_COLOUR, style.UNASSIGNED_COLOUR]
LINES = [CLEAR, style.FAINT, style.MODEL_COLOUR, style.DETECTOR_COLOUR]


class Track:
    """The panels of one result.

    - name: in front of each title; may be empty.
    - time: range of the time axis, shared by all panels of the page.
    """

    def __init__(self, result: Result, name: str, time: Range1d) -> None:
        self.result, self.name, self.time = result, name, time
        frames = result.frames
        x_s = frames["time_s"].to_numpy()
        self.start, self.end = float(x_s[0]), float(x_s[-1])
        self.step_s = max(1 / result.frame_rate, (self.end - self.start) / MAX_STEPS)
        self.frames = frames.assign(step=np.round((x_s - x_s[0]) / self.step_s).astype(int))
        self.changes = lane_changes(result)
        self.hovered, self.tips = self._hovered()

    def panels(self) -> Iterator[tuple[Any, Any]]:
        """Yield the panels from top to bottom, each with a key that is equal for equal panels."""
        frames, n = self.frames, self.result.n_lanes
        known, truth = is_known(frames), true_lane(frames)
        for who, (belief, lane) in reversed(answers(frames).items()):
            image = self._image(CERTAIN * belief)
            error = np.where(known & (lane != truth), np.where(lane > 0, 1, 2), 0)
            errors = self._image(error[:, None], "max")
            panel = self._panel(f"{who}: probability of each lane", n + 0.6, range(1, n + 1))
            self._draw(panel, image, 0.5, n, SHADES)
            self._draw(panel, errors, n + 0.65, 0.4, ERRORS)
            yield (who, image.tobytes(), errors.tobytes()), panel
        yield self.name, self._truth_panel(known, truth)
        if self.result.lines:
            image, ticks = self._lines_image(), np.arange(-REACH_M, REACH_M + 1, 4)
            panel = self._panel("Offsets of the lines, metres", 6, ticks, (REACH_M, -REACH_M))
            self._draw(panel, image, -REACH_M, 2 * REACH_M, LINES)
            yield image.tobytes(), panel

    def _truth_panel(self, known: NDArray[Any], truth: NDArray[Any]) -> Any:
        """The true lane, and the reported lane changes."""
        n, shade = self.result.n_lanes, np.where(known, CERTAIN, CERTAIN + 1)[:, None]
        values = np.where(truth[:, None] == np.arange(1, n + 1), shade, 0.0)
        values[np.isnan(truth)] = np.nan
        panel = self._panel("Truth and reported lane changes", n, range(1, n + 1))
        self._draw(panel, self._image(values, "max"), 0.5, n, [*SHADES, style.CROSSING])
        if len(self.changes):
            found = self.changes[self.changes["direction"] != 0]
            marks = {
                "x": found["end_s"],
                "y": found["to_lane"].where(found["to_lane"] > 0, (n + 1) / 2),
                "colour": found["outcome"].map(style.OUTCOMES),
                "marker": found["direction"].map({-1: "triangle", 1: "inverted_triangle"}),
            }
            source = ColumnDataSource({key: np.asarray(each) for key, each in marks.items()})
            look = {"marker": "marker", "fill_color": "colour", "line_color": "white", "size": 9}
            panel.scatter("x", "y", source=source, **look)
        return panel

    def _panel(
        self, title: str, rows: float, ticks: Iterable[float], y: tuple[float, float] | None = None
    ) -> Any:
        """An empty panel, 20 pixels a row. y: bottom and top; by default lane 1 is on top."""
        y = y or (rows + 0.5, 0.5)
        panel = figure(
            title=f"{self.name}: {title}" if self.name else title,
            height=int(34 + 20 * rows),
            x_range=self.time,
            y_range=Range1d(*y),
            tools="xpan,xwheel_zoom,xbox_zoom,xzoom_in,xzoom_out,reset",
            active_scroll="xwheel_zoom",
            min_border_left=34,
            sizing_mode="stretch_width",
        )
        panel.xaxis.visible = panel.grid.visible = False
        panel.xaxis.axis_label, panel.xaxis.formatter.use_scientific = "time (s)", False
        panel.title.text_font_size = "12px"
        panel.yaxis.ticker = list(ticks)
        dots = panel.scatter("time", sum(y) / 2, source=self.hovered, size=1, alpha=0)
        look = {"mode": "vline", "limit": 1, "attachment": "horizontal"}
        hover = HoverTool(renderers=[dots], tooltips=self.tips, point_policy="follow_mouse", **look)
        panel.add_tools(hover)
        return panel

    def _hovered(self) -> tuple[ColumnDataSource, list[tuple[str, str]]]:
        """The values that hovering shows, for the first frame of each step, and their layout."""
        frames = self.frames.drop_duplicates("step")
        columns = {"time": frames["time_s"], "frame": frames.index}
        columns["truth"] = frames["true_lane"].astype(object).fillna("-")
        tips = [("time", "@time{0.0} s, frame @frame"), ("true lane", "@truth")]
        for who, (belief, lane) in reversed(answers(frames).items()):
            percent = np.round(100 * belief).astype(np.uint8).T
            columns |= {who: lane, **{f"{who}{k}": each for k, each in enumerate(percent, 1)}}
            lanes = ", ".join(f"@{who}{k}" for k in range(1, len(percent) + 1))
            tips.append((who.lower(), f"lane @{who} (P in %: {lanes})"))
        return ColumnDataSource({key: np.array(each) for key, each in columns.items()}), tips

    def _per_step(self, values: NDArray[Any], how: str = "mean") -> NDArray[Any]:
        """(T, k) values as (steps, k); NaN for a step without a frame."""
        step = self.frames["step"].to_numpy()
        steps = pd.DataFrame(values).groupby(step).agg(how).reindex(range(step[-1] + 1))
        return np.asarray(steps, dtype=np.float64)

    def _image(self, values: NDArray[Any], how: str = "mean") -> NDArray[np.uint8]:
        """(T, k) values as an image, (k, steps)."""
        steps = np.nan_to_num(self._per_step(values, how), nan=BLANK)
        return np.asarray(steps.T.round(), dtype=np.uint8)

    def _lines_image(self) -> NDArray[np.uint8]:
        """The lines as an image: 1 not valid, 2 valid, 3 valid and continuous."""
        n_steps, [log] = self.frames["step"].iloc[-1] + 1, self.result.lines.values()
        image = np.zeros((round(2 * REACH_M / PIXEL_M), n_steps), dtype=np.uint8)
        step = self.frames["step"].reindex(log.frame_id, fill_value=-1).to_numpy()
        frame, line = np.nonzero((step >= 0)[:, None] & (np.abs(log.offset_m) < REACH_M))
        row = ((log.offset_m[frame, line] + REACH_M) / PIXEL_M).astype(int)
        kind = np.where(log.is_valid, 2 + log.is_continuous, 1)[frame, line]
        np.maximum.at(image, (row, step[frame]), kind.astype(np.uint8))
        return image

    def _draw(
        self, panel: Any, image: NDArray[Any], y: float, height: float, palette: Sequence[str]
    ) -> None:
        """Add an image over the whole time, from y on."""
        colours = LinearColorMapper(palette, low=0, high=len(palette) - 1, high_color=style.GRID)
        place = {"x": self.start - self.step_s / 2, "dw": self.step_s * image.shape[1]}
        panel.image([image], y=y, dh=height, color_mapper=colours, level="image", **place)

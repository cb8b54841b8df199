"""A page's timeline, whose panels stand on one time axis, as a plot of Bokeh's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.embed import components
from bokeh.events import DocumentReady
from bokeh.models import (
    BoxZoomTool,
    ColumnDataSource,
    CustomJS,
    PanTool,
    Range1d,
    WheelZoomTool,
)
from bokeh.plotting import figure
from bokeh.resources import Resources

from egolane_pgm.page.lists import FALSE, MISSED, RIGHT, UNKNOWN, Changes
from egolane_pgm.page.packed import BLANK, CERTAIN, CONTINUOUS, NOT_VALID, VALID, Packed
from egolane_pgm.views.answers import (
    CROSSING,
    DETECTOR_COLOUR,
    FAINT,
    INK,
    MODEL_COLOUR,
    PROBABILITY_COLOURS,
)

#: Colours of the curves: Okabe and Ito's blue, vermillion, green and purple.
CURVE_COLOURS = (MODEL_COLOUR, DETECTOR_COLOUR, "#009e73", "#cc79a7")

#: Colours of lines by their kind.
LINE_COLOURS = {NOT_VALID: FAINT, VALID: MODEL_COLOUR, CONTINUOUS: DETECTOR_COLOUR}

#: Pixels: of a lane and of panels of other kinds, of the names above the panels, beside them.
_LANE, _CURVES, _LINES, _EVENTS, _ANSWER, _NAME, _LEFT, _RIGHT = 22, 64, 150, 34, 12, 22, 34, 10

#: Of the valid lines this share lies in what is drawn; farther than so much is never drawn, metres.
_NEAR, _FARTHEST_M = 0.995, 30.0

#: How the lane changes of each outcome are drawn.
CHANGE_COLOURS = {RIGHT: MODEL_COLOUR, UNKNOWN: INK, FALSE: DETECTOR_COLOUR}


@dataclass(frozen=True)
class Panel:
    """A panel of the timeline.

    - title: what it shows; whose: the names of the results that it is of, where there are several.
    - legend: colour and meaning of what is in it.
    - height: pixels; labels: a height in it, and what stands there at the left.
    - drawn: what page.js needs to draw it.
    """

    title: str
    whose: tuple[str, ...]
    legend: tuple[tuple[str, str], ...]
    height: int
    labels: tuple[tuple[float, str], ...]
    drawn: Mapping[str, Any]


class Panels:
    """The panels of several results on one time axis.

    - packs: the results' steps.
    - changes: their lane changes.
    - names: of the results, in the same order.
    """

    def __init__(
        self, packs: Sequence[Packed], changes: Sequence[Changes], names: Sequence[str]
    ) -> None:
        self.packs, self.names = packs, names
        self.all = [
            *self._strips("b", "Model: belief over the lanes"),
            *self._strips("d", "Detector alone"),
            *self._truth(),
            *self._events(changes),
            *self._answers(),
            *self._curves(),
            *self._lines(),
        ]
        heights = np.array([_NAME + panel.height for panel in self.all])
        #: Where each panel begins, from above, and how high all are.
        self.top = (np.cumsum(heights) - heights + _NAME).tolist()
        self.height = int(heights.sum())

    def _shared(self, *letters: str) -> Iterator[tuple[int, tuple[str, ...]]]:
        """The results that show something different in columns, or lines, that begin so, and whose
        it is."""
        found: dict[bytes, list[int]] = {}
        for k, pack in enumerate(self.packs):
            known = (*pack.columns, *pack.lines)
            names = [name for name in known if name.rstrip("0123456789") in letters]
            if names:
                found.setdefault(pack.of(*names), []).append(k)
        for group in found.values():
            yield group[0], self._whose(group)

    def _whose(self, group: Sequence[int]) -> tuple[str, ...]:
        if len(group) == len(self.packs):
            return ()
        return tuple(self.names[k] for k in group)

    def _strips(self, letter: str, title: str) -> Iterator[Panel]:
        for k, whose in self._shared(letter):
            n = _n_lanes(self.packs[k], letter)
            drawn = {"kind": "belief", "track": k, "letter": letter, "lanes": n}
            yield Panel(title, whose, (), _LANE * n, _lane_labels(n), drawn)

    def _truth(self) -> Iterator[Panel]:
        legend = ((MODEL_COLOUR, "annotated lane"), (CROSSING, "changing lanes"))
        for k, whose in self._shared("truth", "crossing"):
            if self.packs[k].columns["truth"].any():
                n = _n_lanes(self.packs[k])
                drawn = {"kind": "truth", "track": k, "lanes": n}
                yield Panel("Truth", whose, legend, _LANE * n, _lane_labels(n), drawn)

    def _events(self, changes: Sequence[Changes]) -> Iterator[Panel]:
        legend = (
            (MODEL_COLOUR, "● told, right"),
            (DETECTOR_COLOUR, "✕ told, no such change"),
            (CROSSING, "▮ true"),
            (INK, "▮ true, not told"),
        )
        for k, found in enumerate(changes):
            if not found.told and not found.true:
                continue
            drawn = {
                "kind": "events",
                "track": k,
                "told": [
                    [c.begin_s, CHANGE_COLOURS[c.outcome], c.outcome == FALSE] for c in found.told
                ],
                "true": [
                    [c.begin_s, c.end_s, INK if c.outcome == MISSED else CROSSING]
                    for c in found.true
                ],
            }
            shown = legend if found.true else ((INK, "● told"),)
            yield Panel("Lane changes", self._whose([k]), shown, _EVENTS, (), drawn)

    def _answers(self) -> Iterator[Panel]:
        legend = ((DETECTOR_COLOUR, "wrong"), (INK, "no answer"))
        for k, pack in enumerate(self.packs):
            if not pack.columns["truth"].any():
                continue
            rows = ["model", *(["detector"] if "detector" in pack.columns else [])]
            title = "Wrong: model above, detector below" if len(rows) > 1 else "Wrong answers"
            drawn = {"kind": "answers", "track": k, "names": rows}
            yield Panel(title, self._whose([k]), legend, _ANSWER * len(rows), (), drawn)

    def _curves(self) -> Iterator[Panel]:
        labels = ((0.05 * _CURVES, "1"), (0.5 * _CURVES, "0.5"), (0.95 * _CURVES, "0"))
        for k, pack in enumerate(self.packs):
            if pack.curves:
                n = len(pack.curves)
                colours = [CURVE_COLOURS[c % len(CURVE_COLOURS)] for c in range(n)]
                legend = tuple(zip(colours, pack.curves, strict=True)) if n > 1 else ()
                title = "Probabilities" if n > 1 else pack.curves[0]
                drawn = {"kind": "curves", "track": k, "colours": colours}
                yield Panel(title, self._whose([k]), legend, _CURVES, labels, drawn)

    def _lines(self) -> Iterator[Panel]:
        names = ("not valid", "valid", "valid, continuous")
        legend = tuple(zip(LINE_COLOURS.values(), names, strict=True))
        for k, whose in self._shared("first", "cm", "kind"):
            most = _reach_m(self.packs[k])
            # Left of the car, where offsets are negative, is above, as lane 1 is in the strips.
            labels = tuple((_LINES * (0.5 + m / most / 2), f"{m:g}") for m in _ticks(most))
            drawn = {"kind": "lines", "track": k, "most": most}
            yield Panel("Lines: offset from the car, m", whose, legend, _LINES, labels, drawn)


def _lane_labels(n: int) -> tuple[tuple[float, str], ...]:
    return tuple((_LANE * (k + 0.5), str(k + 1)) for k in range(n))


def _n_lanes(pack: Packed, letter: str = "b") -> int:
    return sum(name[0] == letter and name[1:].isdigit() for name in pack.columns)


def _reach_m(pack: Packed) -> float:
    """How far from the car lines are drawn, metres."""
    seen = np.abs(pack.lines["cm"][pack.lines["kind"] >= VALID].astype(np.float64)) / 100
    most = float(np.quantile(seen, _NEAR)) if len(seen) else 10.0
    return min(float(np.ceil(most + 0.5)), _FARTHEST_M)


def _ticks(most: float) -> list[float]:
    step = 2.0 if most < 7 else 4.0 if most < 15 else 10.0
    n = int(most / step)
    return [step * k for k in range(-n, n + 1)]


def timeline(panels: Panels) -> tuple[Any, CustomJS]:
    """All panels as one plot, and the script that draws them and reacts to clicks.

    Bokeh has the time axis, and moves and zooms one picture; page.js makes that picture. To paint
    a plot for each panel would take too long for sixty pictures a second.
    """
    packs = panels.packs
    begin = min(float(pack.columns["t"][0]) - pack.step_s for pack in packs)
    end = max(float(pack.columns["t"][-1]) + pack.step_s for pack in packs)
    shortest = 4 * min(pack.step_s for pack in packs)
    time = Range1d(start=begin, end=end, bounds=(begin, end), min_interval=shortest, name="time")
    pan, box = PanTool(dimensions="width"), BoxZoomTool(dimensions="width")
    wheel = WheelZoomTool(dimensions="width", maintain_focus=False)
    plot = figure(
        frame_height=panels.height,
        sizing_mode="stretch_width",
        x_range=time,
        y_range=Range1d(start=0, end=panels.height),
        x_axis_location="above",
        tools=[pan, box, wheel],
        active_drag=pan,
        active_scroll=wheel,
        toolbar_location=None,
        min_border_left=_LEFT,
        min_border_right=_RIGHT,
        min_border_top=0,
        min_border_bottom=0,
        outline_line_color=None,
        lod_threshold=None,
    )
    plot.yaxis.visible = plot.xgrid.visible = plot.ygrid.visible = False
    plot.xaxis.major_label_text_font_size = "11px"
    seed = np.zeros((1, 1), dtype=np.uint32)
    image = ColumnDataSource({"image": [seed], "x": [0.0], "dw": [1.0]}, name="image")
    plot.image_rgba("image", "x", 0, "dw", panels.height, source=image)
    ramp = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in PROBABILITY_COLOURS])
    at, stops = np.linspace(0, 1, CERTAIN + 1), np.linspace(0, 1, len(ramp))
    colours = np.stack([np.interp(at, stops, channel) for channel in ramp.T], axis=1)
    arguments = {
        "time": time,
        "plot": plot,
        "image": image,
        "tools": {"pan": pan, "box": box},
        "tracks": [
            {
                "columns": ColumnDataSource(data=dict(pack.columns)),
                "lines": ColumnDataSource(data=dict(pack.lines)),
                "step": pack.step_s,
                "each": pack.frames_per_step,
                "n": _n_lanes(pack),
                "curves": len(pack.curves),
            }
            for pack in packs
        ],
        "panels": [
            {**panel.drawn, "top": top, "height": panel.height}
            for panel, top in zip(panels.all, panels.top, strict=True)
        ],
        "look": {
            "ramp": np.round(colours).astype(np.uint8).ravel(),
            "blank": BLANK,
            "crossing": CROSSING,
            "wrong": DETECTOR_COLOUR,
            "none": INK,
            "faint": FAINT,
            "lines": [LINE_COLOURS[kind] for kind in sorted(LINE_COLOURS)],
            "lane": _LANE,
            "answer": _ANSWER,
            "right": _RIGHT,
        },
    }
    return plot, CustomJS(args=arguments, code=text_of("page.js"))


def embedded(plot: Any, when_ready: CustomJS) -> tuple[str, str]:
    """The scripts of a page, and the element of its plot.

    - when_ready: runs when it is drawn.

    Nothing is loaded: Bokeh's own script is in the page.
    """
    document = Document()
    document.add_root(plot)
    document.js_on_event(DocumentReady, when_ready)
    script, element = components(plot)
    bokeh = Resources(mode="inline", components=["bokeh"]).render_js()
    return f"{bokeh}\n{script}", element


def text_of(name: str) -> str:
    """The text of a file beside this one."""
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")

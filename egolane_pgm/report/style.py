"""Parts that the figures share: the answers of a result, colours that colour-blind readers can tell
apart, labels, and saving."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib import style as matplotlib_style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap, to_hex, to_rgb
from matplotlib.figure import Figure

from egolane_pgm.files import atomic
from egolane_pgm.results import Result
from egolane_pgm.types import UNASSIGNED, BoolArray, FloatArray, InputError, IntArray

#: Extensions of the figures that can be written.
FORMATS = (".png", ".svg", ".pdf")

INK, FAINT, CROSSING = "#222222", "#b8b8b8", "#8c8c8c"

#: The colours of detector and model where a figure shows both: Okabe and Ito's vermillion and blue.
DETECTOR_COLOUR, MODEL_COLOUR = "#d55e00", "#0072b2"

#: Colour, marker and line style of detector and model.
ANSWER_STYLE = {"Detector only": (DETECTOR_COLOUR, "s", "--"), "Model": (MODEL_COLOUR, "o", "-")}

#: From white to dark blue. The lightness falls all the way, so that a print in grey shows it too.
PROBABILITY_COLOURS = ("#ffffff", "#bcd7ec", "#5fa5d6", "#0072b2", "#00355c")

#: Right answers are blue; the further off an answer, the darker its orange-brown. All common kinds
#: of colour blindness keep the contrast between blue and orange.
RIGHT_COLOUR, UNASSIGNED_COLOUR = "#0072b2", "#1a1a1a"
_OFF_COLOURS = ("#fee391", "#ec8a1e", "#8c2d04")

_METADATA: dict[str, dict[str, Any]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}


def off_colours(n: int) -> list[str]:
    """Colours for answers that are off by 1 to n lanes, from pale to dark."""
    if n <= len(_OFF_COLOURS):
        return list(_OFF_COLOURS[:n])
    ramp = LinearSegmentedColormap.from_list("off", _OFF_COLOURS)
    return [to_hex(ramp(k / (n - 1))) for k in range(n)]


def text_colour(background: Any) -> str:
    """Black or white, whichever is easier to read on the background."""
    linear = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in to_rgb(background)
    ]
    luminance = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    # Equal contrast ratios (WCAG 2) against black and white meet at this luminance.
    return "black" if luminance > 0.179 else "white"


def title_of(result: Result) -> str:
    """The run's name, marked where its parameters were tuned on the frames that are scored."""
    mark = " (in-sample)" if result.run.get("tuned_on") == "same_frames" else ""
    return f"{result.run['name']}{mark}"


def title_with_frames(result: Result) -> str:
    """A title with the number of scored frames. Raises InputError if there are none."""
    return f"{title_of(result)}: {int(is_scored(result).sum()):,} frames"


def is_scored(result: Result) -> BoolArray:
    """Which frames, (T,), are annotated and not crossing. Raises InputError if there are none."""
    scored: BoolArray = (result.true_lane != UNASSIGNED) & ~result.is_crossing
    if not scored.any():
        raise InputError(
            f"{result.directory}: has no ground truth to compare with (no annotated frame that is"
            " not crossing); run the experiment with a ground_truth"
        )
    return scored


def answers(result: Result) -> dict[str, tuple[FloatArray, IntArray]]:
    """The belief (T, n) and the assigned lane (T,) of "Detector only" and "Model". The detector is
    absent without a tentative vector."""
    both = {}
    if result.tentative is not None and result.detector_lane is not None:
        both["Detector only"] = (result.tentative, result.detector_lane)
    both["Model"] = (result.marginals["Lane"], result.assigned_lane)
    return both


def scored_answers(
    result: Result,
) -> dict[str, tuple[FloatArray, IntArray, IntArray, BoolArray]]:
    """As `answers`, over the scored frames only: belief, assigned lane, true lane and crossing of
    each. Raises InputError if there are none."""
    chosen = is_scored(result)
    truth = result.true_lane[chosen], result.is_crossing[chosen]
    return {
        name: (belief[chosen], assigned[chosen], *truth)
        for name, (belief, assigned) in answers(result).items()
    }


def check_figure_path(path: str | Path) -> Path:
    """The path of a figure. Raises InputError for an extension that is not in `FORMATS`."""
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"{path}: a figure ends in {', '.join(FORMATS)}")
    return path


def write_figure(make: Callable[[], Figure], path: str | Path) -> Path:
    """Draws a figure and writes it; the same figure gives the same bytes.

    - make: makes the figure. It is called with matplotlib's default style, whatever the user's
      matplotlibrc says.
    - path: a PNG, SVG or PDF file, by its extension; its folder is made

    Raises InputError for another extension and for a file that cannot be written.
    """
    path = check_figure_path(path)
    extension = path.suffix.lower()
    with _own_style():
        figure = make()
        with atomic(path, make_folder=True) as temporary:
            figure.savefig(
                temporary,
                format=extension[1:],
                dpi=200,
                facecolor="white",
                metadata=_METADATA[extension],
            )
    return path


def inline_figure(make: Callable[[], Figure]) -> Figure:
    """Draws a figure for a notebook, which shows it where it is the last value of a cell.

    - make: makes the figure, as in `write_figure`. pyplot does not know the figure.
    """
    with _own_style():
        figure = make()
    # A notebook draws figures only once pyplot was used, unless it is told.
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if shell is not None and Figure not in shell.display_formatter.formatters["image/png"]:
        from IPython.core.pylabtools import select_figure_formats

        select_figure_formats(shell, {"png"})  # type: ignore[no-untyped-call]
    return figure


@contextlib.contextmanager
def _own_style() -> Iterator[None]:
    """Matplotlib's default style, whatever the user's matplotlibrc says."""
    # Publishers ask for fonts of type 42. The salt fixes the ids in an SVG.
    settings: dict[Any, Any] = {
        "hatch.linewidth": 0.5,
        "pdf.fonttype": 42,
        "svg.hashsalt": "egolane",
    }
    with matplotlib_style.context("default", after_reset=True), rc_context(settings):
        yield


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of that size, inches, on its own canvas, without pyplot's global state."""
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    return figure


def axes_at(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Adds axes, placed in inches from the top left corner of the figure."""
    across, down = (float(x) for x in figure.get_size_inches())
    ax: Axes = figure.add_axes(
        (left / across, 1 - (top + height) / down, width / across, height / down)
    )
    return ax


def put_title(figure: Figure, text: str, left: float = 0.12, size: float = 11) -> None:
    """Adds a title, `left` inches from the left edge, in smaller type if it is long."""
    across, down = (float(x) for x in figure.get_size_inches())
    # A letter of the default font is about 0.6 times as wide as its size.
    fitting = (across - left - 0.12) * 72 / (0.6 * max(len(text), 1))
    figure.text(
        left / across, 1 - 0.1 / down, text, fontsize=min(size, fitting), va="top", color=INK
    )


def lane_names(n_lanes: int) -> list[str]:
    """Names for axes that tell the order of the lanes: "lane 1 (leftmost)", "lane 2", ..."""
    return [f"lane {k}{' (leftmost)' if k == 1 else ''}" for k in range(1, n_lanes + 1)]


def percent(share: float) -> str:
    """A share as a percentage, with one decimal; without for exactly 0 and 1."""
    value = 100 * float(share)
    if 0 < value < 0.05:
        return "<0.1"
    if 99.95 <= value < 100:
        return ">99.9"
    return f"{value:.0f}" if value in (0.0, 100.0) else f"{value:.1f}"

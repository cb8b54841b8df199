"""What the figures share: colours that colour-blind readers can tell apart, labels, saving."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from egolane_pgm.files import atomic
from egolane_pgm.results import Result
from egolane_pgm.types import UNASSIGNED, BoolArray, FloatArray, InputError, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")

INK, FAINT, CROSSING = "#222222", "#b8b8b8", "#8c8c8c"

#: Detector and model wherever they share one pair of axes: Okabe and Ito's vermillion and blue.
DETECTOR_COLOUR, MODEL_COLOUR = "#d55e00", "#0072b2"

#: Colour, marker and line of who gives an answer.
ANSWER_STYLE = {"Detector only": (DETECTOR_COLOUR, "s", "--"), "Model": (MODEL_COLOUR, "o", "-")}

#: White to dark blue: lightness falls all the way, so it survives greyscale printing.
PROBABILITY_COLOURS = ("#ffffff", "#bcd7ec", "#5fa5d6", "#0072b2", "#00355c")

#: Right is blue; the further off, the darker an orange-brown. Blue against orange is the contrast
#: that all common kinds of colour blindness keep.
RIGHT_COLOUR, UNASSIGNED_COLOUR = "#0072b2", "#1a1a1a"
_OFF_COLOURS = ("#fee391", "#ec8a1e", "#8c2d04")

_METADATA: dict[str, dict[str, Any]] = {
    ".png": {"Software": None},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}


def off_colours(n: int) -> list[str]:
    """Colours for off by 1..n lanes, from pale to dark."""
    from matplotlib.colors import LinearSegmentedColormap, to_hex

    if n <= len(_OFF_COLOURS):
        return list(_OFF_COLOURS[:n])
    ramp = LinearSegmentedColormap.from_list("off", _OFF_COLOURS)
    return [to_hex(ramp(k / (n - 1))) for k in range(n)]


def text_colour(background: Any) -> str:
    """Black or white, whichever is read more easily on the colour."""
    from matplotlib.colors import to_rgb

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


def series(result: Result) -> str:
    """A title with the number of frames that are scored, which must exist (`is_scored`)."""
    return f"{title_of(result)}: {int(is_scored(result).sum()):,} frames"


def is_scored(result: Result) -> BoolArray:
    """(T,): the annotated frames that are not crossing.

    Raises InputError where there is none: whoever asks needs ground truth.
    """
    scored: BoolArray = (result.true_lane != UNASSIGNED) & ~result.is_crossing
    if not scored.any():
        raise InputError(
            f"{result.directory}: has no ground truth to compare with (no annotated frame that is"
            " not crossing); run the experiment with a ground_truth"
        )
    return scored


def answers(result: Result) -> dict[str, tuple[FloatArray, IntArray]]:
    """Who answers: "Detector only" (absent without a tentative vector) and "Model", each with its
    belief (T, n) and its assigned lane (T,)."""
    both = {}
    if result.tentative is not None and result.detector_lane is not None:
        both["Detector only"] = (result.tentative, result.detector_lane)
    both["Model"] = (result.marginals["Lane"], result.assigned_lane)
    return both


def check_figure_path(path: str | Path) -> Path:
    """The path of a figure; InputError where its extension is not one that can be drawn."""
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"{path}: a figure ends in {', '.join(FORMATS)}")
    return path


@contextlib.contextmanager
def plain_style() -> Iterator[None]:
    """matplotlib as it comes, whatever the user's matplotlibrc says, restored afterwards."""
    from matplotlib import rc_context, style

    with style.context("default", after_reset=True), rc_context({"hatch.linewidth": 0.5}):
        yield


def save(figure: Figure, path: Path) -> Path:
    """Write the figure: the whole file or none, the same bytes for the same figure.

    Raises InputError where it cannot be written.
    """
    from matplotlib import rc_context

    extension = path.suffix.lower()
    # Type 42 is what publishers ask for; the salt fixes the ids in an SVG.
    with (
        atomic(path, make_folder=True) as temporary,
        rc_context({"pdf.fonttype": 42, "svg.hashsalt": "egolane"}),
    ):
        figure.savefig(
            temporary,
            format=extension[1:],
            dpi=200,
            facecolor="white",
            metadata=_METADATA[extension],
        )
    return path


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of that size, inches, on its own canvas (no pyplot, no global state)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    return figure


def axes_at(figure: Figure, left: float, top: float, width: float, height: float) -> Axes:
    """Axes placed in inches from the figure's top left corner."""
    across, down = (float(x) for x in figure.get_size_inches())
    ax: Axes = figure.add_axes(
        (left / across, 1 - (top + height) / down, width / across, height / down)
    )
    return ax


def put_title(figure: Figure, text: str, left: float = 0.12, size: float = 11) -> None:
    """The figure's title, `left` inches from its left edge, in smaller type where it is long."""
    across, down = (float(x) for x in figure.get_size_inches())
    # A letter of the default font is about 0.6 of the type size wide.
    fitting = (across - left - 0.12) * 72 / (0.6 * max(len(text), 1))
    figure.text(
        left / across, 1 - 0.1 / down, text, fontsize=min(size, fitting), va="top", color=INK
    )


def lane_names(n_lanes: int) -> list[str]:
    """ "lane 1 (leftmost)", "lane 2", ...: for axes, so that nobody has to guess the order."""
    return [f"lane {k}{' (leftmost)' if k == 1 else ''}" for k in range(1, n_lanes + 1)]


def percent(share: float) -> str:
    """A share as a percentage: one decimal, or none at 0 and 1."""
    value = 100 * float(share)
    if 0 < value < 0.05:
        return "<0.1"
    if 99.95 <= value < 100:
        return ">99.9"
    return f"{value:.0f}" if value in (0.0, 100.0) else f"{value:.1f}"

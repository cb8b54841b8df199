"""One Matplotlib style: colours for colour-blind readers, type sizes, and the writing of figures.

Figures are made without pyplot: no global state changes, and no window opens.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from matplotlib import style as matplotlib_style
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap, to_rgb
from matplotlib.figure import Figure

from egolane_pgm.tools.files import make_directory, write_bytes
from egolane_pgm.tools.progress import ipython
from egolane_pgm.types import InputError

#: Text and axes.
INK = "#222222"

#: Lines of reference.
FAINT = "#b8b8b8"

#: Grids, and frames without an answer.
GRID = "#ececec"

#: Crossing frames.
CROSSING = "#8c8c8c"

#: Okabe and Ito's vermillion; all common kinds of colour blindness keep it apart from their blue.
DETECTOR_COLOUR = "#d55e00"

#: Okabe and Ito's blue.
MODEL_COLOUR = "#0072b2"

#: Frames that are Unassigned.
UNASSIGNED_COLOUR = "#1a1a1a"

#: Colours of reported lane changes by outcome.
OUTCOMES = {"correct": MODEL_COLOUR, "false": DETECTOR_COLOUR, "not annotated": CROSSING}

#: Colour, marker and line style of the detector's and the model's answers.
ANSWER_STYLE = {
    "Detector": (DETECTOR_COLOUR, "s", (0, (4, 2))),
    "Model": (MODEL_COLOUR, "o", "-"),
}

#: White to dark blue; the lightness only falls, so that a grey print shows it too.
PROBABILITY_COLOURS = ("#ffffff", "#bcd7ec", "#5fa5d6", "#0072b2", "#00355c")
PROBABILITY_RAMP = LinearSegmentedColormap.from_list("probability", PROBABILITY_COLOURS)

#: Pale to dark orange: answers that are off by more and more lanes.
ERROR_RAMP = LinearSegmentedColormap.from_list("errors", ("#fee391", "#ec8a1e", "#8c2d04"))

#: Extensions of figures, with the metadata that gives equal bytes to equal figures.
FORMATS: dict[str, dict[str, Any]] = {
    ".png": {"metadata": {"Software": None}, "pil_kwargs": {"compress_level": 3}},
    ".svg": {"metadata": {"Date": None}},
    ".pdf": {"metadata": {"CreationDate": None}},
}

_RC: dict[Any, Any] = {
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.edgecolor": INK,
    "text.color": INK,
    "legend.frameon": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "text.parse_math": False,  # A name with two dollars is a name.
    "hatch.linewidth": 0.4,
    "savefig.dpi": 200,
    "pdf.fonttype": 42,  # Publishers ask for these fonts.
    "svg.hashsalt": "egolane",
}


@contextlib.contextmanager
def own_style() -> Iterator[None]:
    """Use this style, independent of the user's matplotlibrc."""
    with matplotlib_style.context(["default", _RC], after_reset=True):
        yield


def new_figure(width: float, height: float, title: str = "", layout: Any = "constrained") -> Figure:
    """Return an empty figure of this size in inches, with its title at the left."""
    figure = Figure(figsize=(width, height), layout=layout)
    FigureCanvasAgg(figure)
    # A letter of the default font is about 0.6 times as wide as its size.
    size = min(10, (width - 0.2) * 72 / (0.6 * max(len(title), 1)))
    if title:
        figure.suptitle(title, x=0.01, ha="left", fontsize=size)
    return figure


def text_colour(background: Any) -> str:
    """Return black or white, the one with the higher contrast (WCAG 2) on the background."""
    red, green, blue = (c**2.2 for c in to_rgb(background))
    return "black" if 0.2126 * red + 0.7152 * green + 0.0722 * blue > 0.179 else "white"


def write_figure(make: Callable[[], Figure], path: str | Path) -> Path:
    """Draw a figure and write it as PNG, SVG or PDF; equal figures give equal bytes.

    - make: makes the figure; called in `own_style`.
    - path: its folder is made.

    Raises InputError for another extension and for a file that cannot be written.
    """
    path = Path(path)
    extension = path.suffix.lower()
    if extension not in FORMATS:
        raise InputError(f"{path}: unknown format; a figure ends in {', '.join(FORMATS)}")
    content = io.BytesIO()
    with own_style():
        make().savefig(content, format=extension[1:], **FORMATS[extension])
    write_bytes(path, content.getvalue())
    return path


def write_figures(
    makes: Mapping[str, Callable[[], Figure]], folder: Path, style: str
) -> list[Path]:
    """Write figures, by name, into a folder, which is made. style: png, pdf or svg."""
    make_directory(folder)
    return [write_figure(make, folder / f"{name}.{style}") for name, make in makes.items()]


def inline_figure(make: Callable[[], Figure]) -> Figure:
    """Draw a figure for a notebook, which shows it as the last value of a cell."""
    with own_style():
        figure = make()
    # A notebook draws figures only once pyplot was used, unless this formatter is set.
    shell = ipython()
    if shell is not None and Figure not in shell.display_formatter.formatters["image/png"]:
        from IPython.core.pylabtools import select_figure_formats

        select_figure_formats(shell, {"png"})  # type: ignore[no-untyped-call]
    return figure

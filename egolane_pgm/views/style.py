"""Parts that the figures share: styles, layout and saving."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib import style as matplotlib_style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap, to_hex, to_rgb
from matplotlib.figure import Figure

from egolane_pgm.tools.files import make_directory, write_bytes
from egolane_pgm.tools.progress import ipython
from egolane_pgm.types import InputError
from egolane_pgm.views.answers import DETECTOR_COLOUR, INK, MODEL_COLOUR, PROBABILITY_COLOURS

#: Extensions of the figures that can be written.
FORMATS = (".png", ".svg", ".pdf")

#: From the probability 0 to 1.
PROBABILITY_RAMP = LinearSegmentedColormap.from_list("probability", PROBABILITY_COLOURS)

#: Colour, marker and line style of detector and model.
ANSWER_STYLE = {"Detector only": (DETECTOR_COLOUR, "s", "--"), "Model": (MODEL_COLOUR, "o", "-")}

#: The colours of `off_colours`.
_OFF_COLOURS = ("#fee391", "#ec8a1e", "#8c2d04")

#: How each kind of figure is written. A sheet of strips is a tenth larger at this level, and
#: compressed in two thirds of the time.
_WRITTEN: dict[str, dict[str, Any]] = {
    ".png": {"metadata": {"Software": None}, "pil_kwargs": {"compress_level": 3}},
    ".svg": {"metadata": {"Date": None}},
    ".pdf": {"metadata": {"CreationDate": None}},
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
    write_bytes(path, figure_bytes(make, path.suffix.lower()), make_folder=True)
    return path


def write_figures(
    makes: Mapping[str, Callable[[], Figure]], folder: Path, style: str
) -> list[Path]:
    """Writes figures by their names into a folder, which is made. Returns the files.

    - style: png, pdf or svg
    """
    make_directory(folder)
    return [write_figure(make, folder / f"{name}.{style}") for name, make in makes.items()]


def figure_bytes(make: Callable[[], Figure], extension: str) -> bytes:
    """The content of the file that `write_figure` writes, with one of `FORMATS`."""
    content = io.BytesIO()
    with _own_style():
        make().savefig(
            content, format=extension[1:], dpi=200, facecolor="white", **_WRITTEN[extension]
        )
    return content.getvalue()


def inline_figure(make: Callable[[], Figure]) -> Figure:
    """Draws a figure for a notebook, which shows it where it is the last value of a cell.

    - make: makes the figure, as in `write_figure`. pyplot does not know the figure.
    """
    with _own_style():
        figure = make()
    # A notebook draws figures only once pyplot was used, unless this formatter is set.
    shell = ipython()
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
        left / across, 1 - 0.1 / down, text, fontsize=min(size, fitting), va="top", color=INK,
        parse_math=False,  # A name with two dollars is a name.
    )  # fmt: skip

"""The verb `report`."""

from __future__ import annotations

import warnings
import webbrowser
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from egolane_pgm.results import Result, is_result, read_result
from egolane_pgm.tools.files import check_place
from egolane_pgm.types import InputError
from egolane_pgm.verbs.given import Option, StrPath, several_of
from egolane_pgm.views.study_trials import is_study

EXAMPLES = (
    "egolane report results/quickstart",
    "egolane report results/quickstart results/hard -o both.html",
)

#: The page of a result, in its directory; of several, in the current folder.
PAGE = "report.html"


def report(
    results: Annotated[StrPath | Sequence[StrPath], Option(many=True)],
    *,
    out: Annotated[StrPath | None, Option("FILE.html", names=("-o",))] = None,
    is_opened: Annotated[bool, Option(names=("--open",))] = False,
) -> Path:
    """Write one HTML page of RESULT directories: an interactive timeline, scores, the worst
    stretches, lane changes, parameters and where the numbers come from.

    The page needs no network and no other file. Several results stand side by side on one time
    axis.

    - out: the page; by default report.html in the result's directory, of several here.
    - is_opened: show the page in the browser.

    Returns the page. Raises InputError, one line, for whatever does not fit.
    """
    # Its packages are an extra's, and `egolane report --help` needs none of them.
    from egolane_pgm.page.document import write_page

    places = [Path(path) for path in several_of(results)]
    file = Path(out or (places[0] / PAGE if len(places) == 1 else PAGE))
    if file.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"out: {file}: a page ends in .html")
    read = [_read(place) for place in places]
    check_place(file)
    for line in write_page(read, file):
        warnings.warn(line, UserWarning, stacklevel=2)
    if is_opened and not webbrowser.open(file.absolute().as_uri()):
        raise InputError(f"is_opened: no browser was found; open {file.absolute()} yourself")
    return file


def says(done: Path, given: Mapping[str, Any]) -> str:
    """The page, and how large it is."""
    return f"{done}: {done.stat().st_size / 1e6:.1f} MB"


def _read(place: Path) -> Result:
    """The result in a directory. Raises InputError for a study and for a folder of results, which
    says what to name instead."""
    if is_study(place):
        raise InputError(
            f"{place}: is a study of parameters, which `egolane plot` draws; run the experiment"
            " that it wrote and report on that result"
        )
    runs = sorted([*place.glob("*/run.json"), *place.glob("*/*/run.json")])
    if runs and not is_result(place):
        raise InputError(
            f"{place}: is a folder of {len(runs)} result(s); name those that you mean, e.g."
            f" {runs[0].parent}"
        )
    return read_result(place)

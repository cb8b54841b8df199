"""The verb `plot`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from egolane_pgm.checking import check as check_model
from egolane_pgm.checking import prediction_calibration
from egolane_pgm.comparing import open_results
from egolane_pgm.result import Result, is_result, load_result
from egolane_pgm.studies.study import is_study
from egolane_pgm.tools.files import check_place
from egolane_pgm.tools.options import Option, StrPath, several_of
from egolane_pgm.types import InputError, printable
from egolane_pgm.views.checks import check_figure, check_text
from egolane_pgm.views.figures import (
    confusion_figure,
    dispersion_figure,
    reliability_figure,
)
from egolane_pgm.views.frames import title_of
from egolane_pgm.views.strips import result_strips
from egolane_pgm.views.studies import draw_study
from egolane_pgm.views.style import write_figures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EXAMPLES = (
    "egolane plot results/quickstart --frames 0 400 --style pdf",
    "egolane plot results/quickstart --check",
    "egolane plot results/quickstart results/hard --out both.html",
    "egolane plot results/drive --out drive.mp4",
    "egolane plot results/drive --out drive.mcap",
)

#: Extensions of --out that are one file instead of a folder of figures.
_FILES = (".html", ".mp4", ".mcap")


def plot(
    results: StrPath | Sequence[StrPath],
    *,
    frames: Annotated[tuple[int, int] | None, Option("FIRST LAST")] = None,
    out: Annotated[StrPath | None, Option("DIR|FILE")] = None,
    style: Literal["png", "pdf", "svg"] = "png",
    check: bool = False,
) -> list[Path]:
    """Draw result directories and studies; the extension of --out sets the format:

    \b
    a folder    figures; of several results also the dispersion of their errors
    .html       one page: timeline, scores, the worst segments, lane changes, parameters
    .mp4        a video: pictures, lines, bird's-eye view and posterior of one result
    .mcap       one result for Foxglove and PlotJuggler

    - results: directories that `run` and `tune` wrote, or folders of results.
    - frames: frame ids of the belief strips, of a video or of an MCAP file.
    - out: by default figures/ in the result.
    - style: format of the figures.
    - check: print and draw instead whether the model looks like the data.

    Returns the files. Raises InputError for directories and options that do not fit.
    """
    places = [Path(path) for path in several_of(results)]
    if frames and frames[0] > frames[1]:
        raise InputError(f"frames: {frames[0]} {frames[1]} is an empty range")
    is_file = out is not None and Path(out).suffix.lower() in _FILES and not Path(out).is_dir()
    if check and (is_file or frames or any(map(is_study, places))):
        raise InputError("check: goes with figures of results, without frames")
    if out is not None and is_file:
        return [_write_file(places, Path(out), frames)]
    studies = [place for place in places if is_study(place)]
    if frames and studies:
        raise InputError("frames: goes with results; the figures of a study have no frames")
    found = open_results(place for place in places if place not in studies)
    is_several = len(found) + len(studies) > 1

    def target(place: Path) -> Path:
        if out is None:
            return place / "figures"
        return Path(out) / place.name if is_several else Path(out)

    files = [file for place in studies for file in draw_study(place, target(place), style)]
    for result in found if check else ():
        makes = _checked(result)
        files += write_figures(makes, target(Path(str(result.directory))), style)
    for result in found if not check else ():
        makes = {"strips": partial(result_strips, result, *(frames or ()))}
        if result.scores["frames_scored"]:
            given = result.frames, title_of(result)
            makes["confusion"] = partial(confusion_figure, *given)
            makes["reliability"] = partial(reliability_figure, *given)
        files += write_figures(makes, target(Path(str(result.directory))), style)
    if len(found) > 1 and not check:
        folder = places[0].parent if is_result(places[0]) else places[0]
        titled = [(title_of(result), result.frames) for result in found]
        together = {"dispersion": partial(dispersion_figure, titled)}
        files += write_figures(together, Path(out or folder), style)
    return files


def _checked(result: Result) -> dict[str, Callable[[], Figure]]:
    """Print the checks of a result; return their figure. Raises InputError if they would execute
    a program of the result."""
    e = result.experiment
    cure = f"ego.check(ego.load_result('{result.directory}'))"
    _check_no_program("check", (e.evidence, e.graph_name), cure)
    found = (check_model(result), prediction_calibration(result))
    title = title_of(result)
    print(printable(check_text(result, *found)), end="\n\n")
    return {"check": partial(check_figure, *found, title)}


def _check_no_program(option: str, plugins: Sequence[str | None], cure: str) -> None:
    """Raise InputError for a plugin that is a program. cure: the same in Python."""
    for plugin in plugins:
        if plugin is not None and plugin.endswith(".py"):
            raise InputError(
                f"{option}: {plugin} is a program, which plot does not execute; if you trust it,"
                f" in Python: {cure}"
            )


def _write_file(places: Sequence[Path], file: Path, frames: tuple[int, int] | None) -> Path:
    """Write a page, a video or an MCAP file. Their packages are extras, imported here."""
    check_place(file)
    if file.suffix.lower() == ".html":
        from egolane_pgm.page.document import write_page

        if frames:
            raise InputError("frames: does not go with a page, which shows all frames")
        write_page([load_result(place) for place in places], file)
        return file
    if len(places) > 1:
        raise InputError(f"out: {file}: shows one result; {len(places)} are named")
    write: Callable[..., Any]
    if file.suffix.lower() == ".mcap":
        from egolane_pgm.export.mcap_file import write_mcap as write
    else:
        from egolane_pgm.export.video_file import write_video as write
    result = load_result(places[0])
    if file.suffix.lower() == ".mp4":
        cure = "egolane_pgm.export.video_file.write_video, see docs/howto/detector.md"
        _check_no_program("out", [result.experiment.recording.detector], cure)
    write(file, result, frames)
    return file


def summary(done: list[Path], given: Mapping[str, Any]) -> str:
    """The files."""
    return "\n".join(map(str, done))

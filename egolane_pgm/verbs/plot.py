"""The verb `plot`."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from egolane_pgm.results import Result, is_result, read_result
from egolane_pgm.tools.files import check_place
from egolane_pgm.types import InputError
from egolane_pgm.verbs.given import Option, StrPath, several_of
from egolane_pgm.views.coverage import coverage_figure
from egolane_pgm.views.dispersion import bonus_ablation_figure, dispersion_figure
from egolane_pgm.views.heatmaps import confusion_figure
from egolane_pgm.views.reliability import reliability_figure
from egolane_pgm.views.strips import strips_figure
from egolane_pgm.views.study_figures import draw_study
from egolane_pgm.views.study_trials import is_study
from egolane_pgm.views.style import write_figures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EXAMPLES = (
    "egolane plot results/quickstart --frames 0 400 --style pdf",
    "egolane plot results/quickstart results/hard --out both.html",
    "egolane plot results/drive --out drive.mp4",
    "egolane plot results/drive --out drive.mcap",
)

#: Endings of --out that are one file instead of a folder of figures.
_FILES = (".html", ".mp4", ".mcap")


def plot(
    results: Annotated[StrPath | Sequence[StrPath], Option(many=True)],
    *,
    frames: Annotated[tuple[int, int] | None, Option("FIRST LAST")] = None,
    out: Annotated[StrPath | None, Option("DIR|FILE")] = None,
    style: Literal["png", "pdf", "svg"] = "png",
) -> list[Path]:
    """Draw result directories, and those that `egolane tune` writes, as the ending of --out says:

    \b
    a folder    figures; of several results also the dispersion of their errors
    .html       one page: timeline, scores, the worst stretches, lane changes, parameters
    .mp4        a video: pictures, lines, bird's-eye view and belief of one result
    .mcap       one result for Foxglove and PlotJuggler

    - frames: frame ids of the belief strips, of a video or of an MCAP file.
    - out: by default figures/ in the result.
    - style: of the figures.

    Returns the files. Raises InputError, one line, for whatever does not fit.
    """
    folders = [Path(path) for path in several_of(results)]
    if frames and frames[0] > frames[1]:
        raise InputError(f"frames: {frames[0]} {frames[1]} is an empty range")
    if out is not None and Path(out).suffix.lower() in _FILES and not Path(out).is_dir():
        return [_file(folders, Path(out), frames)]
    drives = [folder for folder in folders if not is_study(folder)]
    if frames and len(drives) < len(folders):
        raise InputError("frames: goes with results; the figures of a study have no frames")
    files = []
    for folder in folders:
        target = folder / "figures" if out is None else Path(out)
        if out is not None and len(folders) > 1:
            target /= folder.name
        if folder in drives:
            figures = _figures(read_result(folder), frames or (None, None))
            files += write_figures(figures, target, style)
        else:
            files += draw_study(folder, target, style=style)
    if len(drives) > 1:
        figures = _figures_together([read_result(folder) for folder in drives])
        files += write_figures(figures, Path(out or drives[0].parent), style)
    return files


def _file(folders: Sequence[Path], file: Path, frames: tuple[int, int] | None) -> Path:
    """Write a page, a video or an MCAP file."""
    check_place(file)
    ending = file.suffix.lower()
    if ending == ".html":
        # Its packages are an extra's, and `egolane plot --help` needs none of them.
        from egolane_pgm.page.document import write_page

        if frames:
            raise InputError("frames: does not go with a page, which shows all frames")
        for line in write_page([_read(folder) for folder in folders], file):
            warnings.warn(line, UserWarning, stacklevel=3)
        return file
    if len(folders) > 1:
        raise InputError(f"out: {file}: shows one result; {len(folders)} are named")
    from egolane_pgm.export.drive import open_drive

    if ending == ".mcap":
        from egolane_pgm.export.mcap_file import write_mcap

        write_mcap(file, open_drive(folders[0], frames))
    else:
        from egolane_pgm.export.video_file import write_video

        write_video(file, open_drive(folders[0], frames))
    return file


def _read(place: Path) -> Result:
    """The result in a directory. Raises InputError for a study and for a folder of results, which
    says what to name instead."""
    if is_study(place):
        raise InputError(
            f"{place}: is a study of parameters; run the experiment that it wrote, and name that"
            " result"
        )
    runs = sorted([*place.glob("*/run.json"), *place.glob("*/*/run.json")])
    if runs and not is_result(place):
        raise InputError(
            f"{place}: is a folder of {len(runs)} result(s); name those that you mean, e.g."
            f" {runs[0].parent}"
        )
    return read_result(place)


def _figures(
    result: Result, frames: tuple[int | None, int | None]
) -> dict[str, Callable[[], Figure]]:
    """The strips of a result and, with ground truth, its confusion matrices, reliability diagram
    and accuracy-coverage curves, by name.

    - frames: first and last frame id of the strips.
    """
    makes: dict[str, Callable[[], Figure]] = {"strips": lambda: strips_figure(result, *frames)}
    if result.run["frames_scored"]:
        makes["confusion"] = lambda: confusion_figure(result)
        makes["reliability"] = lambda: reliability_figure(result)
        makes["coverage"] = lambda: coverage_figure(result)
    return makes


def _figures_together(results: Sequence[Result]) -> dict[str, Callable[[], Figure]]:
    """The error dispersion of several results in one figure and, for two results of which the
    second has no bonus value, the ablation."""
    makes: dict[str, Callable[[], Figure]] = {"dispersion": lambda: dispersion_figure(results)}
    if len(results) == 2:
        bonus = [result.config["parameters"].get("bonus_value") for result in results]
        if bonus[0] and bonus[1] == 0:
            makes["bonus_ablation"] = lambda: bonus_ablation_figure(*results)
    return makes


def says(done: list[Path], given: Mapping[str, Any]) -> str:
    """The files."""
    return "\n".join(map(str, done))

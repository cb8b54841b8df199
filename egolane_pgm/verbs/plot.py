"""The verb `plot`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from egolane_pgm.results import Result, read_result
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

EXAMPLES = ("egolane plot results/quickstart --frames 0 400 --style pdf",)


def plot(
    results: Annotated[StrPath | Sequence[StrPath], Option(many=True)],
    *,
    frames: Annotated[tuple[int, int] | None, Option("FIRST LAST")] = None,
    out: Annotated[StrPath | None, Option("DIRECTORY")] = None,
    style: Literal["png", "pdf", "svg"] = "png",
) -> list[Path]:
    """Draw the figures of result directories, and of those that `egolane tune` leaves; several
    results together make one dispersion sheet.

    - frames: frame ids of the belief strips.
    - out: their folder, figures/ in the result by default.
    - style: of the files.

    Returns the files. Raises InputError, one line, for whatever does not fit.
    """
    folders = [Path(path) for path in several_of(results)]
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

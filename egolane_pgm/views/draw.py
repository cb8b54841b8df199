"""Draws the figures of a result directory, and those of several results together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from egolane_pgm.results import Result, read_result
from egolane_pgm.tools.files import make_directory
from egolane_pgm.views.coverage import coverage_figure
from egolane_pgm.views.dispersion import bonus_ablation_figure, dispersion_figure
from egolane_pgm.views.heatmaps import confusion_figure
from egolane_pgm.views.reliability import reliability_figure
from egolane_pgm.views.strips import strips_figure
from egolane_pgm.views.style import write_figure


def draw_standard(
    result: Result,
    folder: Path,
    *,
    frames: tuple[int, int] | None = None,
    style: str = "png",
) -> list[Path]:
    """Draws the strips of a result and, with ground truth, its confusion matrices, reliability
    diagram and accuracy-coverage curves.

    - folder: of the figures
    - frames: first and last frame id of the strips; all by default
    - style: png, pdf or svg

    Returns the files written.
    """
    make_directory(folder)
    first, last = frames or (None, None)
    makes: dict[str, Callable[[], Figure]] = {"strips": lambda: strips_figure(result, first, last)}
    if result.run["frames_scored"]:
        makes["confusion"] = lambda: confusion_figure(result)
        makes["reliability"] = lambda: reliability_figure(result)
        makes["coverage"] = lambda: coverage_figure(result)
    return [write_figure(make, folder / f"{name}.{style}") for name, make in makes.items()]


def draw_together(directories: Sequence[Path], target: Path, *, style: str = "png") -> list[Path]:
    """Draws the error dispersion of several results in one figure and, for two results of which the
    second has no bonus value, the ablation. Returns the files written."""
    results = [read_result(directory) for directory in directories]
    make_directory(target)
    files = [write_figure(lambda: dispersion_figure(results), target / f"dispersion.{style}")]
    if len(results) == 2:
        bonus = [result.config["parameters"].get("bonus_value") for result in results]
        if bonus[0] and bonus[1] == 0:
            path = target / f"bonus_ablation.{style}"
            files.append(write_figure(lambda: bonus_ablation_figure(*results), path))
    return files

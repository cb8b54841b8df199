"""Draws the figures of a result directory, and those of several results together."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from egolane_pgm.report.coverage import draw_coverage
from egolane_pgm.report.dispersion import draw_bonus_ablation, draw_dispersion
from egolane_pgm.report.heatmaps import draw_confusion
from egolane_pgm.report.reliability import draw_reliability
from egolane_pgm.report.strips import draw_strips
from egolane_pgm.results import Result, read_result
from egolane_pgm.tools.files import make_directory


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
    files = [folder / f"strips.{style}"]
    draw_strips(result, files[0], first=first, last=last)
    if result.run["frames_scored"]:
        files += [folder / f"confusion.{style}", folder / f"reliability.{style}"]
        draw_confusion(result, files[1])
        draw_reliability(result, files[2])
        files.append(folder / f"coverage.{style}")
        draw_coverage(result, files[3])
    return files


def draw_together(directories: Sequence[Path], target: Path, *, style: str = "png") -> list[Path]:
    """Draws the error dispersion of several results in one figure and, for two results of which the
    second has no bonus value, the ablation. Returns the files written."""
    results = [read_result(directory) for directory in directories]
    make_directory(target)
    files = [target / f"dispersion.{style}"]
    draw_dispersion(results, files[0])
    if len(results) == 2:
        bonus = [result.config["parameters"].get("bonus_value") for result in results]
        if bonus[0] and bonus[1] == 0:
            files.append(target / f"bonus_ablation.{style}")
            draw_bonus_ablation(results[0], results[1], files[-1])
    return files

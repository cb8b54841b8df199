"""The figures that belong to a result directory, and those of several together."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from egolane_pgm.files import make_directory
from egolane_pgm.report.comparison import draw_comparison
from egolane_pgm.report.coverage import draw_coverage
from egolane_pgm.report.dispersion import draw_bonus_ablation, draw_dispersion
from egolane_pgm.report.heatmaps import draw_confusion
from egolane_pgm.report.reliability import draw_reliability
from egolane_pgm.report.strips import draw_strips
from egolane_pgm.results import read_result


def draw_standard(
    directory: Path,
    target: Path | None = None,
    *,
    frames: tuple[int, int] | None = None,
    style: str = "png",
) -> list[Path]:
    """The strips of a result (of `frames`, first and last frame id) and, with ground truth, its
    confusion matrices, reliability diagram and accuracy-coverage curves. target: default
    `figures/` in the directory.

    style: png, pdf or svg. Returns the files written.
    """
    result = read_result(directory)
    folder = target or directory / "figures"
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
    """Several results on one sheet: how far off the detector and the model are in each, and, for
    two results that differ in the bonus value alone, the ablation. Returns the files written."""
    results = [read_result(directory) for directory in directories]
    make_directory(target)
    files = [target / f"dispersion.{style}"]
    draw_dispersion(results, files[0])
    if len(results) == 2:
        bonus = [result.experiment["parameters"].get("bonus_value") for result in results]
        if bonus[0] and bonus[1] == 0:
            files.append(target / f"bonus_ablation.{style}")
            draw_bonus_ablation(results[0], results[1], files[-1])
    return files


__all__ = [
    "draw_bonus_ablation",
    "draw_comparison",
    "draw_confusion",
    "draw_coverage",
    "draw_dispersion",
    "draw_reliability",
    "draw_strips",
]

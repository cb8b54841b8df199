"""The verb `plot`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from egolane_pgm.results import read_result
from egolane_pgm.types import InputError
from egolane_pgm.verbs.given import Option, StrPath, several_of
from egolane_pgm.views.draw import draw_standard, draw_together
from egolane_pgm.views.study_figures import draw_study
from egolane_pgm.views.study_trials import is_study

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
            files += draw_standard(read_result(folder), target, frames=frames, style=style)
        else:
            files += draw_study(folder, target, style=style)
    if len(drives) > 1:
        files += draw_together(drives, Path(out or drives[0].parent), style=style)
    return files


def says(done: list[Path], given: Mapping[str, Any]) -> str:
    """The files."""
    return "\n".join(map(str, done))

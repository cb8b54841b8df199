"""The verb `export`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from egolane_pgm.export.drive import open_drive
from egolane_pgm.tools.files import check_place
from egolane_pgm.types import InputError
from egolane_pgm.verbs.given import Frames, Option, StrPath, check_frames

EXAMPLES = ("egolane export results/quickstart drive.mcap",)


def export(
    result: StrPath,
    target: StrPath,
    *,
    pictures: Annotated[
        str | None, Option("PICTURES", said="those that the result's detector saw")
    ] = None,
    frames: Frames = None,
) -> Mapping[str, int]:
    """Write a result as an MCAP file (TARGET, out.mcap) for Foxglove and PlotJuggler.

    Lines, the view from above, beliefs, answers, truth and pictures are on one clock.

    - pictures: a video, a folder or a 'glob*.jpg'.
    - frames: frame ids, STOP left out.

    Returns how many messages there are of each topic. Raises InputError, one line, for whatever
    does not fit.
    """
    file = Path(target)
    if file.suffix.lower() != ".mcap":
        raise InputError(f"{file}: unknown extension; take .mcap (Foxglove, PlotJuggler)")
    check_frames(frames)
    check_place(file)
    # Imported here: the writer needs the extra `export`.
    from egolane_pgm.export.mcap_file import write_mcap

    return write_mcap(file, open_drive(Path(result), pictures=pictures, frames=frames))


def says(done: Mapping[str, int], given: Mapping[str, Any]) -> str:
    """The file, and the number of messages of each topic."""
    said = ", ".join(f"{topic} {n}" for topic, n in sorted(done.items()))
    return f"{given['target']}: {said}"

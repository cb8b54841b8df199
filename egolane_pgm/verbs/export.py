"""The verb `export`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

from egolane_pgm.export.drive import open_drive
from egolane_pgm.export.layouts import LAYOUTS, write_layout
from egolane_pgm.tools.files import check_place
from egolane_pgm.types import InputError
from egolane_pgm.verbs.given import Frames, Option, StrPath, check_frames, several_of

EXAMPLES = (
    "egolane export results/quickstart drive.mcap --layout foxglove.json",
    "egolane export results/quickstart drive.rrd",
)

#: The module and the function that write a file, by its extension.
_WRITERS = {".mcap": ("mcap_file", "write_mcap"), ".rrd": ("rerun_file", "write_rrd")}


def export(
    result: StrPath,
    target: StrPath,
    *,
    pictures: Annotated[
        str | None, Option("PICTURES", said="those that the result's detector saw")
    ] = None,
    frames: Frames = None,
    layout: Annotated[StrPath | Sequence[StrPath], Option("FILE", many=True)] = (),
) -> Mapping[str, int]:
    """Write a result for a viewer: TARGET is out.mcap for Foxglove and PlotJuggler, or out.rrd for
    rerun.

    Lines, the view from above, beliefs, answers, truth and pictures are on one clock.

    - pictures: a video, a folder or a 'glob*.jpg'.
    - frames: frame ids, STOP left out.
    - layout: write a layout, too: .json of Foxglove, .xml of PlotJuggler.

    Returns how many messages there are of each topic. Raises InputError, one line, for whatever
    does not fit.
    """
    file, layouts = Path(target), [Path(each) for each in several_of(layout)]
    ending = file.suffix.lower()
    if ending not in _WRITERS:
        raise InputError(
            f"{file}: unknown extension; take .mcap (Foxglove, PlotJuggler), .rrd (rerun)"
        )
    for each in layouts:
        if each.suffix.lower() not in LAYOUTS:
            known = ", ".join(f"{known} ({program})" for known, program in LAYOUTS.items())
            raise InputError(f"layout: {each}: unknown extension; take {known}")
        if ending == ".rrd":
            raise InputError(f"layout: {each}: goes with .mcap; an .rrd has its layout in it")
    check_frames(frames)
    for each in (file, *layouts):
        check_place(each)
    module, name = _WRITERS[ending]
    write = getattr(import_module(f"egolane_pgm.export.{module}"), name)
    drive = open_drive(Path(result), pictures=pictures, frames=frames)
    counts: dict[str, int] = write(file, drive)
    for each in layouts:
        write_layout(each, drive)
    return counts


def says(done: Mapping[str, int], given: Mapping[str, Any]) -> str:
    """The files, and what is in the first."""
    said = ", ".join(f"{topic} {n}" for topic, n in sorted(done.items()))
    return "\n".join([f"{given['target']}: {said}", *several_of(given.get("layout"))])

"""The verb `lines`."""

from __future__ import annotations

from typing import Annotated

from egolane_pgm.drive import load_recording
from egolane_pgm.experiment import Overrides, load_experiment
from egolane_pgm.recordings import read_lines
from egolane_pgm.types import InputError
from egolane_pgm.verbs.given import Option, StrPath, path_of
from egolane_pgm.views.tables import box_text

EXAMPLES = ("egolane lines drive/lines.csv --frame 7",)


def lines(
    recording: StrPath,
    *,
    frame: int,
    camera: Annotated[StrPath | None, Option("FILE")] = None,
    overrides: Overrides = (),
) -> str:
    """The lines of one frame, laid out as in the paper's Box 1.

    RECORDING is a recording of lines, or the YAML of an experiment: then its own.

    - frame: the frame's id.
    - camera: the camera's YAML, for lines given in pixels.
    - overrides: override a key of the experiment.

    Raises InputError, one line, for whatever does not fit.
    """
    path = path_of(recording, "recording")
    if path.lower().endswith((".yaml", ".yml")):
        if camera is not None:
            raise InputError("camera: an experiment names its own, recording.camera")
        return box_text(load_recording(load_experiment(path, overrides)).log, frame)
    if overrides:
        raise InputError("overrides: go with an experiment")
    return box_text(read_lines(path, camera=camera), frame)

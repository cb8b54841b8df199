"""An experiment put on a recording, and which drives are held out together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from egolane_pgm.experiment import Experiment, Tuning, make_experiment
from egolane_pgm.fleet import FleetDrive
from egolane_pgm.recordings.source import files_in_full
from egolane_pgm.types import InputError, suggestion


def on_recording(model: Experiment, place: Experiment) -> Experiment:
    """Put the model of one experiment on the recording of another, with that one's frames, ground
    truth, number of lanes and untrusted labels (`tuning.never_fit`)."""
    content = model.model_dump()
    truth = place.ground_truth
    recording = place.recording.model_dump()
    if "frame_rate" not in place.recording.model_fields_set:
        # A video may have its own.
        del recording["frame_rate"]
    never_fit = place.tuning.never_fit if place.tuning is not None else ()
    tuning = (model.tuning or Tuning()).model_dump()
    content |= {
        "recording": files_in_full(recording, place.folder),
        "ground_truth": files_in_full(truth.model_dump(), place.folder) if truth else None,
        "n_lanes": place.n_lanes,
        "tuning": {**tuning, "never_fit": never_fit},
    }
    if model.tuned_on == "same_frames" and recording_key(model) != recording_key(place):
        content["tuned_on"] = "other_frames"
    return make_experiment(content, model.folder, model.source)


def recording_key(experiment: Experiment) -> str:
    """The same for experiments on the same recording: file or simulation, frames, and number of
    lanes."""
    recording = experiment.recording
    path = files_in_full({"path": recording.path}, experiment.folder)["path"]
    return repr((path, recording.simulate, recording.seed, recording.frames, experiment.n_lanes))


def parts_of_fleet(
    drives: Sequence[FleetDrive], drive_of: Sequence[str], n_parts: int, tag: str | None
) -> tuple[tuple[int, ...], ...]:
    """The numbers of the drives of a fleet that are held out together, part by part; none for one
    drive.

    - drive_of: the drive of each row, see `fleet.drives_of`.
    - n_parts: how many parts there are, neighbours in the table together; at most one for each.
    - tag: instead, those with each value of this tag.

    Rows of one drive (of several detectors, or stretches of one recording) are held out together.
    Raises InputError where nothing could be held out so.
    """
    if len(drives) == 1:
        return ()
    rows: dict[str, list[int]] = {}
    for k, first in enumerate(drive_of):
        rows.setdefault(first, []).append(k)
    if tag is None:
        if len(rows) == 1:
            where = f"{drives[0].source}: all other rows are of this drive too"
            raise InputError(f"{where}, so that none of them can be held out")
        in_parts = np.array_split(np.arange(len(rows)), min(n_parts, len(rows)))
        of_drives = list(rows.values())
        return tuple(tuple(sorted(k for j in part for k in of_drives[j])) for part in in_parts)
    found: dict[str, list[int]] = {}
    for same in rows.values():
        values = {drives[k].tags.get(tag) for k in same}
        (value,) = values if len(values) == 1 else (None,)
        source = drives[same[0]].source
        if len(values) > 1:
            others = ", ".join(drives[k].name for k in same)
            raise InputError(
                f"{source}: {others} are one drive, of which tag.{tag} differs; with one of them"
                " held out the others would give its labels away"
            )
        if value is None:
            known = {name for drive in drives for name in drive.tags}
            raise InputError(f"{source}: has no tag.{tag}{suggestion(tag, known)}")
        found.setdefault(value, []).extend(same)
    if len(found) == 1:
        where = f"{drives[0].source}: all other rows have this tag.{tag} too"
        raise InputError(f"{where}, so that none of them can be held out")
    return tuple(tuple(sorted(part)) for part in found.values())

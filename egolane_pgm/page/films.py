"""The pictures of a page: some frames of the recording, small."""

from __future__ import annotations

import base64
import warnings
from collections.abc import Sequence

import numpy as np

from egolane_pgm.results import Result
from egolane_pgm.types import InputError

#: The most pictures of a recording, and their height in pixels: some kilobytes each.
PICTURES, HEIGHT = 64, 120


#: Whose a recording is, where not all results have it; and its pictures in order: when each was
#: taken, seconds, and its address, which holds it whole.
Film = tuple[tuple[str, ...], list[tuple[float, str]]]


def films_of(results: Sequence[Result], titles: Sequence[str]) -> tuple[list[Film], list[str]]:
    """The pictures of the recordings that a detector looked at, one film for each recording; and a
    line for each whose pictures cannot be read."""
    found: dict[str, list[int]] = {}
    for k, result in enumerate(results):
        recording = result.config.get("recording") or {}
        if recording.get("detector") and recording.get("path"):
            found.setdefault(str(recording["path"]), []).append(k)
    made: list[Film] = []
    lacking = []
    for path, group in found.items():
        try:
            pictures = _stills(path, results[group[0]])
        except InputError as error:
            lacking.append(f"no pictures of the recording: {error}")
            continue
        if pictures:
            whose = () if len(group) == len(results) else tuple(titles[k] for k in group)
            made.append((whose, pictures))
    return made, lacking


def _stills(path: str, result: Result) -> list[tuple[float, str]]:
    from egolane_pgm.vision.camera.stills import small_pictures

    # Evenly over the time, not over the frames: a gap has no pictures.
    t = result.time_s
    wanted = np.linspace(t[0], t[-1], min(PICTURES, len(t)))
    at = np.unique(np.clip(np.searchsorted(t, wanted), 0, len(t) - 1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        taken = small_pictures(path, result.frame_id[at].tolist(), HEIGHT)
    pictures = []
    for k in at:
        content = taken.get(int(result.frame_id[k]))
        if content is not None:
            src = f"data:image/jpeg;base64,{base64.b64encode(content).decode()}"
            pictures.append((round(float(t[k]), 3), src))
    return pictures

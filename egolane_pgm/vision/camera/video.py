"""Reads the pictures of a video, with their positions from 0.

OpenCV gives all pictures in the size of the first one. Where a video changes its size, what comes
after is scaled to it, which fits the camera as long as the proportions stay the same.

A picture that cannot be decoded, because the video is damaged, is left out. The pictures after it
keep their positions if the container gives each picture's time (AVI does not: it counts the
pictures that it finds) and the frame rate has been constant. OpenCV also skips lost pictures
without a word. Such a loss is noticed if the container says how many pictures there are; a warning
then says that the positions after the damage are too low. The place of the damage is not certain,
because a good video of variable frame rate has gaps as well.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from pathlib import Path

import cv2

from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.picture import Image

#: The longest run of pictures that cannot be decoded, before the video counts as ended.
_MOST_LOST = 300

#: The largest difference, in frames, between a picture's time and its position at constant rate.
_STEADY = 0.05


def open_video(path: Path) -> cv2.VideoCapture:
    """Opens a video before its first picture. Raises InputError for a file that is no video."""
    # Without this, FFmpeg prints its own lines about files that our one-line error explains.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    with path.open("rb") as file:
        if not file.read(1):
            raise InputError(f"{path}: the file is empty")
    # FFmpeg takes what is before a colon for a protocol, unless the path is absolute.
    absolute = os.path.abspath(path)
    video = cv2.VideoCapture(absolute)
    if not video.isOpened() or not video.grab():
        video.release()
        raise InputError(
            f"{path}: is no video that can be read (another kind of file, or cut off before its"
            " index was written)"
        )
    video.release()
    return cv2.VideoCapture(absolute)


def video_images(
    name: str,
    path: Path,
    n_frames: int | None,
    frame_rate: float | None,
    frames: tuple[int, int] | None,
) -> Iterator[tuple[int, Image]]:
    """The positions and pictures of a video.

    - name: how messages name the video
    - n_frames, frame_rate: as the file says; None where it does not
    - frames: the first position to read and the one after the last; None for all

    Warns of a video that ends too early or lacks pictures in between.
    """
    first, stop = frames or (0, None)
    rate, is_avi = frame_rate or 0.0, _is_avi(path)
    video = open_video(path)
    try:
        at, due, gap, lost = 0, 0.0, None, list[int]()
        is_steady = rate > 0 and not is_avi
        # A picture is given out only when the next one can be read, because the last picture of a
        # video that was cut off may be incomplete.
        held: tuple[int, Image] | None = None
        while True:
            if not video.grab():
                later = _later(video, at, n_frames, rate) if is_steady else None
                if later is None:
                    break
                lost += range(at, later)
                at, due = later, later - 1.0
            if held is not None:
                yield held
                held = None
            if stop is not None and at >= stop:
                break
            before, due = due, _due(video, rate)
            is_steady = is_steady and abs(due - at) < _STEADY
            if gap is None and due - before > 1.75:
                gap = at
            if at >= first:
                is_there, image = video.retrieve()
                if not is_there:
                    break
                held = at, image  # type: ignore[assignment]
            at += 1
        said = []
        if lost:
            others = f" and {len(lost) - 1} later ones" if len(lost) > 1 else ""
            said.append(
                f"frame {lost[0]}{others} cannot be decoded (damaged): left out; pictures soon"
                " after such a place may be smeared"
            )
        is_short = n_frames is not None and first < at < n_frames
        if (stop is None or at < stop) and is_short:
            # A picture that cannot be decoded is not the end of the video: more may follow.
            is_end = not any(video.grab() for _ in range(5))
            is_whole = due > (n_frames or 0) - 1.5 or (is_avi and _is_complete(path))
            if is_end and is_whole:
                where = "" if gap is None else f" (some before frame {gap})"
                said.append(
                    f"lacks {(n_frames or 0) - at} of its {n_frames} frames{where}: dropped when it"
                    " was recorded, or damaged; the frame ids after such a place are too low"
                )
            else:
                held = None
                said.append(
                    f"breaks off in frame {at - 1}, it should have {n_frames}; the frames before"
                    " that one are used"
                )
        if held is not None:
            yield held
        for line in said:
            warnings.warn(f"{name}: {line}", UserWarning, stacklevel=2)
    finally:
        video.release()


def _due(video: cv2.VideoCapture, rate: float) -> float:
    """The time of the current picture, in frames at constant rate."""
    return float(video.get(cv2.CAP_PROP_POS_MSEC)) * rate / 1000


def _later(video: cv2.VideoCapture, at: int, n_frames: int | None, rate: float) -> int | None:
    """The position of the next picture that can be decoded, after some that cannot. None at the
    end of the video, and where the frame rate is not constant."""
    for _ in range(min(_MOST_LOST, (n_frames or 0) - at)):
        if video.grab():
            due = _due(video, rate)
            return round(due) if due > at - 0.5 and abs(due - round(due)) < _STEADY else None
    return None


def _is_avi(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(12)
    return head[:4] == b"RIFF" and head[8:] == b"AVI "


def _is_complete(avi: Path) -> bool:
    """Whether an AVI file is as long as its header says."""
    with avi.open("rb") as file:
        return 8 + int.from_bytes(file.read(8)[4:], "little") <= avi.stat().st_size

"""Finds the pinhole and distortion of a lens from pictures of a chessboard (Zhang's method, in
OpenCV)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from egolane_pgm.types import FloatArray, InputError
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.camera.pictures import read_images, size_of

#: With fewer boards the distortion would be left to chance.
MIN_BOARDS = 5

#: How many standard errors the third radial coefficient must differ from 0 to be kept. It is rarely
#: needed, and a coefficient fitted to noise bends the corners of the picture.
K3_ERRORS = 3.0

_SEARCH = cv2.CALIB_CB_NORMALIZE_IMAGE


@dataclass(frozen=True)
class Lens:
    """The lens of a camera.

    - camera: has this lens, and is 1 m above the road
    - boards: names of the B pictures that were used
    - rms_px: (B,) root mean square reprojection error of each board, pixels
    - skipped: one line for each picture that was not used, with the reason
    """

    camera: Camera
    boards: tuple[str, ...]
    rms_px: tuple[float, ...]
    skipped: tuple[str, ...]

    @property
    def overall_rms_px(self) -> float:
        """Root mean square error over all boards, pixels."""
        return float(np.sqrt(np.mean(np.square(self.rms_px))))


def find_board(image: Image, columns: int, rows: int) -> FloatArray | None:
    """The inner corners of a board, (rows * columns, 2), pixels, row by row; None unless all of
    them are found."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    found, corners = cv2.findChessboardCornersSB(grey, (columns, rows), flags=_SEARCH)
    if not found:
        return None
    grid = np.asarray(corners, dtype=np.float32).reshape(rows, columns, 2)
    # The window is small enough to hold one corner only, even if the board is small.
    nearest = min(np.linalg.norm(np.diff(grid, axis=k), axis=-1).min() for k in (0, 1))
    half = int(np.clip(nearest / 3, 2, 11))
    until = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 1e-3)
    refined = cv2.cornerSubPix(grey, grid.reshape(-1, 1, 2), (half, half), (-1, -1), until)
    return np.asarray(refined, dtype=np.float64).reshape(-1, 2)


def calibrate_lens(paths: Iterable[Path], columns: int = 9, rows: int = 6) -> Lens:
    """Finds the lens of the camera that took these pictures of a chessboard.

    - paths: the pictures. A file that is no picture, a picture of another size than most, and one
      that does not show the whole board are left out and reported in `skipped`.
    - columns, rows: inner corners of the board

    Raises InputError for fewer than MIN_BOARDS boards.
    """
    paths = list(paths)
    skipped: list[str] = []
    found = [
        (path, size_of(image), find_board(image, columns, rows))
        for path, image in read_images(paths, skipped)
    ]
    sizes = Counter(size for _, size, _ in found).most_common(1)
    usual = sizes[0][0] if sizes else (0, 0)
    boards: list[tuple[Path, FloatArray]] = []
    for path, size, corners in found:
        if size != usual:
            skipped.append(f"{path}: {size[0]}x{size[1]}, most are {usual[0]}x{usual[1]}")
        elif corners is None:
            skipped.append(f"{path}: no chessboard of {columns}x{rows} inner corners found")
        else:
            boards.append((path, corners))
    if len(boards) < MIN_BOARDS:
        first = f"; {skipped[0]}" if skipped else ""
        raise InputError(
            f"{len(boards)} of {len(paths)} pictures show the whole chessboard of {columns}x{rows}"
            f" inner corners, needs {MIN_BOARDS} (check `board`){first}"
        )
    return _solve(boards, usual, columns, rows, skipped)


def _solve(
    boards: Sequence[tuple[Path, FloatArray]],
    size: tuple[int, int],
    columns: int,
    rows: int,
    skipped: Sequence[str],
) -> Lens:
    flat = np.zeros((columns * rows, 3), dtype=np.float32)
    flat[:, :2] = np.mgrid[:columns, :rows].T.reshape(-1, 2)
    seen = [corners.astype(np.float32).reshape(-1, 1, 2) for _, corners in boards]

    def solve(flags: int) -> tuple[FloatArray, ...]:
        _, pinhole, bend, _, _, errors, _, rms = cv2.calibrateCameraExtended(
            [flat] * len(seen), seen, size, np.eye(3), np.zeros(5), flags=flags
        )
        return tuple(np.asarray(x, dtype=np.float64) for x in (pinhole, bend, errors, rms))

    pinhole, bend, errors, rms = solve(0)
    if abs(bend.flat[4]) < K3_ERRORS * errors.flat[8]:
        pinhole, bend, errors, rms = solve(cv2.CALIB_FIX_K3)
    k1, k2, p1, p2, k3 = (float(value) for value in bend.flat[:5])
    fx, fy, cx, cy = (float(pinhole[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Lens(
        Camera(*size, fx, fy, cx, cy, height_m=1.0, distortion=(k1, k2, p1, p2, k3)),
        boards=tuple(path.name for path, _ in boards),
        rms_px=tuple(float(value) for value in rms.flat),
        skipped=tuple(skipped),
    )


def describe_lens(lens: Lens, board: str) -> str:
    """Describe a lens in some lines. board: its inner corners, e.g. "9x6"."""
    best, worst = min(lens.rms_px), max(lens.rms_px)
    each = zip(lens.boards, lens.rms_px, strict=True)
    return "\n".join(
        [
            f"Lens: {len(lens.boards)} chessboards ({board} inner corners) of"
            f" {len(lens.boards) + len(lens.skipped)} pictures, {lens.overall_rms_px:.2f} px RMS",
            f"  ({best:.2f} to {worst:.2f} px from board to board).",
            *(f"  {name}: {rms:.2f} px RMS" for name, rms in each),
        ]
    )

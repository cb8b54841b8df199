"""Finds the pinhole and distortion of a lens from pictures of a chessboard (Zhang's method, in
OpenCV)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from egolane_pgm.types import FloatArray, InputError
from egolane_pgm.vision.camera.model import Camera
from egolane_pgm.vision.camera.picture import Image
from egolane_pgm.vision.camera.pictures import read_image, size_of

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
    - rms_px: root mean square reprojection error of each board, pixels, by its picture
    - skipped: one line for each picture that was not used, with the reason
    """

    camera: Camera
    rms_px: dict[Path, float]
    skipped: tuple[str, ...]


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
    """Find the lens of the camera that took these pictures of a chessboard.

    - paths: the pictures. Damaged ones, ones of another size than most, and ones that do not show
      the whole board are left out and reported in `skipped`.
    - columns, rows: inner corners of the board

    Raises InputError for fewer than MIN_BOARDS boards.
    """
    skipped: list[str] = []
    found = []
    for path in paths:
        try:
            image = read_image(path)
        except InputError as error:
            skipped.append(str(error))
            continue
        found.append((path, size_of(image), find_board(image, columns, rows)))
    sizes = Counter(size for _, size, _ in found)
    usual = max(sizes, key=sizes.__getitem__, default=(0, 0))
    boards: dict[Path, FloatArray] = {}
    for path, size, corners in found:
        if size != usual:
            skipped.append(f"{path}: {size[0]}x{size[1]}, most are {usual[0]}x{usual[1]}")
        elif corners is None:
            skipped.append(f"{path}: no chessboard of {columns}x{rows} inner corners found")
        else:
            boards[path] = corners
    if len(boards) < MIN_BOARDS:
        first = f"; {skipped[0]}" if skipped else ""
        raise InputError(
            f"{len(boards)} of {len(boards) + len(skipped)} pictures show the whole chessboard of"
            f" {columns}x{rows} inner corners, needs {MIN_BOARDS} (check `board`){first}"
        )
    flat = np.zeros((columns * rows, 3), dtype=np.float32)
    flat[:, :2] = np.mgrid[:columns, :rows].T.reshape(-1, 2)
    seen = [corners.astype(np.float32).reshape(-1, 1, 2) for corners in boards.values()]

    def solve(flags: int) -> tuple[FloatArray, ...]:
        _, pinhole, bend, _, _, errors, _, rms = cv2.calibrateCameraExtended(
            [flat] * len(seen), seen, usual, np.eye(3), np.zeros(5), flags=flags
        )
        return tuple(np.asarray(x, dtype=np.float64) for x in (pinhole, bend, errors, rms))

    pinhole, bend, errors, rms = solve(0)
    if abs(bend.flat[4]) < K3_ERRORS * errors.flat[8]:
        pinhole, bend, errors, rms = solve(cv2.CALIB_FIX_K3)
    k1, k2, p1, p2, k3 = bend.ravel()[:5].tolist()
    (fx, _, cx), (_, fy, cy), _ = pinhole.tolist()
    camera = Camera(*usual, fx, fy, cx, cy, height_m=1.0, distortion=(k1, k2, p1, p2, k3))
    return Lens(camera, dict(zip(boards, rms.ravel().tolist(), strict=True)), tuple(skipped))


def describe_lens(lens: Lens, board: str) -> str:
    """Describe a lens in some lines. board: its inner corners, e.g. "9x6"."""
    rms = list(lens.rms_px.values())
    return "\n".join(
        [
            f"Lens: {len(rms)} chessboards ({board} inner corners) of"
            f" {len(rms) + len(lens.skipped)} pictures, {np.sqrt(np.mean(np.square(rms))):.2f} px"
            f" RMS\n  ({min(rms):.2f} to {max(rms):.2f} px from board to board).",
            *(f"  {path.name}: {one:.2f} px RMS" for path, one in lens.rms_px.items()),
        ]
    )

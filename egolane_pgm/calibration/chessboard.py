"""The lens from pictures of a chessboard: pinhole and distortion (Zhang's method, in OpenCV)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from egolane_pgm.camera.picture import Image
from egolane_pgm.camera.pictures import readable, size_of
from egolane_pgm.types import FloatArray, InputError

#: Fewer boards leave the distortion to chance.
MIN_BOARDS = 5

#: More corners, along one side, are not told apart in a picture.
LARGEST_BOARD = 100

#: The third radial coefficient is kept only where the boards tell it from 0 by as many standard
#: errors: it is hardly ever needed and, when fitted to noise, bends the corners of the picture.
K3_ERRORS = 3.0

#: The smallest part of a board that is worth a word, inner corners.
_PART = (4, 3)

_SEARCH = cv2.CALIB_CB_NORMALIZE_IMAGE


@dataclass(frozen=True)
class Lens:
    """The inside of a camera.

    width, height, fx, fy, cx, cy: pixels. distortion: OpenCV's k1, k2, p1, p2, k3.
    boards (B,): the pictures used; rms_px (B,): what each board is off by, root mean square,
    pixels. skipped: one line for each picture that was not used.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    boards: tuple[str, ...] = ()
    rms_px: tuple[float, ...] = ()
    skipped: tuple[str, ...] = ()

    @property
    def overall_rms_px(self) -> float:
        """Root mean square over all boards, pixels; NaN without boards."""
        return float(np.sqrt(np.mean(np.square(self.rms_px)))) if self.rms_px else float("nan")


def find_board(image: Image, columns: int, rows: int) -> FloatArray | None:
    """The inner corners (rows * columns, 2), pixels, row by row; None unless all are seen."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    found, corners = cv2.findChessboardCornersSB(grey, (columns, rows), flags=_SEARCH)
    if not found:
        return None
    grid = np.asarray(corners, dtype=np.float32).reshape(rows, columns, 2)
    # The corner and nothing of its neighbours in the window, wherever the board is small.
    nearest = min(np.linalg.norm(np.diff(grid, axis=k), axis=-1).min() for k in (0, 1))
    half = int(np.clip(nearest / 3, 2, 11))
    until = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 1e-3)
    refined = cv2.cornerSubPix(grey, grid.reshape(-1, 1, 2), (half, half), (-1, -1), until)
    return np.asarray(refined, dtype=np.float64).reshape(-1, 2)


def _seen_in_part(image: Image, columns: int, rows: int) -> str:
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    flags = _SEARCH | cv2.CALIB_CB_LARGER
    found, _, layout = cv2.findChessboardCornersSBWithMeta(grey, _PART, flags=flags)
    if not found:
        return "no chessboard found"
    tall, wide = sorted(layout.shape)
    return f"a chessboard with {wide}x{tall} inner corners seen, not {columns}x{rows}"


def calibrate_lens(
    paths: Iterable[Path], columns: int = 9, rows: int = 6, min_boards: int = MIN_BOARDS
) -> Lens:
    """The lens of the camera that took these pictures of a chessboard.

    columns, rows: inner corners of the board. Pictures of another size than most, that are none,
    or that do not show the whole board are left out and reported in `skipped`.

    Raises InputError for a board that there is not, and with fewer than `min_boards` boards.
    """
    if min(columns, rows) < 3 or max(columns, rows) > LARGEST_BOARD:
        raise InputError(
            f"board {columns}x{rows}: needs 3x3 to {LARGEST_BOARD}x{LARGEST_BOARD} inner corners"
        )
    paths = list(paths)
    skipped: list[str] = []
    found: list[tuple[Path, tuple[int, int], FloatArray | None, str]] = []
    for path, image in readable(paths, skipped):
        corners = find_board(image, columns, rows)
        why = "" if corners is not None else _seen_in_part(image, columns, rows)
        found.append((path, size_of(image), corners, why))
    sizes = Counter(size for _, size, _, _ in found)
    usual = max(sizes, key=lambda size: sizes[size]) if sizes else (0, 0)
    boards: list[tuple[Path, FloatArray]] = []
    for path, size, corners, why in found:
        if size != usual:
            skipped.append(f"{path}: {size[0]}x{size[1]}, most are {usual[0]}x{usual[1]}")
        elif corners is None:
            skipped.append(f"{path}: {why}")
        else:
            boards.append((path, corners))
    if len(boards) < min_boards:
        first = f"; {skipped[0]}" if skipped else ""
        raise InputError(
            f"{len(boards)} of {len(paths)} pictures show the whole chessboard of {columns}x{rows}"
            f" inner corners, needs {min_boards} (--board says its corners){first}"
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
        try:
            _, pinhole, bend, _, _, errors, _, rms = cv2.calibrateCameraExtended(
                [flat] * len(seen), seen, size, np.eye(3), np.zeros(5), flags=flags
            )
        except cv2.error as error:
            raise InputError(
                f"the {len(seen)} chessboards give no lens ({error.err}); take pictures of the"
                " board turned in different ways"
            ) from error
        return tuple(np.asarray(x, dtype=np.float64) for x in (pinhole, bend, errors, rms))

    pinhole, bend, errors, rms = solve(0)
    if abs(bend.flat[4]) < K3_ERRORS * errors.flat[8]:
        pinhole, bend, errors, rms = solve(cv2.CALIB_FIX_K3)
    k1, k2, p1, p2, k3 = (float(value) for value in bend.flat[:5])
    return Lens(
        *size,
        fx=float(pinhole[0, 0]),
        fy=float(pinhole[1, 1]),
        cx=float(pinhole[0, 2]),
        cy=float(pinhole[1, 2]),
        distortion=(k1, k2, p1, p2, k3),
        boards=tuple(path.name for path, _ in boards),
        rms_px=tuple(float(value) for value in rms.flat),
        skipped=tuple(skipped),
    )

"""Stereo matchers, by name or in a user's own file.

A matcher is a function `match(left, right, n_disparities) -> disparity`. It takes two grey pictures
(H, W) and gives, for each pixel of the left one, how many pixels farther left it is in the right
one: 0 to n_disparities - 1, and NaN or a negative number where it cannot tell. The right picture
has been moved by the disparities of the calibrated road. A flat road therefore has the same
disparity everywhere, and objects on it have a larger one.

ELAS (Geiger, Roser and Urtasun 2010) is in the package pyelas (GPL), which has to be compiled. Its
build does not say where NumPy's headers are, so a variable names their folder:

    CPLUS_INCLUDE_PATH=$(python -c "import numpy; print(numpy.get_include())") pip install pyelas

In a copy of this repository, `pip install -e ".[elas]"` with the same variable does so too.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from egolane_pgm.parameters import Parameter, Parameters, Value, number
from egolane_pgm.plugins import load_plugin, plugin_errors
from egolane_pgm.types import InputError, suggestion
from egolane_pgm.vision.camera.picture import Image

Match = Callable[[Image, Image, int], NDArray[np.float32]]

#: The matchers of the package; a name that ends in .py is a file.
NAMES = ("bm", "elas", "sgbm")


class MatcherName(Parameter):
    """A parameter whose value is the name of a matcher or of a file."""

    def check(self, value: object, n_lanes: int, where: str) -> Value:
        """The value. Raises InputError, with a suggestion, for an unknown name."""
        if not isinstance(value, str):
            raise InputError(f"{where}: {value!r} is not the name of a matcher or a .py file")
        if value not in NAMES and not value.endswith(".py"):
            raise InputError(f"{where}: unknown matcher '{value}'{suggestion(value, NAMES)}")
        return value


_INSTALL_ELAS = (
    'CPLUS_INCLUDE_PATH=$(python -c "import numpy; print(numpy.get_include())") pip install pyelas'
)

PARAMETERS = (
    MatcherName(
        "matcher",
        "choice",
        "sgbm",
        "the stereo matcher: sgbm, bm, elas (package pyelas), or a file of your own with"
        " match(left, right, n_disparities)",
        choices=NAMES,
    ),
    Parameter(
        "block_px",
        "integer",
        5,
        "side of the blocks that are compared, odd (sgbm, bm)",
        lowest=1,
        highest=255,
    ),
    Parameter(
        "small_step",
        "positive",
        8.0,
        "cost of a step of one in disparity beside a pixel, times the block's area (sgbm: P1)",
        highest=1000,
    ),
    Parameter(
        "large_step", "positive", 32.0, "the same for a larger step (sgbm: P2)", highest=1000
    ),
    Parameter(
        "uniqueness",
        "integer",
        5,
        "least lead of the best match over the second one, percent (sgbm, bm)",
        highest=100,
    ),
    Parameter(
        "left_right_px",
        "integer",
        1,
        "largest difference between matching left to right and right to left, pixels (sgbm)",
        lowest=1,
        highest=1000,
    ),
    Parameter(
        "speckle_px",
        "integer",
        60,
        "smallest patch of equal disparity that is kept, pixels (sgbm, bm)",
        highest=1_000_000,
    ),
    Parameter(
        "speckle_step",
        "integer",
        1,
        "largest difference of disparity between neighbours in a patch (sgbm, bm)",
        lowest=1,
        highest=1000,
    ),
    Parameter(
        "most_gradient",
        "integer",
        31,
        "larger differences of grey level between neighbours are cut to this (sgbm, bm)",
        lowest=1,
        highest=1000,
    ),
)


def find_matcher(parameters: Parameters, where: str) -> Match:
    """The matcher that the parameters name. where: how error messages begin.

    Raises InputError for a matcher whose package is not installed, a file that cannot be used, and
    an even block size.
    """
    name = str(parameters["matcher"])
    if name.endswith(".py"):
        return _from_file(name, where)
    if name == "elas":
        return _elas(where)
    block = int(number(parameters, "block_px"))
    if block % 2 == 0 or (name == "bm" and block < 5):
        least = " of 5 or more" if name == "bm" else ""
        raise InputError(f"block_px: {block} must be odd; {name} needs an odd side{least}")
    return _bm(parameters, block) if name == "bm" else _sgbm(parameters, block)


def _whole(parameters: Parameters, name: str) -> int:
    return round(number(parameters, name))


def _in_pixels(matcher: Any) -> Callable[[Image, Image], NDArray[np.float32]]:
    """Converts the result of an OpenCV matcher from sixteenths of a pixel to pixels."""

    def compute(left: Image, right: Image) -> NDArray[np.float32]:
        try:
            disparity: NDArray[np.float32] = matcher.compute(left, right).astype(np.float32)
        except cv2.error as error:
            raise InputError(
                "matcher: cannot match with these values of block_px, uniqueness or most_gradient:"
                f" {' '.join(str(error.err).split())}"
            ) from error
        disparity /= 16
        return disparity

    return compute


def _sgbm(parameters: Parameters, block: int) -> Match:
    area = block * block

    def match(left: Image, right: Image, n_disparities: int) -> NDArray[np.float32]:
        small = round(number(parameters, "small_step") * area)
        large = round(number(parameters, "large_step") * area)
        matcher = cv2.StereoSGBM.create(
            minDisparity=0,
            numDisparities=n_disparities,
            blockSize=block,
            P1=small,
            # OpenCV needs P2 > P1.
            P2=max(large, small + 1),
            disp12MaxDiff=_whole(parameters, "left_right_px"),
            preFilterCap=_whole(parameters, "most_gradient"),
            uniquenessRatio=_whole(parameters, "uniqueness"),
            speckleWindowSize=_whole(parameters, "speckle_px"),
            speckleRange=_whole(parameters, "speckle_step"),
            mode=cv2.STEREO_SGBM_MODE_SGBM,
        )
        return _in_pixels(matcher)(left, right)

    return match


def _bm(parameters: Parameters, block: int) -> Match:
    def match(left: Image, right: Image, n_disparities: int) -> NDArray[np.float32]:
        matcher = cv2.StereoBM.create(n_disparities, block)
        matcher.setUniquenessRatio(_whole(parameters, "uniqueness"))
        matcher.setSpeckleWindowSize(_whole(parameters, "speckle_px"))
        matcher.setSpeckleRange(_whole(parameters, "speckle_step"))
        matcher.setPreFilterCap(_whole(parameters, "most_gradient"))
        return _in_pixels(matcher)(left, right)

    return match


def _elas(where: str) -> Match:
    try:
        from elas import Elas  # type: ignore[import-not-found]
    except ImportError:
        raise InputError(
            f"{where}: elas is not installed: `{_INSTALL_ELAS}` (GPL, needs a C++ compiler), or"
            " choose sgbm or bm"
        ) from None
    kept: list[Image] = []

    def match(left: Image, right: Image, n_disparities: int) -> NDArray[np.float32]:
        # pyelas never lets go of an array that it was given, so it gets the same two each time.
        if not kept or kept[0].shape != left.shape:
            kept[:] = np.empty_like(left, order="C"), np.empty_like(right, order="C")
        kept[0][:], kept[1][:] = left, right
        matcher = Elas()
        matcher.disp_max = n_disparities - 1
        found, _ = matcher.process(*kept)
        return np.asarray(found, dtype=np.float32)

    return match


def _from_file(name: str, where: str) -> Match:
    module = load_plugin("matchers", name, Path.cwd(), where)

    def match(left: Image, right: Image, n_disparities: int) -> NDArray[np.float32]:
        with plugin_errors(module, where):
            disparity = np.asarray(module.match(left, right, n_disparities))
        is_number = np.issubdtype(disparity.dtype, np.number) and np.isrealobj(disparity)
        if disparity.shape != left.shape or not is_number:
            raise InputError(
                f"{where}: {name}: match gave {disparity.dtype} {disparity.shape}, needs one number"
                f" per pixel {left.shape}"
            )
        return disparity.astype(np.float32)

    return match

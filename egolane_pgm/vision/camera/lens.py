"""Read the lens of a camera from the files of ROS, OpenCV and Kalibr.

- ROS: `camera_info` as YAML, written by a calibrator or printed from the topic
- OpenCV: a `FileStorage` in YAML or XML, as its calibration samples write it
- Kalibr: `camchain.yaml`, of which the first camera is taken

The files may also have the keys of our own camera YAML that describe the mounting.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from egolane_pgm.tools.files import read_text, read_yaml
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    import cv2

#: Our keys, and the names that they have elsewhere. A matrix is rows of numbers, or all of them.
_NAMES = {
    "width": ("image_width", "width"),
    "height": ("image_height", "height"),
    "matrix": ("camera_matrix", "K", "k", "cameraMatrix", "intrinsics"),
    "distortion": ("distortion_coefficients", "D", "d", "distCoeffs", "distortion_coeffs"),
    "lens": ("distortion_model",),
}

#: The number of coefficients of each lens.
COEFFICIENTS = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}

#: The distortion models that are known, by their names in ROS and Kalibr.
_LENSES = {
    **{lens: lens for lens in COEFFICIENTS},
    "radtan": "plumb_bob",
    "none": "plumb_bob",
    "fisheye": "equidistant",
}


def read_keys(path: Path) -> tuple[dict[str, Any], bool]:
    """Return the keys of a camera's file by our names, and whether another program wrote the file.

    Raises InputError, naming file and key, for a file that cannot be read or another lens model.
    """
    start = read_text(path)[:5]
    is_opencv = start.startswith(("%YAML", "<?xml"))
    content = _of_opencv(path) if is_opencv else read_yaml(path, "height_m: 1.3")
    # The cameras of Kalibr.
    cameras = [
        key
        for key, value in content.items()
        if isinstance(value, Mapping) and "intrinsics" in value and "resolution" in value
    ]
    if cameras:
        content = {**content, **content.pop(cameras[0])}
        for other in cameras[1:]:
            del content[other]
    theirs = {
        ours: next(name for name in names if name in content)
        for ours, names in _NAMES.items()
        if not set(names).isdisjoint(content)
    }
    for key in ("camera_model", "model_type"):
        if str(content.get(key, "pinhole")).lower() != "pinhole":
            raise InputError(f"{path}: {key}: {content[key]!r} is not pinhole")
    if "matrix" not in theirs:
        return content, False
    kept = {key: content[key] for key in content if key.endswith(("_m", "_deg")) or key == "ignore"}
    if "resolution" in content:
        kept["width"], kept["height"] = _numbers(path, "resolution", content, (2,))
    for key in ("width", "height"):
        if key in theirs:
            kept[key] = content[theirs[key]]
    values = _numbers(path, theirs["matrix"], content, (4, 9))
    at = (0, 1, 2, 3) if len(values) == 4 else (0, 4, 2, 5)
    kept["fx"], kept["fy"], kept["cx"], kept["cy"] = (values[k] for k in at)
    bends = []
    if "distortion" in theirs:
        bends = _numbers(path, theirs["distortion"], content, (0, 2, 4, 5, 8, 12, 14))
    usual = "rational_polynomial" if any(bends[5:]) else "plumb_bob"
    given = content.get(theirs.get("lens", "")) or (
        "equidistant" if content.get("fisheye_model") else usual
    )
    if given not in _LENSES:
        known = ", ".join(_LENSES)
        raise InputError(f"{path}: distortion_model: {given!r} is not one of {known}")
    kept["lens"] = _LENSES[given]
    n = COEFFICIENTS[kept["lens"]]
    if any(bends[n:]):
        raise InputError(
            f"{path}: {theirs['distortion']}: has more than the {n} coefficients of"
            f" {kept['lens']}; calibrate with {', '.join(COEFFICIENTS)}"
        )
    kept["distortion"] = (bends + [0.0] * n)[:n]
    return kept, True


def _numbers(
    path: Path, key: str, content: Mapping[str, Any], counts: tuple[int, ...]
) -> list[Any]:
    """Return the numbers of a list, of rows, or of a matrix with `data`, in one list."""
    value = content[key]
    value = value.get("data") if isinstance(value, Mapping) else value
    rows = value if isinstance(value, list) else [None]
    flat = [x for row in rows for x in (row if isinstance(row, list) else [row])]
    if len(flat) not in counts or not all(type(x) in (int, float) for x in flat):
        raise InputError(f"{path}: {key}: needs {' or '.join(map(str, counts))} numbers")
    return flat


def _of_opencv(path: Path) -> dict[str, Any]:
    """Return the content of a FileStorage; matrices as rows."""
    import cv2

    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        return dict(_value(storage.root()))
    except (cv2.error, SystemError, AttributeError, TypeError, ValueError, RecursionError):
        raise InputError(f"{path}: is not a FileStorage of OpenCV that can be read") from None


def _value(node: cv2.FileNode) -> Any:
    if node.isMap():
        names = node.keys()
        if "data" in names:
            return node.mat().tolist()
        return {name: _value(node.getNode(name)) for name in names}
    if node.isSeq():
        return [_value(node.at(k)) for k in range(node.size())]
    if node.isString():
        return node.string()
    return int(node.real()) if node.isInt() else node.real()

"""The verb `network-check`."""

from __future__ import annotations

from pathlib import Path

from egolane_pgm.verbs.given import StrPath, path_of
from egolane_pgm.vision.detectors.networks.checking import check_onnx

EXAMPLES = ("egolane network-check lstr_360x640.onnx > lanes.yaml",)


def network_check(file: StrPath) -> str:
    """What a lane network (FILE.onnx) takes and gives, which layout fits, and the YAML to start
    from.

    Returns it as text. Raises InputError for a file that is no ONNX.
    """
    return check_onnx(Path(path_of(file, "file")))

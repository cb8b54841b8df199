"""A network over a drive: as a detector of its own, and as what tells others where the road is."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from egolane_pgm.drive import data_entries, load_recording

from egolane_pgm.experiment import load_experiment
from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import road_to_image
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import FrameLines
from egolane_pgm.vision.detectors.runner import detect, find_detector, start
from tests.kits.drives import command
from tests.kits.synthetic_road import CAMERA, drive
from tests.kits.tiny_network import (
    write_answer,
    write_answers,
    write_known,
    write_top_hat,
)


@pytest.fixture(scope="module")
def top_hat(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_top_hat(tmp_path_factory.mktemp("top_hat"), CAMERA.width, CAMERA.height)


def write_segments(folder: Path, lines: Sequence[tuple[float, int, float]], **keys: Any) -> Path:
    """A network that sees straight lines, each with its offset, class and probability."""
    size, n = (CAMERA.width, CAMERA.height), len(lines)
    masks, boxes = np.full((1, n, *size[::-1]), -9.0), np.zeros((1, n, 6 + n))
    far = np.linspace(3, 60, 2000)
    for k, (offset, kind, likely) in enumerate(lines):
        u, v = (np.round(at).astype(int) for at in road_to_image(CAMERA, far, offset))
        inside = (u >= 1) & (u < size[0] - 1) & (v >= 0) & (v < size[1])
        for aside in (-1, 0, 1):
            masks[0, k, v[inside], u[inside] + aside] = 9
        boxes[0, k, :6] = (0, 0, *size, likely, kind)
        boxes[0, k, 6 + k] = 1
    outputs = {"boxes": boxes, "prototypes": masks}
    return write_answers(folder, outputs, layout="prototypes", size=list(size), **keys)


def lines_of(name: str, given: dict[str, Any], pictures: list[Picture]) -> list[FrameLines]:
    detector = find_detector(name, given, Path.cwd(), "detector")
    return [lines for _, lines in detect(detector, CAMERA, pictures)]


# --- a detector of its own --------------------------------------------------------------------


def test_classes_are_the_continuous_flag_and_probabilities_the_lri(tmp_path: Path) -> None:
    """Three lines of a network with classes, on pictures in which two others are painted; another
    class is no line."""
    kinds = ((-3.4, 1, 0.9), (0.3, 2, 0.6), (3.9, 2, 1.0), (7.5, 3, 0.95), (-7, 1, 0.3))
    path = write_segments(tmp_path, kinds, classes={"dashed": [1], "solid": [2]})
    given = {"network": str(path), "beyond_edge": "keep"}
    lines = lines_of("network", given, drive(12))[-1]
    np.testing.assert_allclose(lines.offset_m, [-3.4, 0.3, 3.9], atol=0.05)
    assert lines.is_continuous.tolist() == [False, True, True]
    np.testing.assert_allclose(lines.lri, [9, 6, 10], rtol=1e-5)
    assert lines.is_valid.all()


def test_a_network_without_lines_is_no_detector(tmp_path: Path) -> None:
    path = write_answer(tmp_path, np.ones((1, 1, 4, 8)), layout="drivable", classes=1)
    detector = find_detector("network", {"network": str(path)}, Path.cwd(), "detector")
    with pytest.raises(InputError, match="layout drivable has no lines; name it as on_road,"):
        start(detector, CAMERA)


# --- where the road is ------------------------------------------------------------------------


def test_beside_lines_there_is_a_margin(top_hat: Path) -> None:
    """Nothing is lost where the network sees the lines, all is where it sees none."""
    pictures = drive(12)
    alone = lines_of("ml", {}, pictures)[-1]
    helped = lines_of("ml", {"on_road": str(top_hat)}, pictures)[-1]
    np.testing.assert_allclose(helped.offset_m, alone.offset_m, atol=0.03)
    assert (helped.is_continuous == alone.is_continuous).all()


# --- commands ---------------------------------------------------------------------------------


#: The network of `seen`.
NAMED = "nets/top_hat.yaml"


@pytest.fixture(scope="module")
def seen(place: Path) -> Path:
    """The folder of `place`, its experiment looked at by a network in a folder below it."""
    (place / "nets").mkdir()
    write_top_hat(place / "nets", CAMERA.width, CAMERA.height)
    content = yaml.safe_load((place / "run.yaml").read_text())
    content["recording"] |= {
        "detector": "network",
        "detector_parameters": {"network": NAMED},
    }
    (place / "seen.yaml").write_text(yaml.safe_dump(content))
    return place


def test_a_run_notes_the_network_by_its_content(seen: Path, tmp_path: Path) -> None:
    def entries() -> dict[str, str]:
        experiment = load_experiment(seen / "seen.yaml")
        recorded = load_recording(experiment, {})
        return {Path(e["path"]).name: e["sha256"] for e in data_entries(experiment, recorded.files)}

    before = entries()
    assert {"drive.avi", "cam.yaml", "top_hat.yaml", "top_hat.onnx"} == set(before)
    path = seen / "nets" / "top_hat.yaml"
    text = path.read_text()
    path.write_text(text + "threshold: 0.6\n")
    after = entries()
    path.write_text(text)
    assert {name for name in before if before[name] != after[name]} == {"top_hat.yaml"}
    # The experiment that a run writes can be run from where it lies.
    out = tmp_path / "out"
    done = command("run", seen / "seen.yaml", "--no-figures", "--out", out)
    assert done.exit_code == 0, done.stderr
    written = yaml.safe_load((out / "experiment.yaml").read_text())
    assert written["recording"]["detector_parameters"]["network"] == str(path.absolute())
    noted = {Path(e["path"]).name for e in json.loads((out / "run.json").read_text())["data"]}
    assert {"top_hat.yaml", "top_hat.onnx"} <= noted
    # So can that with one that comes along, whose ONNX is beside the first.
    outputs = {"pred_logits": np.ones((1, 7, 2)), "pred_curves": np.ones((1, 7, 8))}
    inputs = {"input_mask": (1, 1, 360, 640)}
    write_known(seen / "lstr_360x640.onnx", outputs, (640, 360), inputs)
    (seen / "lstr.run.yaml").write_text((seen / "seen.yaml").read_text().replace(NAMED, "lstr"))
    done = command("run", seen / "lstr.run.yaml", "--no-figures", "--out", out)
    assert done.exit_code == 0, done.stderr
    assert "ok" in command("run", "--dry-run", out / "experiment.yaml").stdout

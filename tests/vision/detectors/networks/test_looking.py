"""A network over a drive: as a detector of its own, and as what tells others where the road is."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from egolane_pgm.drive import data_entries, load_recording
from egolane_pgm.experiment import load_experiment
from egolane_pgm.simulation import simulated_road
from egolane_pgm.types import InputError
from egolane_pgm.vision.camera.model import road_to_image
from egolane_pgm.vision.camera.picture import Picture
from egolane_pgm.vision.detectors import FrameLines
from egolane_pgm.vision.detectors.networks.finding import keep_on_road
from egolane_pgm.vision.detectors.runner import detect, find_detector, start
from egolane_pgm.vision.detectors.simple.birdseye import look, make_view
from egolane_pgm.vision.detectors.simple.markings import marking_mask
from egolane_pgm.vision.simulated import draw_frame
from tests.kits.drives import command, refused
from tests.kits.synthetic_road import CAMERA, drive
from tests.kits.tiny_network import CAMERA as WIDE
from tests.kits.tiny_network import (
    heavy_traffic,
    labels,
    write_answer,
    write_answers,
    write_known,
    write_network,
    write_top_hat,
)


@pytest.fixture(scope="module")
def top_hat(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_top_hat(tmp_path_factory.mktemp("top_hat"), CAMERA.width, CAMERA.height)


def with_keys(path: Path, target: Path, **keys: Any) -> Path:
    """The YAML of a network with other keys, beside the same ONNX."""
    content = yaml.safe_load(path.read_text())
    content["model"] = str(path.parent / content["model"])
    return write_network(target, **{**content, **keys})


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


@pytest.mark.parametrize(
    ("name", "given"),
    [("network", {"network": "lanes.yaml"}), ("mc", {"on_road": "drivable.yaml"})],
)
def test_with_a_trained_network_the_lines_of_the_own_lane_are_found(
    tiny_network: Path, name: str, given: dict[str, str]
) -> None:
    """On drives that it was not trained on, in most frames."""
    found = []
    for seed in (11, 13):
        road = simulated_road("a4", seed, 40)
        step = start(find_detector(name, given, tiny_network, "detector"), WIDE)
        for k in range(8):
            lines = step(Picture(k, draw_frame(road, k, WIDE)))
            true = road.line_offset_m[k]
            own = [true[true < 0].max(), true[true > 0].min()]
            away = np.abs(lines.offset_m[:, None] - own).min(axis=0, initial=np.inf)
            found.append((away < 0.35).all())
    assert np.mean(found) >= 0.85


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


def test_marking_is_kept_on_the_road_and_dropped_on_vehicles(tiny_network: Path) -> None:
    given = {"on_road": str(tiny_network / "drivable.yaml")}
    detector = find_detector("mc", given, Path.cwd(), "detector")
    view = make_view(WIDE, 5.0, 35.0, -9.0, 9.0, 0.1, 0.05)
    road = keep_on_road(WIDE, detector.parameters)
    assert road is not None
    counts = np.zeros((2, 2))
    for k in range(8):
        frame = heavy_traffic(8, k)
        above = look(view, np.ascontiguousarray(frame.image[..., 2]))
        marks = marking_mask(view, above, detector.parameters) > 0
        kept = road(view, Picture(k, frame.image))
        paint, _, _ = labels(frame)
        size = (WIDE.width, WIDE.height)
        on_paint = look(view, cv2.resize(paint.astype(np.uint8) * 255, size)) > 127
        on_vehicle = look(view, frame.is_vehicle.astype(np.uint8) * 255) > 127
        for which, there in enumerate((marks & on_paint, on_vehicle)):
            counts[which] += there.sum(), (there & kept).sum()
    paint_kept, vehicle_kept = counts[:, 1] / counts[:, 0]
    # A last layer of 64 numbers sees most of a vehicle only.
    assert paint_kept > 0.85
    assert vehicle_kept < 0.6


def test_beside_lines_there_is_a_margin(top_hat: Path) -> None:
    """Nothing is lost where the network sees the lines, all is where it sees none."""
    pictures = drive(12)
    alone = lines_of("ml", {}, pictures)[-1]
    helped = lines_of("ml", {"on_road": str(top_hat)}, pictures)[-1]
    np.testing.assert_allclose(helped.offset_m, alone.offset_m, atol=0.03)
    assert (helped.is_continuous == alone.is_continuous).all()


@pytest.mark.parametrize("name", ["ml", "mc", "sl", "sc"])
def test_every_detector_of_ours_takes_a_network(name: str, tmp_path: Path) -> None:
    """One that sees the right half of the road only."""
    half = np.zeros((1, 1, 4, 8))
    half[..., 4:] = 1
    path = write_answer(tmp_path, half, layout="drivable", classes=1)
    detector = find_detector(name, {"on_road": str(path)}, Path.cwd(), "detector")
    camera = replace(CAMERA, baseline_m=0.4) if detector.is_stereo else CAMERA
    pictures = drive(4, stereo=detector.is_stereo)
    *_, (_, lines) = detect(detector, camera, pictures)
    assert len(lines.offset_m) >= 1
    assert (lines.offset_m > 0).all()


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


def test_a_network_of_the_command_line_is_found_from_where_one_stands(
    seen: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(seen / "nets")
    words = ["detect", "../drive.avi", "--camera", "../cam.yaml", "-o", tmp_path / "l.csv"]
    done = command(*words, "--detector", "network", "--set", "network=top_hat.yaml")
    assert "16 frames" in done.stdout
    chosen = "recording.detector_parameters.network=top_hat.yaml"
    experiment = load_experiment(seen / "seen.yaml", [chosen])
    assert experiment.recording.detector_parameters["network"] == str(
        seen / "nets" / "top_hat.yaml"
    )
    assert refused(*words, "--detector", "network") == (
        "parameters.network: is missing; it names the YAML file of a network, e.g."
        " network=lanes.yaml (docs/networks.md shows how to write one)"
    )
    assert "absent.yaml: no such file" in refused(
        *words, "--detector", "ml", "--set", "on_road=absent.yaml"
    )


def test_validate_finds_what_is_wrong_with_a_network(seen: Path, tmp_path: Path) -> None:
    assert "ok" in command("run", "--dry-run", seen / "seen.yaml").stdout
    for keys, said in (
        ({"layout": "lane"}, "layout: 'lane' is not one of"),
        ({"size": [64, 64]}, "but size [64, 64] makes 1 x 3 x 64 x 64"),
        ({"classes": 2}, "has 1 classes"),
    ):
        path = with_keys(seen / "nets" / "top_hat.yaml", tmp_path / "wrong.yaml", **keys)
        chosen = f"recording.detector_parameters.network={path}"
        assert said in refused("run", "--dry-run", seen / "seen.yaml", "--set", chosen)

"""A real network on real pictures, against the decoder that its authors published."""

from __future__ import annotations

import cv2
import numpy as np
import onnxruntime
import pytest

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.camera.model import image_to_road
from egolane_pgm.vision.camera.picture import Image
from makers.camera import lstr, tusimple
from makers.camera._labels import label_picture, label_places, read_labels

MEAN, SD = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])


def published(session: onnxruntime.InferenceSession, image: Image) -> list[FloatArray]:
    """The lines of a picture, pixels, by the numbers of LSTR's demo."""
    values = (cv2.resize(image, (640, 360)) / 255 - MEAN) / SD
    inputs = {"input_mask": np.zeros((1, 1, 360, 640), dtype=np.float32)}
    inputs["input_rgb"] = values.transpose(2, 0, 1)[None].astype(np.float32)
    scores, curves = session.run(["pred_logits", "pred_curves"], inputs)
    lines = []
    for score, (lower, upper, k, f, m, n, b, c) in zip(scores[0], curves[0], strict=True):
        if score[1] > score[0]:
            y = np.linspace(lower, upper, 100)
            x = k / (y - f) ** 2 + m / (y - f) + n + b * y - c
            lines.append(np.stack([x * image.shape[1], y * image.shape[0]], axis=1))
    return lines


def test_its_lines_are_those_of_the_published_decoder() -> None:
    """Recall and precision on 20 stills, which it was trained on, within a point of the decoder's,
    which had 97 and 98 % on others of that drive."""
    labels, onnx = tusimple.data_file(), lstr.data_file()
    if labels is None or onnx is None:
        pytest.skip(f"stills: needs EGOLANE_DATA with {tusimple.FILE} and {lstr.FILE}")
    which = slice(30, 50)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(onnx), options)
    camera, theirs = tusimple.CAMERA, []
    for frame in read_labels(labels)[which]:
        places = []
        for points in published(session, cv2.imread(str(label_picture(frame, labels)))):
            x, y = image_to_road(camera, *points.T)
            near = np.isfinite(x) & (x < 40)
            order = np.argsort(x[near])
            places.append(np.interp(tusimple.AHEAD_M, x[near][order], y[near][order]))
        label_m = label_places(camera, frame, tusimple.AHEAD_M)
        theirs.append(tusimple.Still(label_m, np.sort(places), np.ones(len(places))))
    ours = lstr.look_at(labels, which)
    wanted = tusimple.recall_precision(theirs, 0)
    assert min(wanted) > 0.96
    np.testing.assert_allclose(tusimple.recall_precision(ours, 0), wanted, atol=0.01)
    assert np.median(tusimple.errors_m(ours, 0)) < 0.06

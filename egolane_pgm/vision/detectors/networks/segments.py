"""Instance segmentation: a class and a mask for each line (YOLO, RF-DETR)."""

from __future__ import annotations

import cv2
import numpy as np
import scipy

from egolane_pgm.vision.detectors.networks.answers import Line, best_class
from egolane_pgm.vision.detectors.networks.description import Network
from egolane_pgm.vision.detectors.networks.masks import middle
from egolane_pgm.vision.detectors.networks.running import Outputs

#: Of boxes of one class that share more than this of their area, the most probable is kept.
_OVERLAP = 0.7

#: The least probability of a pixel of a mask.
_INSIDE = 0.5


def prototypes(network: Network, outputs: Outputs) -> list[Line]:
    """YOLO: each box has the coefficients of common masks. Boxes come as (4 + classes + masks,
    boxes), or, where the file ends in its own suppression, as (boxes, 6 + masks): corners,
    probability, class."""
    common = outputs["prototypes"]
    boxes = outputs["boxes"]
    n_masks = len(common)
    if boxes.shape[1] == 6 + n_masks:
        corners, share, kind = boxes[:, :4], boxes[:, 4], boxes[:, 5].astype(np.int64)
        kept = np.flatnonzero(share >= network.threshold)
    else:
        boxes = boxes.T
        share, kind = best_class(boxes[:, 4:-n_masks])
        at, size = boxes[:, :2], boxes[:, 2:4]
        corners = np.concatenate([at - size / 2, at + size / 2], axis=1)
        places = np.concatenate([at - size / 2, size], axis=1)
        found = cv2.dnn.NMSBoxesBatched(
            places.tolist(), share.tolist(), kind.tolist(), network.threshold, _OVERLAP
        )
        kept = np.array(found, dtype=np.int64).ravel()
    height, width = common.shape[1:]
    scale = np.tile([width, height], 2) / np.tile(network.size, 2)
    rows, columns = np.mgrid[:height, :width]
    lines = []
    for k in kept:
        left, upper, right, lower = corners[k] * scale
        inside = (columns >= left) & (columns < right) & (rows >= upper) & (rows < lower)
        seen = scipy.special.expit(np.tensordot(boxes[k, -n_masks:], common, axes=1)) * inside
        lines.append(Line(middle(network, seen, _INSIDE), share[k], int(kind[k])))
    return lines


def queries(network: Network, outputs: Outputs) -> list[Line]:
    """RF-DETR: each candidate has the logits of its classes and of its own mask."""
    share, kind = best_class(scipy.special.expit(outputs["scores"]))
    masks = scipy.special.expit(outputs["masks"])
    kept = np.flatnonzero(share >= network.threshold)
    return [Line(middle(network, masks[k], _INSIDE), share[k], int(kind[k])) for k in kept]

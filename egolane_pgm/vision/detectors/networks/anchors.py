"""A column for each row, and a row for each column: Ultra-Fast-Lane-Detection, both versions."""

from __future__ import annotations

import numpy as np
import scipy

from egolane_pgm.types import FloatArray
from egolane_pgm.vision.detectors.networks.answers import Line, points
from egolane_pgm.vision.detectors.networks.description import ROWS, Network
from egolane_pgm.vision.detectors.networks.running import Outputs

#: First and last row of the second version, shares of the picture's height (its utils/common.py).
_SHARES = {"tusimple": (160 / 720, 710 / 720), "culane": (0.42, 1.0)}

#: Of the second version's four lines, those beside the car are found in rows, the outer ones in
#: columns; the least share of anchors that see one (`pred2coords` of its demo.py).
_ANCHORS = (("row", (1, 2), 1 / 2), ("col", (0, 3), 1 / 4))


def row_anchors(network: Network, outputs: Outputs) -> list[Line]:
    """The expected column in each row where the likeliest class is not "no line" (equation 5 of the
    first paper). A column is as wide as the input over columns - 1."""
    output = outputs["columns"]
    n_columns = output.shape[0] - 1
    share = scipy.special.softmax(output[:-1], axis=0)
    column = np.tensordot(np.arange(n_columns), share, axes=1)
    u = (column + 0.5) * (network.size[0] - 1) / (n_columns - 1)
    is_there = output.argmax(axis=0) < n_columns
    likely = 1 - scipy.special.softmax(output, axis=0)[-1]
    rows = ROWS[network.rows] if isinstance(network.rows, str) else np.asarray(network.rows)
    return [
        Line(points(u[there, k], rows[there]), float(likely[there, k].mean()))
        for k, there in enumerate(is_there.T)
        if there.any()
    ]


def hybrid_anchors(network: Network, outputs: Outputs) -> list[Line]:
    """The cell of each anchor that sees a line, to a fraction by its neighbours (`pred2coords`)."""
    width, height = network.size

    def row_of(share: FloatArray) -> FloatArray:
        """Rows of the input, by shares of the picture's height."""
        return (share - network.cut_top) / (1 - network.cut_top) * height - 0.5

    lines = []
    for way, which, least in _ANCHORS:
        cells, exists = outputs[f"loc_{way}"], outputs[f"exist_{way}"]
        there = exists.argmax(axis=0) == 1
        at = _expected(cells) / (cells.shape[0] - 1)
        likely = scipy.special.softmax(exists, axis=0)[1]
        if way == "col":
            anchors = np.linspace(0, 1, cells.shape[1]) * width - 0.5
        elif isinstance(network.rows, str):
            anchors = row_of(np.linspace(*_SHARES[network.rows], cells.shape[1]))
        else:
            anchors = np.asarray(network.rows)
        for line in which:
            seen = there[:, line]
            if seen.sum() <= len(seen) * least:
                continue
            across, along = at[seen, line], anchors[seen]
            found = (
                points(across * width - 0.5, along)
                if way == "row"
                else points(along, row_of(across))
            )
            lines.append(Line(found, float(likely[seen, line].mean())))
    return lines


def _expected(cells: FloatArray) -> FloatArray:
    """The middle (anchors, lines) of the likeliest of the cells (K, anchors, lines) and its
    neighbours, weighted by what they are worth."""
    away = np.abs(np.arange(len(cells))[:, None, None] - cells.argmax(axis=0))
    share = scipy.special.softmax(np.where(away <= 1, cells, -np.inf), axis=0)
    return np.tensordot(np.arange(len(cells)), share, axes=1) + 0.5

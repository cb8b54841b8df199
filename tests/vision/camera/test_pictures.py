"""The order of pictures, and what they take of memory."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from egolane_pgm.vision.camera.pictures import images_of, open_source


def test_the_order_of_pictures_is_natural_and_their_id_the_number_that_counts(
    tmp_path: Path,
) -> None:
    blank = np.zeros((4, 4, 3), dtype=np.uint8)
    cases = {
        "a": (["cam2_img_9.png", "cam2_img_10.png", "cam2_img_100.png"], [9, 10, 100]),
        "b": (["000180_20.png", "000200_20.png"], [180, 200]),
        "c": (["left.png", "right.png"], [0, 1]),
        "d": (["1_5.png", "2_5.png", "3.png"], [0, 1, 2]),
        "e": (["7.png"], [0]),
        "f": (["a1²2.png", "a2²2.png"], [1, 2]),
    }
    for folder, (names, ids) in cases.items():
        (tmp_path / folder).mkdir()
        for name in reversed(names):
            cv2.imwrite(str(tmp_path / folder / name), blank)
        (tmp_path / folder / "notes.txt").write_text("no picture")
        source = open_source(tmp_path / folder)
        read = [(Path(file).name, k) for k, (file,), _ in images_of([source], None)]
        assert read == list(zip(names, ids, strict=True))

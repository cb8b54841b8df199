"""`python -m makers.camera.dashcam FILE.png`: a frame of a simulated drive with its belief.

The camera is calibrated from the pictures, as by `egolane run drive.mp4 --n-lanes 4`; the truth is
the simulation's.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import egolane_pgm as ego
from egolane_pgm.export.video_file import write_video
from egolane_pgm.verbs.simulate import simulate
from egolane_pgm.vision.camera.pictures import images_of, open_source
from egolane_pgm.vision.camera.writing import write_picture

PRESET = "a4"
N_LANES = 4

#: The frame that is shown, and the length of the drive.
SHOWN = 105
FRAMES = 120


def draw(file: Path) -> None:
    """Write the frame as a picture."""
    with TemporaryDirectory() as place:
        folder = Path(place)
        simulate(PRESET, out=folder, frames=FRAMES, images=True)
        result = ego.run(
            folder / "images",
            n_lanes=N_LANES,
            ground_truth=folder / "ground_truth.txt",
            overrides={"recording.frame_rate": 10},
        )
        write_video(folder / "a.mp4", result, (SHOWN, SHOWN))
        ((_, _, (image,)),) = images_of([open_source(folder / "a.mp4")], None)
        write_picture(file, image)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))

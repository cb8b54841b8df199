"""SL: two cameras, straight lines (paper, section `section:simple-line-detector`)."""

from __future__ import annotations

from functools import partial

from egolane_pgm.vision.detectors.simple import finder, stereo

STEREO = True
PARAMETERS = finder.PARAMETERS + stereo.PARAMETERS
start = partial(finder.start, curve="line", on_road=stereo.on_road)

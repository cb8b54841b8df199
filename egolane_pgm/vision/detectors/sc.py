"""SC: two cameras, clothoids (paper, section `section:simple-line-detector`)."""

from __future__ import annotations

from functools import partial

from egolane_pgm.vision.detectors.simple import finder, stereo

STEREO = True
PARAMETERS = finder.PARAMETERS + stereo.PARAMETERS
start = partial(finder.start, curve="clothoid", on_road=stereo.on_road)

"""MC: one camera, clothoids (paper, section `section:simple-line-detector`)."""

from __future__ import annotations

from functools import partial

from egolane_pgm.vision.detectors.simple import finder

STEREO = False
PARAMETERS = finder.MONO
start = partial(finder.start, curve="clothoid")

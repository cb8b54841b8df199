"""The parameters of Aly's detector, named as in its public configuration (`Lanes.conf`):
`lowerQuantile` there is `lower_quantile` here. Other values of that file are constants of the
modules that use them, or are left out: the Hough transform, stop lines, colours and lane widths are
off there; a spline is continued in the picture only, checked in the view only, and judged by its
score alone; the camera and metres replace the description of the view.

Lengths are pixels of the view (columns across, rows along the road) or of the picture made smaller.
The defaults have twice the resolution of the file in both: a view of 320 x 240 instead of 160 x 120
pixels, and a focal length of 618.8 instead of 309.4 pixels (the camera of the public
pictures); so lengths across are twice as long as there. The scores' unit is not known, and
so their thresholds are ours. These and the far edge, the widths of the filters, the distances at
which lines are merged, the largest angles and the largest moves of points were chosen on the first
55 stills of `tusimple_frames`, where the file's own values find few of the worn lines.
"""

from __future__ import annotations

from egolane_pgm.parameters import Parameter

PARAMETERS = (
    Parameter("side_m", "positive", 9.0, "half-width of the view, metres"),
    Parameter(
        "lower_quantile",
        "probability",
        0.975,
        "weaker ridges than this quantile are 0 (.985 for the two lines of the own lane only)",
    ),
    Parameter("detection_threshold", "non_negative", 0.1, "least score of a first line"),
    Parameter("lines", "integer", 4, "most lines per picture", lowest=1, highest=4),
)

"""The parts of Aly's detector: ridges from above, RANSAC lines and Bezier splines (`aly`).

Values of its public configuration (`Lanes.conf`) are constants of the modules that use them, or are
left out: the Hough transform, stop lines, colours and lane widths are off there; a spline is
continued in the picture only, checked in the view only, and judged by its score alone; the camera
and metres replace the description of the view.

Lengths are pixels of the view (columns across, rows along the road) or of the picture made smaller.
The constants have twice the resolution of the file in both: a view of 320 x 240 instead of
160 x 120 pixels, and a focal length of 618.8 instead of 309.4 pixels (the camera of the public
pictures); so lengths across are twice as long as there. The scores' unit is not known, and so their
thresholds are ours. These and the far edge, the widths of the filters, the distances at which lines
are merged, the largest angles and the largest moves of points were chosen on the first 55 stills of
`tusimple_frames`, where the file's own values find few of the worn lines.
"""

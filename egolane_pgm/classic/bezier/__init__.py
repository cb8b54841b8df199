"""The parts of Aly's detector: ridges from above, RANSAC lines and Bezier splines (`aly`)."""

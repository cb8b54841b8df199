"""The figures of a report: one function each, from results to a PNG, SVG or PDF file.

`network.draw_network` draws the graph itself.
"""

from egolane_pgm.report.comparison import draw_comparison
from egolane_pgm.report.coverage import draw_coverage
from egolane_pgm.report.dispersion import draw_bonus_ablation, draw_dispersion
from egolane_pgm.report.heatmaps import draw_confusion
from egolane_pgm.report.reliability import draw_reliability
from egolane_pgm.report.strips import draw_strips

__all__ = [
    "draw_bonus_ablation",
    "draw_comparison",
    "draw_confusion",
    "draw_coverage",
    "draw_dispersion",
    "draw_reliability",
    "draw_strips",
]

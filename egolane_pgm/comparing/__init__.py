"""Experiments side by side: `in_sample` puts several graphs on the paper's runs with its
parameters; `comparing` scores experiments on frames that their parameters have not seen."""

from egolane_pgm.comparing.in_sample import Compared, compare_graphs, compare_json, compare_rows

__all__ = ["Compared", "compare_graphs", "compare_json", "compare_rows"]

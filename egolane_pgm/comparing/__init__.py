"""Experiments side by side: `in_sample` puts several graphs on the paper's runs with its
parameters; `groups` scores experiments on frames that their parameters have not seen; `stored`
compares results that are there already."""

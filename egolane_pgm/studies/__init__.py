"""Studies: fit on some frames, infer and score the others.

`space` is the search space, `objective` scores parameters, `sampler` is a sampler of our own,
`search` runs Optuna studies and `storage` keeps them; `em` learns tables; `fits` are the ways to
fit, `study` is the engine.
"""

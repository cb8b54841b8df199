"""Parameter search: Optuna studies over what graph and evidence rule declare.

`plan` says what is tuned, `space` within which bounds, `objective` scores parameters, `study`
proposes and keeps trials (`evolution` is the sampler of our own), `storage` and `workers` keep them
on disk, `held_out` runs the search anew without each part of the drive, `tuning` does it all.
"""

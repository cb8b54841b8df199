"""Figures of `results/beyond/` that no command of the package gives; see `__main__`."""

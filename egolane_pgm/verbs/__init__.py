"""The verbs of the package, a documented function each: `ego.run` and `egolane run`.

The command line (`egolane_pgm.command`) is made from signatures and docstrings.
"""

"""The verbs of the package, a documented function each: `ego.run`, and `egolane run` made from it.

A verb's signature and docstring are its command line (`egolane_pgm.command`): what stands before
the `*` are arguments, what follows are options. A verb's file may have a function `says(done,
given)`: what the command prints at the end, in addition to the result's own `to_text`.
"""

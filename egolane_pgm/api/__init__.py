"""The verbs of the package as functions, `egolane_pgm.run` and so on, and what they return.

The commands of the same names call them and print. Every verb takes the command's options as
keyword arguments, and returns an object with `to_pandas`, `to_xarray`, `plot` and `save`, which a
notebook shows as a table.
"""

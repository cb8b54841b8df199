"""Lines that are polynomials in a table: y = c0 + c1 x + c2 x^2 + c3 x^3, a row for each frame.

    egolane run drive.csv --n-lanes 3 --set recording.format=examples/readers/polynomials.py

The table has time, left_c0 to left_c3, left_quality, and the same of the right line. A camera
behind the front axle sees where the line passes AHEAD_M in front of it. With y positive to the left
say `--columns left_positive=true` as well.
"""

import pandas as pd

AHEAD_M = 0.0


def read(path, *, frame_rate):
    """Each line AHEAD_M ahead; it is trusted from quality 2 on."""
    table = pd.read_csv(path)
    found = {"time_s": table["time"]}
    for number, side in enumerate(("left", "right"), start=1):
        found[f"offset_{number}"] = sum(table[f"{side}_c{k}"] * AHEAD_M**k for k in range(4))
        found[f"is_valid_{number}"] = table[f"{side}_quality"] >= 2
    return pd.DataFrame(found)

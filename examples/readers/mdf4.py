"""The lines in the channels of a measurement file (.mf4, .mdf).

    pip install asammdf
    egolane run drive.mf4 --n-lanes 3 --set recording.format=examples/readers/mdf4.py \
        --columns left_positive=true

LINES has the channels of each line, from left to right: its offset, and a quality from 0 to 3.
"""

import pandas as pd
from asammdf import MDF

LINES = [("Left_C0", "Left_Quality"), ("Right_C0", "Right_Quality")]


def read(path, *, frame_rate):
    """A frame is a sample of the first line's offset; other channels are interpolated there."""
    with MDF(path) as file:
        times = file.get(LINES[0][0]).timestamps
        table = {"time_s": file.header.start_time.timestamp() + times}
        for number, (offset, quality) in enumerate(LINES, start=1):
            table[f"offset_{number}"] = file.get(offset).interp(times).samples
            table[f"is_valid_{number}"] = file.get(quality).interp(times).samples >= 2
    return pd.DataFrame(table)

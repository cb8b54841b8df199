"""The left and the right line of a camera on CAN (.blf, .asc, .log, ...), such as Mobileye's.

    pip install cantools python-can
    egolane run drive.blf --n-lanes 3 --set recording.format=examples/readers/mobileye_can.py \
        --set recording.options.dbc=lanes.dbc

LINES has the signals of your .dbc, `message.signal`; those of a line may stand in several messages.
"""

import can
import cantools
import pandas as pd

LINES = [
    {"offset_m": "LEFT_A.Position", "quality": "LEFT_A.Quality", "type": "LEFT_B.Type"},
    {"offset_m": "RIGHT_A.Position", "quality": "RIGHT_A.Quality", "type": "RIGHT_B.Type"},
]


def read(path, *, frame_rate, dbc):
    """A frame is a message with the first line's offset; the others are those nearest in time."""
    # Many public .dbc files have a fault in a message that is not needed here.
    database, rows = cantools.database.load_file(dbc, strict=False), []
    messages = {message.frame_id: message for message in database.messages}
    with can.LogReader(path) as log:
        for frame in (frame for frame in log if frame.arbitration_id in messages):
            message = messages[frame.arbitration_id]
            values = message.decode(frame.data, decode_choices=False, allow_truncated=True)
            signals = {f"{message.name}.{name}": value for name, value in values.items()}
            rows.append({"time_s": frame.timestamp, **signals})
    table, lines = pd.DataFrame(rows), []
    for number, signals in enumerate(LINES, start=1):
        line = table.loc[table[LINES[0]["offset_m"]].notna(), ["time_s"]].assign(line=number)
        for ours, signal in signals.items():
            one = table[["time_s", signal]].dropna().rename(columns={signal: ours})
            line = pd.merge_asof(line, one, on="time_s", direction="nearest", tolerance=0.03)
        # Quality 2 and 3 are good; type 1 is solid, 3 a road edge, 4 a double line.
        good, solid = line.pop("quality") >= 2, line.pop("type").isin([1, 3, 4])
        lines.append(line.assign(is_valid=good & line["offset_m"].notna(), is_continuous=solid))
    return pd.concat(lines).sort_values(["time_s", "line"])

"""The lane lines of an openpilot log (rlog or qlog, also .zst or .bz2): modelV2, y at the camera.

    pip install pycapnp zstandard
    egolane run rlog.zst --n-lanes 3 --set recording.format=examples/readers/openpilot.py \
        --set recording.options.schema=openpilot/cereal/log.capnp

`schema` is that of a checkout of openpilot. Left lines have a negative y there, as here.
"""

import bz2

import capnp
import pandas as pd
import zstandard


def read(path, *, frame_rate, schema):
    """The four lines of each modelV2; a line counts from a probability of a half on."""
    known, raw = capnp.SchemaParser().load(str(schema)), path.read_bytes()
    if raw.startswith(b"BZh"):
        raw = bz2.decompress(raw)
    elif raw.startswith(b"\x28\xb5\x2f\xfd"):
        raw = zstandard.ZstdDecompressor().decompressobj().decompress(raw)
    rows = []
    for event in known.Event.read_multiple_bytes(raw):
        if event.which() != "modelV2":
            continue
        model = event.modelV2
        lines = zip(model.laneLines, model.laneLineProbs, strict=True)
        for number, (line, probability) in enumerate(lines, start=1):
            time_s = model.timestampEof / 1e9
            rows.append((model.frameId, time_s, number, line.y[0], probability > 0.5))
    return pd.DataFrame(rows, columns=["frame_id", "time_s", "line", "offset_m", "is_valid"])

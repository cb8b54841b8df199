"""The verb `inspect`."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from egolane_pgm.recordings.inspecting import look_into
from egolane_pgm.verbs.given import Mapped, Option, StrPath, path_of

EXAMPLES = ("egolane inspect drive.mcap", "egolane inspect drive.csv --lines left_positive=true")


def inspect(
    recording: StrPath,
    *,
    lines: Mapped = None,
    definitions: Annotated[StrPath | None, Option("FILE")] = None,
) -> dict[str, Any]:
    """Say what is in a recording, and the command that runs it.

    RECORDING is a table (.csv, .tsv, .parquet, .jsonl), a bag, an .mcap or a log of messages. Its
    topics and fields are listed with the span of their values. Which of them are lines, in which
    unit and of which sign, is a guess: the command spells it out, and nothing is guessed when it
    runs.

    - lines: look through this mapping in place of a guess: the name of a preset, key=value, or a
      YAML file with such keys.
    - definitions: what defines the messages of a log: a .dbc, openpilot's log.capnp.

    Returns the same as a dict. Raises InputError, one line, for a file that cannot be read.
    """
    said = None if definitions is None else path_of(definitions, "definitions")
    found = look_into(Path(path_of(recording, "recording")), lines, said)
    if found["lines"] is not None:
        options = "".join(f" --lines {shlex.quote(each)}" for each in _written(found["lines"]))
        if said is not None:
            options += f" --definitions {shlex.quote(said)}"
        found["command"] = f"egolane run {shlex.quote(found['file'])} --n-lanes N{options}"
    return found


def _written(keys: Mapping[str, Any]) -> list[str]:
    """The keys of a mapping as `key=value`."""
    found = []
    for key, value in keys.items():
        if isinstance(value, (list, tuple)):
            value = f"[{', '.join(map(str, value))}]"
        elif isinstance(value, bool):
            value = str(value).lower()
        found.append(str(value) if key == "preset" else f"{key}={value}")
    return found


def says(done: Mapping[str, Any], given: Mapping[str, Any]) -> str:
    """What is in the recording, as text."""
    text = []
    for topic in done["topics"]:
        count = "" if topic["messages"] is None else f", {topic['messages']} rows"
        text.append(f"{topic['topic'] or done['file']} ({topic['type']}{count})")
        for field in topic["fields"]:
            span = ", ".join(field["texts"])
            if field["low"] is not None:
                span = " to ".join(
                    str(v) if isinstance(v, int) else f"{v:.6g}"
                    for v in (field["low"], field["high"])
                )
            text.append(f"  {field['path']:<32} {field['type']:<10} {span}".rstrip())
    if done["lines"] is None:
        text += ["", f"no lines found: {done['problem']}"]
        return "\n".join([*text, "docs/howto/sensors.md shows how to say which fields they are"])
    low, high = done["offset_m"] or (float("nan"),) * 2
    rate = "unknown" if done["frame_rate"] is None else f"{done['frame_rate']:g} per second"
    gaps = f"gaps: {done['gaps']}"
    if done["gaps"]:
        longest, after = done["longest_gap_s"], done["longest_gap_after_frame"]
        gaps += f", the longest {longest:g} s after frame {after}"
    text += [
        "",
        f"frames: {done['frames']}, {rate}; {gaps}",
        f"lines: {done['lines_per_frame']:.1f} valid per frame, {low:.2f} m (left) to {high:.2f} m",
        f"sign: the command takes negative for left; {done['sign']}",
        "",
        "to run it (N: how many lanes the road has):",
        f"  {done['command']}",
    ]
    return "\n".join(text)

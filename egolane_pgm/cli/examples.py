"""Examples of every command, which its `--help` shows and the tests run."""

from __future__ import annotations

EXAMPLES = {
    "calibrate": (
        "egolane calibrate --stills drive.mp4 --lane-width 3.7 -o cam.yaml",
        "egolane calibrate --chessboards 'boards/*.jpg' --stills 'road/*.jpg' --lane-width 3.7"
        " -o cam.yaml",
    ),
    "compare": (
        "egolane compare experiments/quickstart.yaml --graphs sensor_failure,lane_only",
        "egolane compare experiments/zero_label.yaml --runs 1-10 --with-paper --wide > table.md",
    ),
    "convert": ("egolane convert drive/lines.csv lines.parquet",),
    "data": ("egolane data fetch",),
    "detect": (
        "egolane detect drive.mp4 --camera cam.yaml --detector ml -o lines.parquet",
        "egolane detect 'left/*.jpg' --right 'right/*.jpg' --camera cam.yaml --detector sl"
        " -o lines.csv",
    ),
    "export": ("egolane export results/quickstart drive.mcap",),
    "label": ("egolane label drive/lines.csv --n-lanes 4 --out labels",),
    "learn": (
        "egolane learn drive/experiment.yaml --out learned.yaml",
        "egolane learn experiments/quickstart.yaml --fleet drives.csv --by-tag weather",
    ),
    "lines": ("egolane lines drive/lines.csv --frame 7",),
    "locate": ("egolane locate lanes.parquet drive.gpx -o road.parquet",),
    "ls": ("egolane ls",),
    "map": ("egolane map roads.osm.pbf -o lanes.parquet --plot lanes.png",),
    "network": ("egolane network sensor_failure graph.svg",),
    "online": ("egolane online experiments/quickstart.yaml < lines.jsonl",),
    "plot": ("egolane plot results/quickstart --frames 0 400 --style pdf",),
    "reproduce": (
        "egolane reproduce --runs 1-5",
        "egolane reproduce --format latex > table.tex",
    ),
    "report": (
        "egolane report results/quickstart",
        "egolane report results/quickstart results/hard -o both.html",
    ),
    "run": (
        "egolane run experiments/quickstart.yaml --set parameters.sigma1=0.3",
        "egolane run experiments/zero_label.yaml --recording drive/lines.csv --n-lanes 4"
        " --out mine",
        "egolane run experiments/zero_label.yaml --recording drive/lines.csv --n-lanes 4 --stream",
    ),
    "schema": ("egolane schema",),
    "show": (
        "egolane show sensor_failure --tables",
        "egolane show detector:ml --json -",
    ),
    "simulate": (
        "egolane simulate a4 --out drive --frames 600",
        "egolane simulate a4 --images --frames 100 --out pictures",
    ),
    "tune": (
        "egolane tune drive/experiment.yaml --trials 300",
        "egolane tune experiments/quickstart.yaml -p sigma1=[0.1,0.5] --sampler tpe --workers 2",
        "egolane tune experiments/quickstart.yaml --fleet drives.csv --by-tag weather",
    ),
    "validate": ("egolane validate drive/experiment.yaml experiments/zero_label.yaml",),
    "video": ("egolane video drive.mp4 --camera cam.yaml --detector ml --n-lanes 4 -o out.mp4",),
}

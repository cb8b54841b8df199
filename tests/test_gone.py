"""Docs, README, results, help and schemas do not speak of what version 0.1 had and 0.2 has not."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from egolane_pgm.command import COMMANDS

ROOT = Path(__file__).parents[1]

#: Commands that left. What they did is part of `show`, `plot`, `locate` or `run --dry-run`.
VERBS = (
    *("benchmark", "convert", "export", "inspect", "lines", "ls", "map", "network"),
    *("network-check", "report", "schema", "validate", "video"),
)

#: What left, by the part of the package that had it.
GONE = {
    "commands": rf"egolane (?:{'|'.join(VERBS)})\b(?!\.|=)",
    "functions": r"\bego\.(?:convert|export|inspect|network|report|validate|video)\(",
    "compare": r"--(?:lags|health|seeds|with-paper|trials-per-number|graphs|together)\b",
    "tune": r"--(?:test-on|whole-recordings|from-scratch|in-sample-only|workers)\b|^pictures: ",
    "runs of compare and tune": r"egolane (?:compare|tune) [^`|#]*--runs\b",
    "run": r"--(?:fleet|recording|stream)(?![\w.-])|(?i:\bfleets?\b)",
    "containers": r"\b(?:LaneTruth|LaneEvents|DriveTable|Believed|prepare_model|with_recording)\b",
    "results": r"\bclips\.csv\b|\b(?:told_time_s|place_in_lane)\b|`Lane=1`",
    "to_pandas of a result": r"\b(?:run|result|tuned|compared|beliefs = run)\.to_pandas\(",
    "evidence": r"(?i)\bjeffrey\b",
    "number of lanes": r"\blane_count\b",
    "formats of labels": r"\bformat: (?:cu|open)lane\b|(?:labels|folders) of (?:CULane|OpenLane)\b",
    "viewers": r"(?i)\brerun(?:-sdk|\.io|\b(?= file))|--layouts?\b",
    "extras": r"egolane-pgm\[(?:benchmark|can|openpilot|rerun)\b",
    "recordings": r"recording\.lines\b|--lines\b|--definitions\b|--preset\b",
    "layouts of networks": r"layout: (?:queries|polynomials|beziers|road_lines)\b|\broad_lines:",
    "calibration": r"(?i)\bwatermarks?\b|calibrate [^`]*--labels\b",
    "detectors": r"\b(?:frozen_\w+|blur_\w+)\b",
    "stored maps": r"\bload_map\b|locate \S+\.parquet",
    "rendering": r"(?i)\brendered (?:motorway|road|drive|picture)s?\b|makers\.camera rendered",
}


def texts() -> Iterator[tuple[str, str]]:
    """Name and text of each page, schema and help that a user reads."""
    files = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md", "paper.md")]
    files += sorted((ROOT / "docs").rglob("*.md")) + sorted((ROOT / "results").glob("*/*.md"))
    files += [*sorted((ROOT / "experiments").glob("*.json")), ROOT / "tests/verbs/help.txt"]
    files += sorted((ROOT / "notebooks").glob("*.ipynb"))
    for file in files:
        yield file.relative_to(ROOT).as_posix(), file.read_text()


@pytest.mark.parametrize("pattern", GONE.values(), ids=GONE)
def test_no_page_or_help_speaks_of_what_left(pattern: str) -> None:
    found = [
        f"{name}: {line.strip()[:160]}"
        for name, text in texts()
        for line in text.splitlines()
        if re.search(pattern, line)
    ]
    assert not found, "\n".join(found)


def test_each_pattern_finds_what_it_is_for() -> None:
    examples = (
        *("egolane validate x.yaml", "ego.report(run)", "--lags 0,1", "tune --test-on x.yaml"),
        *("mode: jeffrey", "lane_count.py", "labels of CULane", "rerun file", "recording.lines"),
        *("egolane-pgm[can]", "layout: beziers", "a watermark", "blur_limit", "rendered roads"),
        *(
            "--fleet drives.csv",
            "a fleet",
            "run x.yaml --recording l.csv",
            "--graphs a,b",
            "--workers 4",
        ),
        *("egolane tune X.yaml --runs 1-10", "LaneTruth", "clips.csv", "place_in_lane"),
        *("run.to_pandas()", "--together", "told_time_s"),
    )
    for example in examples:
        assert any(re.search(pattern, example) for pattern in GONE.values()), example


def test_the_commands_that_left_are_no_commands() -> None:
    assert not set(VERBS) & set(COMMANDS)

"""Lines with and without (`shadow_share: 0`) the search for vehicles, whose edges look like lines:
the first 55 stills of `tusimple`."""

from __future__ import annotations

from makers.camera import tusimple

_WAYS = (("vehicles not looked for", {"shadow_share": 0.0}), ("vehicles looked for", {}))


def measure() -> list[str]:
    """The page's section as Markdown; one line if the data are absent."""
    labels = tusimple.data_file()
    if labels is None:
        return [f"Phantom lines: {tusimple.FILE} is absent (EGOLANE_DATA)."]
    first = slice(0, tusimple.HALF)
    lines = [
        "### Lines that vehicles make",
        "",
        "The first 55 stills (in-sample), as in `tusimple`.",
        "",
        "| fitted | vehicles | recall | precision |",
        "|---|---|---|---|",
    ]
    for curve in ("clothoid", "line"):
        for name, given in _WAYS:
            stills = tusimple.look_at(labels, first, curve=curve, **given)
            recall, precision = tusimple.recall_precision(stills, tusimple.least_score())
            lines.append(f"| {curve}s | {name} | {recall:.1%} | {precision:.1%} |")
    return lines

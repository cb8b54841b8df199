"""The console script `egolane`: Ctrl-C ends it with one line and exit code 130."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command `egolane`."""
    try:
        from egolane_pgm.cli.main import egolane

        egolane(prog_name="egolane")
    except KeyboardInterrupt:
        # While this was imported: from there on the command catches it itself.
        sys.stderr.write("egolane: interrupted; the same command begins anew\n")
        sys.exit(130)

"""Commands in processes of their own."""

from __future__ import annotations

import sys

import pytest

EGOLANE = [sys.executable, "-c", "from egolane_pgm.cli.main import main; main()"]


needs_links = pytest.mark.skipif(sys.platform == "win32", reason="needs links and signals")

"""Versions of packages, and the commit of this checkout."""

from __future__ import annotations

import functools
import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

#: Packages that results depend on.
PACKAGES = (
    "egolane-pgm",
    "numpy",
    "scipy",
    "numba",
    "opencv-python-headless",
    "pgmpy",
    "optuna",
    "cmaes",
    "rosbags",
    "pyarrow",
)


@functools.cache
def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that results depend on."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


@functools.cache
def git_state() -> dict[str, Any] | None:
    """Return commit and whether the checkout is dirty; None for an installed package."""
    folder = Path(__file__).parent

    def git(*words: str) -> str | None:
        try:
            done = subprocess.run(
                ["git", "-C", str(folder), *words], capture_output=True, text=True, timeout=10
            )
        except (OSError, subprocess.SubprocessError):
            return None
        return done.stdout.strip() if done.returncode == 0 else None

    # An installed package may lie in another project's checkout.
    if git("ls-files", "--error-unmatch", Path(__file__).name) is None:
        return None
    commit, status = git("rev-parse", "HEAD"), git("status", "--porcelain")
    return {"commit": commit, "dirty": bool(status)} if commit else None

"""`python -m tests.benchmarks [--output FILE] [--rounds N]`: one Markdown table of medians.

Everything but the commands is measured in one process on one thread, the contestants of a row
taking turns, after each was called once (so compilation is left out). A ratio is their median time
over ours. The recording is the paper's run 1 if EGOLANE_DATA has it, else a simulated drive.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    parser.add_argument("--output", type=Path, help="write the table to this file as well")
    parser.add_argument("--rounds", type=int, default=40, help="turns per contestant (default 40)")
    options = parser.parse_args()
    # Before numpy and jax are imported, which read it once.
    for name in ("OMP", "MKL", "OPENBLAS", "NUMEXPR"):
        os.environ[f"{name}_NUM_THREADS"] = "1"
    os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    from tests.benchmarks.suite import run_all

    text = run_all(options.rounds)
    if options.output:
        options.output.write_text(text, encoding="utf-8")


main()

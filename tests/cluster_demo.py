"""`make cluster-demo`: four workers on a PostgreSQL server of their own, one of them killed.

The server lies in a temporary directory, listens on a free port of the loopback, asks for a
password that is made up for it, and is gone at the end.
"""

from __future__ import annotations

import os
import random
import secrets
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.kits.postgres_server import Server, find_binaries

EXPERIMENT = Path(__file__).parents[1] / "experiments" / "quickstart.yaml"
TRIALS, WORKERS, USER = 2000, 4, "demo"


def main() -> int:
    if find_binaries() is None:
        print("PostgreSQL is not installed (Debian: apt-get install postgresql)", file=sys.stderr)
        return 1
    password = secrets.token_urlsafe(12)
    with Server({USER: password}) as server, tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "pgpass")
        file.touch(0o600)
        file.write_text(f"*:*:*:{USER}:{password}\n")
        url = server.new_database("demo").replace("egolane@", f"{USER}@")
        print(f"server: {url}, in {server.folder}")
        return _study(server, ["--storage", url, "--password-file", str(file)], folder)


def _study(server: Server, storage: list[str], folder: str) -> int:
    egolane = [sys.executable, "-c", "from egolane_pgm.cli.main import main; main()"]
    words = ["tune", str(EXPERIMENT), "--trials", str(TRIALS), "--workers", str(WORKERS)]
    words += ["--in-sample-only", "--no-figures", "--grace", "3", "--out", folder]
    print(f"study:  egolane tune quickstart.yaml --trials {TRIALS} --workers {WORKERS}")
    with subprocess.Popen([*egolane, *words, *storage], stdout=subprocess.DEVNULL) as study:
        workers = _claiming(server, study)
        if not workers:
            print("the study was over before a worker could be killed", file=sys.stderr)
            return 1
        victim = random.choice(workers)
        os.kill(victim, signal.SIGKILL)
        print(f"killed: worker {victim}, one of {len(workers)}")
        subprocess.run([*egolane, "studies", *storage], check=True)
    if study.returncode:
        return study.returncode
    subprocess.run([*egolane, "studies", *storage], check=True)
    print("\nthe account, counted from the trials themselves:")
    done = subprocess.run([*egolane, "tune", "--join", "quickstart", *storage])
    return done.returncode


def _claiming(server: Server, study: subprocess.Popen[bytes]) -> list[int]:
    """The workers, once all of them are at it."""
    import psycopg

    children = Path(f"/proc/{study.pid}/task/{study.pid}/children")
    while study.poll() is None:
        time.sleep(0.02)
        try:
            rows = server.execute(
                "SELECT pid FROM egolane_workers w WHERE EXISTS (SELECT 1 FROM egolane_claims c"
                " WHERE c.worker = w.worker)",
                "demo",
            )
        except psycopg.Error:
            continue  # The tables are not there yet.
        if len(rows) == WORKERS and children.exists():
            return [pid for (pid,) in rows]
    return []


if __name__ == "__main__":
    sys.exit(main())

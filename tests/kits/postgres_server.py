"""A PostgreSQL server of one's own: in a temporary directory, on a free port of the loopback, gone
when it is let go. And a network between it and its clients that can be cut."""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import pwd
import selectors
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

HOST = "127.0.0.1"

#: What makes a server quick that nobody would miss.
THROWAWAY = ("fsync=off", "full_page_writes=off", "max_connections=60", "shared_buffers=32MB")


def find_binaries() -> Path | None:
    """The folder of initdb and postgres, the newest there is; None without the package."""
    found = [Path(p).parent for p in [shutil.which("initdb")] if p]
    found += sorted(
        (path.parent for path in Path("/usr/lib/postgresql").glob("*/bin/initdb")),
        key=lambda path: float(path.parts[-2]),
        reverse=True,
    )
    return next((path for path in found if (path / "postgres").exists()), None)


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def memory() -> Path | None:
    """A folder in memory, where there is one with room: thousands of small files come and go."""
    folder = Path("/dev/shm")
    is_there = folder.is_dir() and os.access(folder, os.W_OK)
    return folder if is_there and shutil.disk_usage(folder).free > 1 << 30 else None


class Server:
    """A server; its superuser is `egolane`, who needs no password from here unless one is given.

    guarded: users and passwords that are asked for. options: settings, `name=value`. folder: where
    its own is made, by default where temporary files are.
    """

    def __init__(
        self,
        guarded: dict[str, str] | None = None,
        options: Sequence[str] = THROWAWAY,
        folder: Path | None = None,
    ) -> None:
        binaries = find_binaries()
        assert binaries is not None
        self.binaries, self.options = binaries, options
        self.port = free_port()
        self.process: subprocess.Popen[bytes] | None = None
        self.folder = Path(tempfile.mkdtemp(prefix="egolane-postgres-", dir=folder))
        try:
            self._prepare(guarded or {})
        except BaseException:
            self.close()
            raise

    def _prepare(self, guarded: dict[str, str]) -> None:
        # The server refuses to be run by root.
        self.owner: dict[str, Any] = {}
        if os.geteuid() == 0:
            names = {entry.pw_name for entry in pwd.getpwall()}
            user = pwd.getpwnam("postgres" if "postgres" in names else "nobody")
            os.chown(self.folder, user.pw_uid, user.pw_gid)
            self.owner = {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}
        words = ["-U", "egolane", "-A", "trust", "-E", "UTF8", "--locale=C", "--no-sync"]
        self._run("initdb", "-D", str(self.folder / "data"), *words)
        lines = [f"host all {user} {HOST}/32 scram-sha-256" for user in guarded]
        lines.append(f"host all all {HOST}/32 trust")
        (self.folder / "data" / "pg_hba.conf").write_text("\n".join(lines) + "\n")
        self.start()
        for user, password in guarded.items():
            from psycopg import sql

            self.execute(
                sql.SQL("CREATE ROLE {} LOGIN SUPERUSER PASSWORD {}").format(
                    sql.Identifier(user), sql.Literal(password)
                )
            )

    def _run(self, program: str, *words: str) -> None:
        done = subprocess.run(
            [str(self.binaries / program), *words],
            cwd=self.folder,
            capture_output=True,
            text=True,
            **self.owner,
        )
        if done.returncode:
            raise RuntimeError(f"{program}: {done.stderr.strip()}")

    def start(self) -> None:
        """Start it, and wait until it answers."""
        import psycopg

        words = [f"port={self.port}", f"listen_addresses={HOST}", "unix_socket_directories="]
        settings = [word for option in (*words, *self.options) for word in ("-c", option)]
        with (self.folder / "log").open("ab") as log:
            self.process = subprocess.Popen(
                [str(self.binaries / "postgres"), "-D", str(self.folder / "data"), *settings],
                cwd=self.folder,
                stdout=log,
                stderr=log,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
                preexec_fn=_end_with_parent,
                **self.owner,
            )
        deadline = time.monotonic() + 30
        while True:
            try:
                self.execute("SELECT 1")
                return
            except psycopg.OperationalError as error:
                if time.monotonic() > deadline or self.process.poll() is not None:
                    text = (self.folder / "log").read_text(errors="replace")
                    raise RuntimeError(f"PostgreSQL does not start: {text[-2000:]}") from error
                time.sleep(0.02)

    def stop(self, how: int = signal.SIGINT) -> None:
        """Stop it: SIGINT sends its clients away, SIGQUIT drops everything at once."""
        if self.process is not None:
            self.process.send_signal(how)
            try:
                self.process.wait(20)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
            self.process = None

    def close(self) -> None:
        """Stop it, and leave nothing behind."""
        self.stop(signal.SIGQUIT)
        shutil.rmtree(self.folder, ignore_errors=True)

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def url(
        self, database: str = "postgres", user: str = "egolane", port: int | None = None
    ) -> str:
        """The address of a database, without a password."""
        return f"postgresql+psycopg://{user}@{HOST}:{port or self.port}/{database}"

    def execute(self, query: Any, database: str = "postgres", values: Any = None) -> list[Any]:
        """The rows of a query, done as superuser."""
        import psycopg

        with psycopg.connect(
            host=HOST, port=self.port, user="egolane", dbname=database, autocommit=True
        ) as connection:
            cursor = connection.execute(query, values)
            return cursor.fetchall() if cursor.description else []

    def new_database(self, name: str) -> str:
        """An empty database; returns its address."""
        self.execute(f'CREATE DATABASE "{name}"')
        return self.url(name)


def _end_with_parent() -> None:
    """Have the kernel stop the server when whoever started it is killed (Linux)."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(1, signal.SIGINT)


class Network:
    """A way to the server that can be cut: connections stay open, but nothing gets through."""

    def __init__(self, port: int) -> None:
        context = multiprocessing.get_context("fork")
        self.listener = socket.create_server((HOST, 0))
        self.port = int(self.listener.getsockname()[1])
        self.is_cut: Any = context.Event()
        self.process = context.Process(target=_forward, args=(self.listener, port, self.is_cut))
        self.process.daemon = True
        self.process.start()
        self.listener.close()

    def close(self) -> None:
        """Let everybody go."""
        self.process.kill()
        self.process.join()


@contextlib.contextmanager
def network(port: int) -> Iterator[Network]:
    """A way to a port, for as long as it is needed."""
    made = Network(port)
    try:
        yield made
    finally:
        made.close()


def _forward(listener: socket.socket, port: int, is_cut: Any) -> None:
    """Carry bytes both ways; after a cut, what was on its way is lost and its connection ends."""
    waiting = selectors.DefaultSelector()
    waiting.register(listener, selectors.EVENT_READ)
    peers: dict[socket.socket, socket.socket] = {}
    stale: set[socket.socket] = set()

    def drop(end: socket.socket) -> None:
        for other in (end, peers.get(end)):
            if other is not None and other in peers:
                del peers[other]
                waiting.unregister(other)
                other.close()

    while True:
        if is_cut.is_set():
            stale |= set(peers)
            time.sleep(0.01)
            continue
        for end in list(stale):
            if end in peers:
                drop(end)
        stale.clear()
        for key, _ in waiting.select(0.02):
            source: Any = key.fileobj
            if source is listener:
                client = listener.accept()[0]
                peers[client] = socket.create_connection((HOST, port))
                peers[peers[client]] = client
                for end in (client, peers[client]):
                    waiting.register(end, selectors.EVENT_READ)
            elif source in peers:
                try:
                    data = source.recv(65536)
                    if data:
                        peers[source].sendall(data)
                        continue
                except OSError:
                    pass
                drop(source)

"""One connection to a PostgreSQL server that may go away and come back.

What is done through it is one transaction, and is done again on a new connection where the old one
broke: it must come to the same whether the lost one was committed or not.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

from egolane_pgm.tune.address import Address
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    import psycopg

Result = TypeVar("Result")

#: Seconds that one answer of the server may take, at most.
ANSWER_S = 15.0

#: Seconds that a worker waits for a server that went away before it gives up.
PATIENCE_S = 600.0


#: Ends sessions of ours whose client went away inside of a transaction, with its locks. The
#: server's own timeout for this sees neither a client that was cut off between the statements of
#: a pipeline nor, in PostgreSQL 15, one that was cut off after it.
_END_STUCK = """
SELECT pg_terminate_backend(pid) FROM pg_stat_activity
WHERE datname = current_database() AND usename = current_user AND application_name = %s
    AND wait_event = 'ClientRead' AND pid <> pg_backend_pid()
    AND xact_start < clock_timestamp() - make_interval(secs => %s)
"""

#: How our sessions are called.
APPLICATION = "egolane"


class Link:
    """A connection by need. answer_s: how long an answer may take, on both sides: who hears nothing
    for so long inside of a transaction is ended by the server, or by the next who waits for it."""

    def __init__(
        self, address: Address, answer_s: float = ANSWER_S, patience_s: float | None = None
    ) -> None:
        self.address = address
        self.answer_s = min(answer_s, ANSWER_S)
        self.patience_s = PATIENCE_S if patience_s is None else patience_s
        self.last_used = time.monotonic()
        #: Asked while the server is away: whether to go on trying.
        self.goes_on: Callable[[], bool] = lambda: True
        self._lock = threading.Lock()
        self._connection: psycopg.Connection[Any] | None = None

    def once(self, work: Callable[[psycopg.Connection[Any]], Result]) -> Result:
        """Do something in one transaction. Raises InputError where that fails."""
        psycopg = need_psycopg()
        try:
            return self._attempt(work)
        except psycopg.Error as error:
            raise explained(self.address, error) from None

    def steady(self, work: Callable[[psycopg.Connection[Any]], Result]) -> Result:
        """Do something in one transaction, again and again while the server is away. Raises
        InputError where it fails for another reason, or the server stays away."""
        psycopg = need_psycopg()
        deadline, pause = 0.0, 0.05
        while True:
            try:
                return self._attempt(work)
            except (psycopg.OperationalError, psycopg.InterfaceError) as error:
                now = time.monotonic()
                deadline = deadline or now + self.patience_s
                if now > deadline or not self.goes_on():
                    raise explained(
                        self.address,
                        error,
                        f"tried for {self.patience_s:g} s; finished trials are kept, repeat the"
                        " command when it is back",
                    ) from None
                if isinstance(error, psycopg.errors.LockNotAvailable):
                    self.beat(lambda c: c.execute(_END_STUCK, [APPLICATION, self.answer_s]))
                time.sleep(pause)
                pause = min(2 * pause, 2.0)
            except psycopg.Error as error:
                raise explained(self.address, error) from None

    def beat(self, work: Callable[[psycopg.Connection[Any]], Result]) -> None:
        """As `once`, from another thread: not where the connection is in use, and in silence
        where it fails, which whoever uses it next will notice."""
        if self._lock.acquire(blocking=False):
            try:
                with contextlib.suppress(need_psycopg().Error):
                    self._within(work)
            finally:
                self._lock.release()

    def close(self) -> None:
        """Let go of the connection."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _attempt(self, work: Callable[[psycopg.Connection[Any]], Result]) -> Result:
        with self._lock:
            return self._within(work)

    def _within(self, work: Callable[[psycopg.Connection[Any]], Result]) -> Result:
        if self._connection is None:
            self._connection = connect(self.address, self.answer_s)
        try:
            found = work(self._connection)
        except BaseException:
            # Whatever state it is in: a transaction that was begun ends with its connection.
            self.close()
            raise
        self.last_used = time.monotonic()
        return found


def connect(address: Address, answer_s: float = ANSWER_S) -> psycopg.Connection[Any]:
    """A connection in autocommit, whose every wait for the server ends in time. Raises what
    psycopg raises; InputError where psycopg is not installed."""
    need_psycopg()
    import psycopg

    class Timed(psycopg.Connection[Any]):
        def wait(self, gen: Any, interval: float = 0.1, timeout: float | None = None) -> Any:
            limit = answer_s if timeout is None else timeout
            try:
                return super().wait(gen, interval, limit)
            except psycopg.OperationalError as error:
                if type(error).__name__ != "_WaitTimeout":
                    raise
                self.pgconn.finish()
                raise psycopg.OperationalError(f"no answer within {limit:g} s") from None

    # The server is to say what took too long before the client loses its patience.
    limits = {"lock_timeout": 0.5, "statement_timeout": 0.8}
    limits |= {"idle_in_transaction_session_timeout": 1.0, "idle_session_timeout": 0.0}
    options = " ".join(f"-c {name}={int(1000 * k * answer_s)}" for name, k in limits.items())
    given = {
        "connect_timeout": max(2, int(answer_s)),
        **address.parameters,
        "application_name": APPLICATION,
        "options": f"{address.parameters.get('options', '')} {options}".strip(),
    }
    return Timed.connect(**given, autocommit=True)


def need_psycopg() -> Any:
    """The module psycopg. Raises InputError where it is not installed."""
    try:
        import psycopg
    except ImportError as error:
        raise InputError(
            f"--storage: needs psycopg ({error}); pip install 'egolane-pgm[postgres]'"
        ) from None
    return psycopg


def explained(address: Address, error: BaseException, advice: str = "") -> InputError:
    """What a database complains about as one line that names the storage."""
    psycopg = need_psycopg()
    text = address.hide(error) or type(error).__name__
    if isinstance(error, psycopg.OperationalError) and not advice:
        lower = text.lower()
        if "password" in lower or "authentication" in lower or "no pg_hba" in lower:
            advice = "check user and password (the address, ~/.pgpass, PGPASSFILE, --password-file)"
        elif "does not exist" in lower:
            advice = "create it (createdb, createuser), or check the address"
        else:
            advice = "check the address, and that the server runs and can be reached from here"
    elif isinstance(error, psycopg.errors.InsufficientPrivilege):
        advice = "grant the user CREATE on the schema, or name another user"
    return InputError(f"storage {address.shown}: {text}" + (f"; {advice}" if advice else ""))

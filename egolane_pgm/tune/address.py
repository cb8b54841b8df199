"""The address of a PostgreSQL database that keeps studies, whose password is never shown.

The address comes from an option or the environment, the password from the address, from libpq's
own places (PGPASSWORD, PGPASSFILE, ~/.pgpass) or from a file in libpq's format.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote, quote_plus

from egolane_pgm.types import InputError

#: The environment variable that names the storage where no option does.
ENVIRONMENT = "EGOLANE_STORAGE"

EXAMPLE = "postgresql+psycopg://user@host/database"

#: What stands for a password.
MASK = "***"

#: Names of options in an address whose values are passwords.
_SECRET = r"(?!passfile)\w*pass\w*"


@dataclass(frozen=True)
class Address:
    """shown: the address without its password, for every message. parameters: what libpq is
    given. secrets: the password in every form that it could be met in, longest first."""

    shown: str
    parameters: dict[str, Any] = field(repr=False)
    secrets: tuple[str, ...] = field(repr=False, default=())

    def hide(self, text: object) -> str:
        """A text, on one line, without the password."""
        found = " ".join(str(text).split())
        for secret in self.secrets:
            found = found.replace(secret, MASK)
        return found

    def engine_options(self) -> tuple[str, dict[str, Any]]:
        """For SQLAlchemy: a URL that says nothing, and what its engine is made with."""
        return "postgresql+psycopg://", {"connect_args": dict(self.parameters)}


def find_address(given: str | None, password_file: str | None = None) -> Address:
    """The address that an option gives, or else the environment.

    Raises InputError, without any password, for one that cannot be read, a database that is not
    PostgreSQL, no address at all, a password file that libpq would not take.
    """
    text = given or os.environ.get(ENVIRONMENT, "")
    where = "--storage" if given else ENVIRONMENT
    if not text:
        raise InputError(f"--storage: is missing; name {EXAMPLE}, here or in {ENVIRONMENT}")
    address = parse(text, where)
    if password_file is not None:
        address.parameters["passfile"] = str(_checked(Path(password_file)))
    return address


def parse(text: str, where: str = "--storage") -> Address:
    """The address of a URL; errors as `find_address`."""
    from sqlalchemy.engine import make_url
    from sqlalchemy.exc import ArgumentError

    try:
        url = make_url(text)
        database = url.get_backend_name()
    except (ArgumentError, ValueError):
        # What cannot be read may have a password anywhere in it: nothing of it is shown.
        raise InputError(
            f"{where}: is no address of a database; write it as {EXAMPLE}, with %40 for an @ in a"
            " password"
        ) from None
    if database not in ("postgresql", "postgres"):
        raise InputError(f"{where}: {database} is not PostgreSQL; write it as {EXAMPLE}")
    if "@" in (url.host or ""):
        raise InputError(f"{where}: has an @ too many; write %40 for one in a password")
    options = {k: v if isinstance(v, str) else v[-1] for k, v in url.query.items()}
    password = options.pop("password", None) or (str(url.password) if url.password else None)
    # Also `sslpassword`, and what libpq is going to refuse: `passwd`, `PASSWORD`.
    secret = {k: v for k, v in options.items() if re.fullmatch(_SECRET, k, re.IGNORECASE)}
    public = {k: v for k, v in options.items() if k not in secret}
    shown = url.set(drivername="postgresql+psycopg", password=None, query=public)
    parameters: dict[str, Any] = {
        **{"host": url.host, "port": url.port, "user": url.username, "dbname": url.database},
        **options,
        "password": password,
    }
    return Address(
        shown.render_as_string(),
        {key: value for key, value in parameters.items() if value is not None},
        _forms([password, *secret.values()], text),
    )


def _forms(passwords: Iterable[str | None], text: str) -> tuple[str, ...]:
    """Passwords as they are, and as a URL may have them."""
    known = [word for word in passwords if word]
    if not known:
        return ()
    typed = re.findall(rf"//[^:@/]*:([^@]*)@|[?&]{_SECRET}=([^&]*)", text, re.IGNORECASE)
    found = {f for w in known for f in (w, quote(w), quote(w, safe=""), quote_plus(w))}
    found |= {form for forms in typed for form in forms if form}
    return tuple(sorted(found, key=len, reverse=True))


def without_passwords(text: str) -> str:
    """A text in which an address of a database may stand where none belongs, without its
    password."""
    # As a path it has lost a slash.
    text = re.sub(r"(:/{1,2}[^\s:@/]*:)\S*@", rf"\1{MASK}@", text)
    return re.sub(rf"([?&]{_SECRET}=)[^\s&'\")]*", rf"\1{MASK}", text, flags=re.IGNORECASE)


def _checked(path: Path) -> Path:
    where = f"--password-file {path}"
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        mode = path.stat().st_mode
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "is not text"
        raise InputError(f"{where}: cannot be read: {reason}") from None
    if mode & 0o077:
        raise InputError(f"{where}: others may read it, libpq would not take it; chmod 600 it")
    entries = [line for line in lines if line.strip() and not line.startswith("#")]
    if not entries or any(line.count(":") < 4 for line in entries):
        raise InputError(
            f"{where}: needs lines host:port:database:user:password, * for any (libpq's .pgpass)"
        )
    return path.absolute()


def hide_command_line(address: Address) -> None:
    """Overwrite the password in what the list of processes shows of this one, and so of those that
    it forks. Raises InputError where that is not allowed; nothing to do where there is no /proc."""
    secrets = [secret.encode() for secret in address.secrets]
    with contextlib.suppress(FileNotFoundError):
        shown = Path("/proc/self/cmdline").read_bytes()
        if not any(secret in shown for secret in secrets):
            return
        # Fields 48 and 49 of proc(5), the name in brackets may have blanks.
        fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
        begin, end = int(fields[45]), int(fields[46])
        try:
            with open("/proc/self/mem", "rb+", buffering=0) as memory:
                memory.seek(begin)
                words = memory.read(end - begin)
                for secret in secrets:
                    words = words.replace(secret, b"*" * len(secret))
                memory.seek(begin)
                memory.write(words)
        except OSError:
            raise InputError(
                "--storage: a password on the command line can be seen by everyone on this"
                f" machine; give it in {ENVIRONMENT}, ~/.pgpass or a --password-file"
            ) from None

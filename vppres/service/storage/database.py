"""Database of a service's state: SQLite in a folder, or PostgreSQL; one process each.

SQLite runs with WAL and ``synchronous=FULL``: what was committed survives a kill and a loss of
power. A lock on a file beside it keeps a second process out; it ends with the process that holds
it. PostgreSQL has an advisory lock of a session that does nothing else: every transaction asks
whether that session is still there, and the server ends the one of a process that is dead.
"""

from __future__ import annotations

import fcntl
import importlib.util
import os
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from vppres.core.errors import InputError, Problem, StorageError

BUSY_S = 5
LOCK = 0x76707072
"""Number of the advisory lock, of all that a database may have."""

PATIENCE_S = 10
"""After which a statement is given up, and a server that does not answer."""

POSTGRESQL = "postgresql://"
DRIVER = "postgresql+psycopg://"

_ONLY_READ = "The state is only read."


def opened_database(place: Path | str, reading: bool = False) -> InFolder | OnServer:
    """The database at a place, for this process alone; or to be read beside the one that serves.

    Raises
    ------
    InputError
        If another process serves from it, there is nothing to read, or the server does not answer.
    """
    if str(place).startswith(POSTGRESQL):
        return OnServer(str(place), reading)
    return InFolder(Path(place), reading)


class InFolder:
    """SQLite in a folder, which is made if it is not only read."""

    def __init__(self, folder: Path, reading: bool = False) -> None:
        self.folder = folder
        self._lock: int | None = None
        if reading and not (folder / "service.db").exists():
            cure = "Give the place with --state, as for the service."
            raise InputError.of(self.name, "holds no state of a service", cure)
        if not reading:
            try:
                folder.mkdir(parents=True, exist_ok=True, mode=0o700)
                self._lock = _locked(folder)
            except OSError as error:
                message = f"cannot be written to: {error.strerror}"
                cure = "Give another folder with --state."
                raise InputError.of(self.name, message, cure) from error
        self._file = folder / "service.db"
        self.engine = sa.create_engine(f"sqlite:///{self._file}", connect_args={"timeout": BUSY_S})
        sa.event.listen(self.engine, "connect", _durable)
        try:
            self.engine.connect().close()
        except sa.exc.DBAPIError as error:
            self.close()
            cure = "Put a copy in its place, or remove it: then the service begins anew."
            problem = Problem(str(self._file), f"is no database of a service: {error.orig}", cure)
            raise InputError(problem) from error
        self._opened = self._file.stat()

    @property
    def name(self) -> str:
        """The folder."""
        return str(self.folder)

    def check(self, db: sa.Connection) -> None:
        """The lock cannot have been taken, but the file can be gone."""
        if self._lock is None:
            raise StorageError(_ONLY_READ)
        try:
            same = os.path.samestat(self._file.stat(), self._opened)
        except OSError:
            same = False
        if not same:
            raise StorageError(
                f"{self._file} was removed or replaced while the service ran: nothing is kept any "
                "more. Stop the service, put the file back, and start it again."
            )

    def close(self) -> None:
        """Close the database and free the lock."""
        self.engine.dispose()
        if self._lock is not None:
            os.close(self._lock)


class OnServer:
    """PostgreSQL, as long as a session holds a lock there; none if it is only read."""

    def __init__(self, address: str, reading: bool = False) -> None:
        url = sa.make_url(address.replace(POSTGRESQL, DRIVER, 1))
        self._shown: str = url.render_as_string(hide_password=True).replace(DRIVER, POSTGRESQL)
        _check_driver()
        self.engine = sa.create_engine(
            url,
            pool_pre_ping=True,  # the server may have been stopped and started
            connect_args={
                "connect_timeout": PATIENCE_S,
                "options": f"-c statement_timeout={PATIENCE_S * 1000}",
            },
        )
        self._holder: sa.Connection | None = None
        self._reading = reading
        try:
            if reading:
                self.engine.connect().close()
            elif not self._taken():
                raise InputError(_in_use(self.name))
        except InputError:
            self.close()
            raise
        except sa.exc.SQLAlchemyError as error:
            self.close()
            words = str(getattr(error, "orig", None) or error).strip().splitlines()[0]
            cure = "Start the server, or give another address with --state."
            raise InputError.of(self.name, f"does not answer: {words}", cure) from error

    @property
    def name(self) -> str:
        """The address without a password."""
        return self._shown

    def check(self, db: sa.Connection) -> None:
        """Whether the lock is still held, or can be had again after the server was away."""
        if self._reading:
            raise StorageError(_ONLY_READ)
        if not self._held() and not self._taken():
            raise StorageError(f"Another process serves from {self.name} by now.")

    def close(self) -> None:
        """Give the lock back, with its session."""
        self._let_go()
        self.engine.dispose()

    def _held(self) -> bool:
        """Whether the session that took the lock is still there."""
        if self._holder is None:
            return False
        try:
            self._holder.execute(sa.select(1))
        except sa.exc.SQLAlchemyError:
            return False
        return True

    def _taken(self) -> bool:
        """Whether a new session has the lock."""
        self._let_go()
        self._holder = self.engine.connect().execution_options(isolation_level="AUTOCOMMIT")
        return bool(self._holder.scalar(sa.select(sa.func.pg_try_advisory_lock(LOCK))))

    def _let_go(self) -> None:
        """End the session, as far as it is there: back in the pool it would keep the lock."""
        if self._holder is not None:
            self._holder.invalidate()
            self._holder.close()
            self._holder = None


def _check_driver() -> None:
    """Say which extra is missing."""
    if importlib.util.find_spec("psycopg") is None:
        cure = 'Install the extra: pip install "vppres[postgres]".'
        raise InputError.of("state", "needs the package psycopg", cure)


def _in_use(name: str) -> Problem:
    cure = "End that one first, or give another place with --state."
    return Problem(name, "is in use: another process serves from it", cure)


def _durable(connection: Any, _record: Any) -> None:
    """Set up a connection to SQLite."""
    cursor = connection.cursor()
    cursor.execute("PRAGMA journal_mode=WAL")
    cursor.execute("PRAGMA synchronous=FULL")
    cursor.execute("PRAGMA foreign_keys=ON")
    cursor.close()


def _locked(folder: Path) -> int:
    """Take the lock of a folder; its file descriptor."""
    descriptor = os.open(folder / "service.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise InputError(_in_use(str(folder))) from None
    return descriptor

"""Transactions on the database of one site, and whether it takes them."""

from __future__ import annotations

import threading
import time as machine
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from vppres.core.errors import InputError, StorageError
from vppres.service.storage.database import opened_database
from vppres.service.storage.tables import META, TABLES, put

LAYOUT = "1"
TRIED_S = 5.0
"""For how long the database is as it was when it was last written to."""


class Transactions:
    """The database of one site, which belongs to that site alone.

    Raises
    ------
    InputError
        If another process serves from it, or it belongs to another site or layout.
    """

    def __init__(self, place: Path | str, site: str, reading: bool = False) -> None:
        self._database = opened_database(place, reading)
        self._engine = self._database.engine
        self._reading = reading
        self._writing = threading.Lock()
        self._trying = threading.Lock()
        self._takes = not reading
        self._tried_at = -TRIED_S
        self.changes = 0  # a reader of what is stored looks again when it has grown
        if not reading:
            with _plain_errors():
                TABLES.create_all(self._engine)
        self._belongs_to(site)

    @property
    def place(self) -> str:
        """Address of the database, without a password."""
        return self._database.name

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def ready(self) -> bool:
        """Whether the database takes a transaction; tried now and then, however often it is asked.

        A reader that asks while it is tried gets the time before.
        """
        if self._trying.acquire(blocking=False):
            try:
                if machine.monotonic() - self._tried_at > TRIED_S:
                    with suppress(StorageError), self._changes(routine=True) as db:
                        put(db, META, key="checked", value="")
            finally:
                self._trying.release()
        return self._takes

    def _belongs_to(self, site: str) -> None:
        """Refuse the database of another site or layout; a new one is this site's."""
        wanted = {"layout": LAYOUT, "site": site}
        known = self._mapping(sa.select(META))
        missing = {key: value for key, value in wanted.items() if key not in known}
        if missing and not self._reading:
            with self._changes() as db:
                for key, value in missing.items():
                    put(db, META, key=key, value=value)
        for key, value in wanted.items():
            if known.get(key, value) != value:
                self.close()
                message = f"holds the state of another {key}"
                cure = "Give another place with --state, or remove this one."
                place = {"field": key, "value": known[key][:12]}
                raise InputError.of(self._database.name, message, cure, **place)

    @contextmanager
    def _changes(self, routine: bool = False) -> Iterator[sa.Connection]:
        """A transaction that writes; what is routine need not be seen at once."""
        try:
            with self._writing:
                with _plain_errors(), self._engine.begin() as db:
                    self._database.check(db)
                    yield db
                self.changes += not routine
        except StorageError:
            self._takes = False
            raise
        finally:
            self._tried_at = machine.monotonic()
        self._takes = True

    def _rows(self, chosen: Any) -> list[Any]:
        with _plain_errors(), self._engine.connect() as db:
            return list(db.execute(chosen))

    def _values(self, chosen: Any) -> list[Any]:
        """The only value of each row."""
        return [value for (value,) in self._rows(chosen)]

    def _mapping(self, chosen: Any) -> dict[Any, Any]:
        """The second value of each row by its first."""
        return {key: value for key, value in self._rows(chosen)}


@contextmanager
def _plain_errors() -> Iterator[None]:
    """Translate errors of the database into those of vppres."""
    try:
        yield
    except sa.exc.SQLAlchemyError as error:
        words = str(getattr(error, "orig", None) or type(error).__name__)
        raise StorageError(f"The database does not answer: {words}.") from error

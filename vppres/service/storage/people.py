"""Settings, tokens, and the audit of who changed what."""

from __future__ import annotations

import hashlib
import json
from itertools import starmap
from typing import Any

import pandas as pd
import sqlalchemy as sa

from vppres.service.storage.records import ChangedError, Token
from vppres.service.storage.tables import AUDIT, META, TOKENS, note, put
from vppres.service.storage.transactions import Transactions


class StoredSettings(Transactions):
    """Settings of a site, and tokens of those who may change them."""

    def put_setting(
        self, key: str, value: Any, now: pd.Timestamp, actor: str, replacing: str | None = None
    ) -> str:
        """Keep a setting, and who changed it; its tag.

        Raises
        ------
        ChangedError
            If it is to replace one with another tag than the present one's.
        """
        name = f"setting.{key}"
        with self._changes() as db:
            before = db.execute(sa.select(META.c.value).where(META.c.key == name)).scalar()
            if replacing is not None and replacing != _tag(before):
                raise ChangedError(f"The {key} has changed since.")
            text = json.dumps(value, sort_keys=True)
            put(db, META, key=name, value=text)
            note(db, now, actor, key, text)
        return _tag(text)

    def setting(self, key: str) -> tuple[Any, str]:
        """A setting, empty if there is none, and its tag."""
        chosen = sa.select(META.c.value).where(META.c.key == f"setting.{key}")
        text = next(iter(self._values(chosen)), None)
        return (json.loads(text) if text else {}), _tag(text)

    def add_token(self, token: Token, now: pd.Timestamp) -> None:
        """Add a token, instead of the one that had the name."""
        with self._changes() as db:
            put(db, TOKENS, **vars(token))
            note(db, now, "command line", "token", f"{token.name} {token.scopes}")

    def remove_token(self, name: str, now: pd.Timestamp) -> bool:
        """Remove a token; whether there was such a token."""
        with self._changes() as db:
            found = bool(db.execute(TOKENS.delete().where(TOKENS.c.name == name)).rowcount)
            if found:
                note(db, now, "command line", "token removed", name)
        return found

    def tokens(self) -> list[Token]:
        """All tokens."""
        return list(starmap(Token, self._rows(sa.select(TOKENS).order_by(TOKENS.c.name))))

    def audit(self) -> list[tuple[str, str, str]]:
        """Audit log in order: actor, action, detail."""
        a = AUDIT.c
        chosen = sa.select(a.actor, a.action, a.detail).order_by(a.number)
        return [tuple(row) for row in self._rows(chosen)]


def _tag(text: str | None) -> str:
    """Name of what a setting says."""
    return hashlib.sha256((text or "").encode()).hexdigest()[:16]

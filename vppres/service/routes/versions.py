"""Headers by which a request replaces nothing but what its sender has seen."""

from __future__ import annotations

from typing import Annotated

from fastapi import Header

IfMatch = Annotated[str | None, Header(max_length=100)]
"""ETag of what is to be replaced, as it was answered; without it whatever there is."""


def replaced_by(if_match: str | None) -> str | None:
    """Tag that the header names; None without one.

    >>> replaced_by(' "4" ')
    '4'
    """
    return None if if_match is None else if_match.strip().strip('"')

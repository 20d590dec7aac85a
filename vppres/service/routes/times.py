"""Times in the addresses of requests."""

from __future__ import annotations

import pandas as pd

from vppres.core.errors import InputError, Problem
from vppres.service.payloads import read_moment


def moment_asked(text: str) -> pd.Timestamp:
    """A time that a request asks about.

    Raises
    ------
    InputError
        If it is none.
    """
    try:
        return read_moment(text)
    except ValueError as error:
        raise InputError(
            Problem("request", str(error), "Give a time.", field="at", value=text)
        ) from None

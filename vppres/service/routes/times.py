"""Times and assets in the addresses of requests."""

from __future__ import annotations

import pandas as pd
from starlette.exceptions import HTTPException

from vppres.core.errors import InputError
from vppres.io.messages import did_you_mean
from vppres.scenario.scenario import Scenario
from vppres.service.payloads import OF_KIND, read_moment


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
        raise InputError.of("request", str(error), "Give a time.", field="at", value=text) from None


def check_asset(asset: str | None, scenario: Scenario) -> None:
    """Whether an asset that a request asks about is at the site; 404 if not."""
    known = [str(name) for kind in OF_KIND for name in getattr(scenario, kind).id]
    if asset is not None and asset not in known:
        cure = did_you_mean(asset, known, "Ask /v1/site.")
        raise HTTPException(404, f"There is no such asset. {cure}")

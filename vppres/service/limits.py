"""How often may be asked: a bucket for each token and scope, which fills as time goes by."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from vppres.service.access import Denied

DENIED = "denied"
"""The kind of requests without a token: all of them together have one bucket."""


@dataclass(frozen=True)
class Rate:
    """Requests a second in the long run, and how many may come at once."""

    per_s: float
    at_once: float


RATES = {
    "read": Rate(200.0, 400.0),
    "telemetry": Rate(50.0, 200.0),
    "events": Rate(5.0, 100.0),
    "operator": Rate(10.0, 100.0),
    DENIED: Rate(1.0, 30.0),
}


class RateLimits:
    """Counts requests.

    Parameters
    ----------
    rates : mapping of str to Rate, optional
        What is granted, by kind; other kinds are free.
    now : callable
        Seconds of a clock that is never set.

    Examples
    --------
    >>> limits = RateLimits({"read": Rate(per_s=2.0, at_once=1.0)}, now=lambda: 0.0)
    >>> limits.wait_s("panel", "read"), limits.wait_s("panel", "read")
    (0.0, 0.5)
    """

    def __init__(
        self, rates: Mapping[str, Rate] | None = None, now: Callable[[], float] = time.monotonic
    ) -> None:
        self.rates = RATES if rates is None else rates
        self.now = now
        self._left: dict[tuple[str, str], tuple[float, float]] = {}

    def check(self, name: str, kind: str) -> None:
        """Take one.

        Raises
        ------
        Denied
            If there is none.
        """
        wait_s = self.wait_s(name, kind)
        if wait_s > 0.0:
            raise Denied(429, "Too many requests: slow down.", wait_s)

    def wait_s(self, name: str, kind: str) -> float:
        """Take one; 0 if there was one, else how long to wait for the next."""
        rate = self.rates.get(kind)
        if rate is None:
            return 0.0
        now = self.now()
        left, at = self._left.get((name, kind), (rate.at_once, now))
        left = min(rate.at_once, left + (now - at) * rate.per_s)
        granted = left >= 1.0
        self._left[name, kind] = (left - granted, now)
        return 0.0 if granted else (1.0 - left) / rate.per_s

"""One test for many cases, which names every case that fails and not the first alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeVar

import pytest

Case = TypeVar("Case")


def assert_for_all(cases: Mapping[str, Case], check: Callable[[Case], None]) -> None:
    """Run a check on every case and fail with the list of those that did not pass.

    Any error counts, not only a failed assertion: a check that cannot be made has not passed.
    """
    offenders = {}
    for name, case in cases.items():
        try:
            check(case)
        except Exception as error:
            offenders[name] = f"{type(error).__name__}: {error}"
    if offenders:
        listed = "\n".join(f"{name}: {reason}" for name, reason in offenders.items())
        pytest.fail(f"{len(offenders)} of {len(cases)} cases:\n{listed}", pytrace=False)

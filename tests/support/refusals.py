"""What a call is refused with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from vppres.core.errors import InputError


def refusal(call: Callable[..., object], *given: Any, **named: Any) -> str:
    """The words of the error in the inputs that a call ends with."""
    with pytest.raises(InputError) as caught:
        call(*given, **named)
    return str(caught.value)

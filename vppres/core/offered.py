"""Public names of the package, for methods that only open a door to a layer above their own."""

from __future__ import annotations

from importlib import import_module
from typing import Any


def offered(name: str) -> Any:
    """A public name of ``vppres``, loaded when it is asked for.

    >>> offered("RunOptions").__name__
    'RunOptions'
    """
    return getattr(import_module("vppres"), name)

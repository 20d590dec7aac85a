"""Functions of a module that is loaded when one of them is called, not when it is imported."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType
from typing import Any


@contextmanager
def deferred(module: str, *names: str) -> Iterator[None]:
    """Within the block, ``from module import name`` gives functions that load it when called.

    Afterwards the module is imported as ever. One that is loaded already stays what it is.

    Examples
    --------
    >>> sys.modules.pop("this", None)
    >>> with deferred("this", "wanted"):
    ...     from this import wanted
    >>> "this" in sys.modules
    False
    """
    if module in sys.modules:
        yield
        return
    stand_in = ModuleType(module)
    for name in names:
        setattr(stand_in, name, _loading(module, name))
    sys.modules[module] = stand_in
    try:
        yield
    finally:
        del sys.modules[module]


def _loading(module: str, name: str) -> Callable[..., Any]:
    """A function that is the module's own from its first call on."""

    def call(*args: Any, **options: Any) -> Any:
        return getattr(import_module(module), name)(*args, **options)

    return call

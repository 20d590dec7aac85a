"""Memory of controllers from step to step, as a plain value that can be saved and put back.

A class that remembers says so in ``REMEMBERED``: the name of each attribute, and its type. All else
that it holds (sites, solvers, compiled problems) is made anew with it. A memory outlives a process,
and undoes a step within it.
"""

from __future__ import annotations

from typing import Any

from vppres.core.errors import InputError
from vppres.core.plain import Given, from_plain, to_plain

PART = object()
"""Instead of a type: something that remembers by itself."""

PARTS = object()
"""Instead of a type: several such, by keys from which ``part_for`` makes each."""


def memory_of(decider: Any, given: Given) -> dict[str, Any]:
    """The memory of a controller and of its parts, as JSON can hold it.

    ``given`` is known without the memory, by type: the site and its rules.

    Examples
    --------
    >>> from vppres.control.baselines import IdleController
    >>> memory_of(IdleController(None, ()), {})
    {}
    """
    memory: dict[str, Any] = {}
    for name, kind in _remembered(decider).items():
        value = getattr(decider, name)
        if kind is PART:
            memory[name] = memory_of(value, given)
        elif kind is PARTS:
            memory[name] = [[key.hex(), memory_of(part, given)] for key, part in value.items()]
        else:
            memory[name] = to_plain(value, given)
    return memory


def put_back(decider: Any, memory: Any, given: Given, where: str) -> None:
    """Let a controller remember what another one did, or what it did itself before.

    The memory is what :func:`memory_of` made of a controller of the same options, ``given`` that of
    the new one; ``where`` is what is read, as problems name it.

    Raises
    ------
    InputError
        If the memory is not that of such a controller.
    """
    kinds = _remembered(decider)
    if not isinstance(memory, dict) or set(memory) != set(kinds):
        raise InputError.of(
            where,
            "is not the memory of such a controller",
            "Give it as it was written, with the options that it was written with.",
        )
    for name, kind in kinds.items():
        place = f"{where}.{name}"
        if kind is PART:
            put_back(getattr(decider, name), memory[name], given, place)
        elif kind is PARTS:
            parts = {bytes.fromhex(key): part for key, part in memory[name]}
            for key in getattr(decider, name).keys() - parts.keys():
                del getattr(decider, name)[key]
            for key, part in parts.items():
                put_back(decider.part_for(key), part, given, place)
        else:
            setattr(decider, name, from_plain(kind, memory[name], place, given))


def _remembered(decider: Any) -> dict[str, Any]:
    """Attributes and their types; nothing where a class says nothing."""
    kinds: dict[str, Any] = getattr(decider, "REMEMBERED", {})
    return kinds

"""What a controller remembers from step to step, kept so that a step can be undone."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

OF_CONTROLLERS = "vppres.control."


class Memory:
    """The state of a controller and of all that it is made of, as it was when this was made.

    Objects of the package ``control`` hold the state; what they decide with (sites, solvers,
    compiled problems, plans) is filled anew for every window or never changes, and is not copied.

    Parameters
    ----------
    controller : object
        A controller, guarded or not.

    Examples
    --------
    >>> from vppres.control.guard.series import SeriesJudge
    >>> import vppres
    >>> from vppres.model.site import Site
    >>> judge = SeriesJudge(Site.of(vppres.load_scenario("uk-heatwave-2022")))
    >>> memory = Memory(judge)
    >>> judge._before = "a step"
    >>> memory.restore()
    >>> judge._before is None
    True
    """

    def __init__(self, controller: object) -> None:
        self._kept = [(part, _copied(vars(part))) for part in _parts(controller, set())]

    def restore(self) -> None:
        """Put everything back."""
        for part, state in self._kept:
            vars(part).clear()
            vars(part).update(_copied(state))


def _copied(state: dict[str, Any]) -> dict[str, Any]:
    """Attributes, with containers of their own: a controller changes them in place."""
    return {
        name: value.copy() if isinstance(value, (dict, set, list)) else value
        for name, value in state.items()
    }


def _parts(found: object, known: set[int]) -> Iterator[object]:
    """The object and the parts of it that belong to controllers, each once."""
    if isinstance(found, dict):
        for value in found.values():
            yield from _parts(value, known)
    ours = type(found).__module__.startswith(OF_CONTROLLERS) and hasattr(found, "__dict__")
    if ours and id(found) not in known:
        known.add(id(found))
        yield found
        for value in list(vars(found).values()):
            yield from _parts(value, known)

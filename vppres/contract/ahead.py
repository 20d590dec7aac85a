"""Flexible power of all kinds over the steps of a window."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Self

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.kinds.kind import UnitsAhead
from vppres.kinds.table import parts, units_of
from vppres.scenario.scenario import Scenario


def past_days_of(scenario: Scenario, seed: int) -> dict[str, Any]:
    """Days before a run that windows are expected to be like, by kind; None where none are."""
    physics = parts("physics")
    return {kind: physics[kind].WINDOW.past_days(scenario, seed) for kind in units_of(scenario)}


@dataclass(frozen=True, eq=False)
class KindsAhead:
    """Window data of the units of each kind that the site has, over W steps."""

    #: Windows by kind, in the order of :data:`vppres.kinds.table.KINDS`.
    by_kind: dict[str, UnitsAhead] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        steps: range,
        states: Mapping[str, Any],
        past_days: Mapping[str, Any] | None = None,
    ) -> Self:
        """The window that begins with these states, expected to go on like past days, by kind."""
        physics = parts("physics")
        return cls(
            {
                kind: physics[kind].WINDOW.of(
                    scenario, steps, states[kind], (past_days or {}).get(kind)
                )
                for kind in units_of(scenario)
            }
        )

    def known(self, kind: str) -> Any:
        """Window of a kind that the site has, for those who know its class."""
        return self.by_kind[kind]

    def _each(self, change: Callable[[UnitsAhead], UnitsAhead]) -> Self:
        return type(self)({kind: change(known) for kind, known in self.by_kind.items()})

    def part(self, steps: slice) -> Self:
        """Some steps of the window."""
        return self._each(lambda known: known.part(steps))

    def in_the_dark(self, lit: Flags) -> Self:
        """Window without power except in the lit steps, (W, 1)."""
        return self._each(lambda known: known.in_the_dark(lit))

    def in_dead_parts(self, lit: Mapping[str, Flags]) -> Self:
        """Window without power except in the lit steps of each unit, (W, n) by kind."""
        return type(self)(
            {kind: known.in_the_dark(lit[kind]) for kind, known in self.by_kind.items()}
        )

    def holding(self, part: Mapping[str, Wholes]) -> Self:
        """Window with the units that hold the parts that no battery forms.

        ``part`` is the number of each unit's part, (W, n) by kind, -1 where units form none.
        """
        return type(self)({kind: known.holding(part[kind]) for kind, known in self.by_kind.items()})

    def without_duties(self) -> Self:
        """Window without units that have to stay on."""
        return self._each(lambda known: known.without_duties())

    @property
    def switched(self) -> bool:
        """Whether there are units that are started and stopped."""
        return any(known.switched for known in self.by_kind.values())

    def formers(self) -> dict[str, Flags]:
        """Steps in which units form the grid of an island, (W, n), by kind of those that do."""
        found = {kind: known.forming_steps() for kind, known in self.by_kind.items()}
        return {kind: forms for kind, forms in found.items() if forms.any()}

    def holders(self) -> dict[str, Flags]:
        """Steps in which units hold a part if they run, (W, n), by kind of those that do."""
        found = {kind: known.holding_steps() for kind, known in self.by_kind.items()}
        return {kind: holds for kind, holds in found.items() if holds.any()}

    def formed(self, dark: Flags, headroom: float) -> tuple[Self, Flags]:
        """Window with the units that form dark steps, (W,), and the steps that stay dark.

        ``headroom`` is the share of a rating that is left free above and below the plan.
        """
        by_kind = {}
        for kind, known in self.by_kind.items():
            by_kind[kind], lit = known.formed(dark, headroom)
            dark = dark & ~lit
        return type(self)(by_kind), dark

    def most_taken_kw(self) -> Iterator[Floats]:
        """Most that the units of each kind take together, (W,)."""
        return (known.most_taken_kw() for known in self.by_kind.values())

    def most_given_kw(self) -> Iterator[Floats]:
        """Most that the units of each kind give together, (W,)."""
        return (known.most_given_kw() for known in self.by_kind.values())

"""Flexible power of all kinds over the steps of a window."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Self

from vppres.contract.by_step import UnitsAhead
from vppres.contract.gensets import SetsAhead
from vppres.contract.plugged import Plugged
from vppres.contract.rooms import Rooms
from vppres.core.arrays import Flags, Floats
from vppres.scenario.gensets import GensetState
from vppres.scenario.kinds import KINDS, Units
from vppres.scenario.past_days import PastDays
from vppres.scenario.scenario import Scenario


@dataclass(frozen=True, eq=False)
class KindsAhead:
    """What is known of the units of each kind in W steps; None of a kind that the site lacks.

    The fields stand in the order of :data:`vppres.scenario.kinds.KINDS`.

    Parameters
    ----------
    plugged : Plugged, optional
        Vehicles that are plugged in, announced or expected.
    rooms : Rooms, optional
        Rooms and tanks that are cooled or heated.
    gensets : SetsAhead, optional
        Generating sets.
    """

    plugged: Plugged | None = None
    rooms: Rooms | None = None
    gensets: SetsAhead | None = None

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        steps: range,
        held_kwh: Floats,
        t_c: Floats,
        sets: GensetState,
        past_days: PastDays | None,
    ) -> Self:
        """The window that begins with this energy in vehicles, these temperatures, these sets."""
        return cls(
            Plugged.of(scenario, steps, held_kwh, past_days),
            Rooms.of(scenario, steps, t_c),
            SetsAhead.of(scenario, steps, sets),
        )

    @property
    def by_kind(self) -> dict[str, UnitsAhead]:
        """What is known of each kind that there is."""
        each = zip(KINDS, (getattr(self, field.name) for field in fields(self)), strict=True)
        return {kind: known for kind, known in each if known is not None}

    def _each(self, change: Callable[[Any], Any]) -> Self:
        known = {field.name: getattr(self, field.name) for field in fields(self)}
        return replace(self, **{name: each and change(each) for name, each in known.items()})

    def part(self, steps: slice) -> Self:
        """Some steps of the window."""
        return self._each(lambda known: known.part(steps))

    def followed_by_none(self, n_steps: int) -> Self:
        """The same with steps behind it in which nothing is there, or can be missed."""
        return self._each(lambda known: known.followed_by_none(n_steps))

    def in_the_dark(self, lit: Flags) -> Self:
        """The same without power but in the lit steps, (W, 1)."""
        return self._each(lambda known: known.in_the_dark(lit))

    def without_duties(self) -> Self:
        """The same without units that have to stay on."""
        return self._each(lambda known: known.without_duties())

    def most_taken_kw(self, units: Mapping[str, Units]) -> Iterator[Floats]:
        """Most that the units of each kind take together, (W,)."""
        return (known.most_taken_kw(units[kind]) for kind, known in self.by_kind.items())

    def most_given_kw(self, units: Mapping[str, Units]) -> Iterator[Floats]:
        """Most that the units of each kind give together, (W,)."""
        return (known.most_given_kw(units[kind]) for kind, known in self.by_kind.items())

"""One grid connection from several: chosen by name, or joined where they hold one voltage."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from vppres.core.errors import InputError, Problem
from vppres.core.text import named
from vppres.feeders.net.elements import JOINT, in_service, label
from vppres.scenario.network import BusId

ALL = "all"
"""Word for all grids together."""


@dataclass(frozen=True)
class _Grid:
    """An external grid, or a generator that can be the grid connection."""

    table: str
    index: Any
    bus: int
    v_pu: float
    label: str
    name: str
    bus_word: str

    def is_called(self, word: str) -> bool:
        """Whether a word is its table and index, its name or its bus."""
        return word in (f"{self.table} {self.index}", self.name, self.bus_word) and bool(word)

    def __str__(self) -> str:
        return f"{self.label} at bus {self.bus_word}"


def one_grid(
    net: Any, name: str, wanted: str | None, bus_ids: Mapping[int, BusId] | None
) -> Iterator[str]:
    """Leave one external grid in the net, in place; notes say what becomes of the others.

    ``wanted`` is the grid by table and index, by its name or by its bus, or ``all``; it is needed
    where there are several.
    """
    grids = [_grid(net, "ext_grid", i, bus_ids) for i in in_service(net, "ext_grid").index]
    gens = [_grid(net, "gen", i, bus_ids) for i in in_service(net, "gen").index]
    holding = [grid for grid in gens if bool(net.gen["slack"].at[grid.index])]
    several = grids + holding
    if wanted is None:
        if len({grid.bus for grid in several}) > 1:
            raise InputError.of(
                name,
                f"has {len(several)} external grids: {named(map(str, several))}",
                "Choose one with --slack, by its name or its bus; --slack all joins those that "
                "hold the same voltage.",
            )
        chosen = several[:1]
    elif wanted == ALL:
        chosen = several
        _check_alike(net, name, several)
    else:
        chosen = [grid for grid in several + gens if grid.is_called(wanted)][:1]
        if not chosen:
            raise InputError(_unknown(name, wanted, several or gens))
    if chosen:
        yield from _keep(net, chosen, several)


def _grid(net: Any, table: str, index: Any, bus_ids: Mapping[int, BusId] | None) -> _Grid:
    row = net[table].loc[index]
    bus = int(row["bus"])
    name = row["name"] if isinstance(row["name"], str) else ""
    bus_word = str(bus_ids[bus] if bus_ids else bus)
    return _Grid(table, index, bus, float(row["vm_pu"]), label(net, table, index), name, bus_word)


def _unknown(name: str, wanted: str, grids: list[_Grid]) -> Problem:
    return Problem(
        name,
        "is no external grid of the network",
        f"There is {named(map(str, grids))}." if grids else "Add an external grid to the source.",
        field="slack",
        value=wanted,
    )


def _check_alike(net: Any, name: str, grids: list[_Grid]) -> None:
    """Grids that can be one: the same set-point at the same level."""
    if len({(grid.v_pu, float(net.bus.at[grid.bus, "vn_kv"])) for grid in grids}) > 1:
        held = [f"{grid.label} {grid.v_pu:g} pu" for grid in grids]
        raise InputError.of(
            name,
            f"has grids that hold different voltages: {named(held)}",
            "Choose one of them.",
            field="slack",
            value=ALL,
        )


def _keep(net: Any, chosen: list[_Grid], several: list[_Grid]) -> Iterator[str]:
    """Make the first of the chosen the external grid, and take all others out of service."""
    import pandapower as pp

    first = chosen[0]
    others = [grid for grid in several if grid is not first]
    if first.table == "gen":
        net.gen.loc[first.index, "in_service"] = False
        pp.create_ext_grid(net, first.bus, vm_pu=first.v_pu, name=first.label)
        yield f"{first.label[:1].upper()}{first.label[1:]} is taken as the grid connection."
    for grid in others:
        if grid.table == "ext_grid":
            net.ext_grid.loc[grid.index, "in_service"] = False
        else:
            net.gen.loc[grid.index, "slack"] = False
    elsewhere = [grid for grid in others if grid.bus != first.bus]
    if len(chosen) > 1:
        for grid in elsewhere:
            pp.create_switch(net, first.bus, grid.bus, et="b", closed=True, type=JOINT)
            net.gen.loc[[grid.index] if grid.table == "gen" else [], "in_service"] = False
        yield (
            f"{len(chosen)} external grids hold the same voltage and are joined to one grid "
            f"connection (--slack all): {named(grid.label for grid in chosen)}. Limits and outages "
            "are those of all together."
        )
        return
    fed = [grid.label for grid in elsewhere if grid.table == "ext_grid"]
    if fed:
        yield (
            f"The grid connection is {first.label} (--slack); no longer feeding, and out of "
            f"service: {named(fed)}."
        )
    generating = [grid.label for grid in elsewhere if grid.table == "gen"]
    if generating:
        yield (
            f"The grid connection is {first.label}; generators with their own active power and no "
            f"longer the balance of the net: {named(generating)}."
        )

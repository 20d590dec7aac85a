"""Series of others on the assets of a new scenario."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Floats, Names
from vppres.core.errors import InputError, Problem
from vppres.core.text import iso, named
from vppres.feeders.feeder import ImportedFeeder, Profile
from vppres.feeders.new.assets import NewAssets
from vppres.feeders.series.clocks import in_utc
from vppres.feeders.series.files import UNITS_CURE, other_unit, units_missing
from vppres.feeders.series.resample import on_grid
from vppres.io.checks import RATING_TOLERANCE
from vppres.io.messages import Suggestions, folded
from vppres.io.times import usual_step
from vppres.scenario.assets import PVSystems
from vppres.scenario.timegrid import TimeGrid

OF_FEEDER = "system series"
OF_SYSTEM = ("price_gbp_per_kwh", "temperature_c")
"""Series of the feeder as a whole, by the names of ``system.csv``; they have no unit."""

_KW = {"kw": 1.0, "mw": 1000.0}
_KWH = {"wh": 0.001, "kwh": 1.0, "mwh": 1000.0}

LEAST_KW = 1e-6
"""Power that counts as none."""

_REGISTER_VALUES = 48
"""Values from which energy that never falls is a meter's register, and no energy of intervals."""


def timed(
    profiles: list[Profile], grid: TimeGrid, zone: str | None, row_minutes: float | None
) -> list[Profile]:
    """Series with their times in UTC.

    Clock times are in ``zone``; rows without times last ``row_minutes`` and begin with the grid.
    """
    problems: list[Problem] = []
    done: list[Profile] = []
    for profile in profiles:
        index = profile.values.index
        if isinstance(index, pd.DatetimeIndex):
            times, found = in_utc(index, zone, profile.where)
        else:
            times, found = _rows_in_utc(index, grid, row_minutes, profile.where)
        problems += found
        if not found:
            values = pd.Series(profile.values.to_numpy(float), times)
            done.append(replace(profile, values=values))
    if problems:
        raise InputError(folded(dict.fromkeys(problems)))
    return done


def _rows_in_utc(
    index: pd.Index, grid: TimeGrid, row_minutes: float | None, where: str
) -> tuple[pd.DatetimeIndex, list[Problem]]:
    """Times of rows that are only counted; the first begins with the scenario."""
    if row_minutes is None:
        return pd.DatetimeIndex([], tz="UTC"), [
            Problem(
                where,
                "has rows without times",
                "Say how long a row is with --profile-step, in minutes; the first begins with the "
                "scenario.",
            )
        ]
    times = pd.date_range(grid.start, periods=len(index), freq=pd.Timedelta(minutes=row_minutes))
    return times.tz_convert("UTC"), []


@dataclass(frozen=True, eq=False)
class Series:
    """Series of a new scenario, (T, C), (T, P), and (T,) for given ones of the feeder."""

    load_kw: Floats
    pv_kw: Floats
    system: dict[str, Floats] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def _together(problems: list[Problem]) -> Iterator[Problem]:
    """Problems that several series of a file have alike, each told once."""
    alike: dict[tuple[Any, ...], list[Problem]] = {}
    for one in problems:
        alike.setdefault((one.where, one.message, one.cure, one.value), []).append(one)
    for first, *others in alike.values():
        if others:
            fields = [str(one.field) for one in (first, *others)]
            first = replace(first, field="time", message=f"{first.message} ({named(fields, 5)})")
        yield first


@dataclass(frozen=True)
class _Target:
    """Target of a series: one position of a kind, and the power that 1 pu means."""

    kind: str
    at: int
    rating_kw: float


def place_profiles(
    profiles: list[Profile],
    feeder: ImportedFeeder,
    assets: NewAssets,
    shapes: tuple[Floats, Floats],
    grid: TimeGrid,
    most_gap_min: float,
) -> Series:
    """Series on the grid, by customer and system.

    A series is for a customer or a system of the scenario, by identifier, or for an element of the
    source, by its label such as ``load 3`` or its name; elements behind one customer add up. What
    has no series follows ``shapes``.

    ``shapes`` are the loads as shares of their peaks (T,) and the systems' power in kW (T, P); gaps
    of at most ``most_gap_min`` are filled.
    """
    sorter = _Sorter(feeder, assets)
    placed = _Placed(grid, most_gap_min)
    problems = placed.problems
    for profile in profiles:
        target = sorter.target(profile)
        if isinstance(target, Problem):
            problems.append(target)
        else:
            placed.add(profile, target)
    problems += units_missing(placed.without_unit)
    customers, pv, peak_kw, table = assets.customers, assets.pv, assets.peak_kw, assets.generators
    loads = [np.flatnonzero(feeder.loads.bus == bus).tolist() for bus in customers.bus]
    load_kw, invented = _by_owner(
        placed.kw, ("customer", "load"), loads, feeder.loads.p_kw, peak_kw,
        np.outer(shapes[0], peak_kw), peak_kw,
    )  # fmt: skip
    made_of = [np.flatnonzero(table["system"] == i).tolist() for i in range(len(pv))]
    most_kw = table["p_max_kw"].to_numpy(float)
    pv_kw, without = _by_owner(
        placed.kw, ("system", "generator"), made_of, most_kw,
        np.array([most_kw[own].sum() for own in made_of]), shapes[1], pv.p_max_kw,
    )  # fmt: skip
    files = named(dict.fromkeys(profile.where for profile in profiles))
    problems += _negative(load_kw, customers.id, "customer", files, grid)
    problems += _negative(pv_kw, pv.id, "system", files, grid)
    problems += _too_large(pv_kw, pv, files, grid)
    if problems:
        raise InputError(folded(_together(problems)))
    rule = " (wind: no power; kinds other than PV: the largest)"
    notes = [
        f"{len(profiles)} series from {files}; reactive power follows power factors.",
        *placed.notes(),
        *_invented(customers.id, invented, "Load"),
        *_invented(pv.id, without, "Available power", rule),
        *placed.told_gaps(),
    ]
    return Series(load_kw, np.minimum(pv_kw, pv.p_max_kw), placed.system, tuple(notes))


_UNUSED = {
    "battery": "Series of batteries are not followed, as batteries are dispatched",
    "set": "Series of generating sets are not followed, as they are dispatched",
    "left out": "Series of elements that the scenario does not have",
}


@dataclass
class _Placed:
    """Series on the grid by kind and position of their targets, and what there is to tell."""

    grid: TimeGrid
    most_gap_min: float
    kw: dict[tuple[str, int], Floats] = field(default_factory=dict)
    system: dict[str, Floats] = field(default_factory=dict)  #: series of the feeder as a whole
    problems: list[Problem] = field(default_factory=list)
    without_unit: list[Profile] = field(default_factory=list)
    as_energy: list[Profile] = field(default_factory=list)
    gaps: list[str] = field(default_factory=list)
    unused: dict[str, list[str]] = field(default_factory=dict)

    def add(self, profile: Profile, target: _Target) -> None:
        """Place a series, or note why it has no place."""
        of_feeder = target.kind == OF_FEEDER
        if not (profile.unit or of_feeder):
            self.without_unit.append(profile)
            return
        if target.kind in _UNUSED:
            self.unused.setdefault(target.kind, []).append(profile.name)
            return
        found = on_grid(profile.values, self.grid, self.most_gap_min, profile.where, profile.name)
        if isinstance(found, Problem):
            self.problems.append(found)
            return
        if found.filled:
            size = f"{found.filled} values, up to {found.longest_gap_min:g} min"
            self.gaps.append(f"{profile.name} ({size})")
        if of_feeder:
            self.system[profile.name] = found.values
            return
        key = (target.kind, target.at)
        if profile.unit in _KWH:
            self.as_energy.append(profile)
        if key in self.kw:
            fault = "has a series already", "Keep one series for each element."
            self.problems.append(_problem(profile, *fault))
        elif profile.unit in _KWH and _is_register(profile):
            cure = "It is a meter's register: give the energy of each interval."
            self.problems.append(_problem(profile, "is energy that never falls", cure))
        else:
            self.kw[key] = profile.factor * _scale(profile, target) * found.values

    def notes(self) -> Iterator[str]:
        """Sentences on energy that became power, and on series without an effect."""
        names: dict[float, list[str]] = {}
        for profile in self.as_energy:
            names.setdefault(_interval_h(profile), []).append(profile.name)
        for hours, of_them in names.items():
            yield (
                f"Energy from each time to the next, {60.0 * hours:g} min later, became mean "
                f"power: {named(of_them)}."
            )
        yield from (f"{_UNUSED[kind]}: {named(unused)}." for kind, unused in self.unused.items())

    def told_gaps(self) -> Iterator[str]:
        """Sentence on gaps that were filled."""
        if self.gaps:
            yield (
                "Missing values of the series lie on a straight line between their neighbours: "
                f"{named(self.gaps)}."
            )


class _Sorter:
    """Knows what every name stands for."""

    def __init__(self, feeder: ImportedFeeder, assets: NewAssets) -> None:
        self.known: dict[str, list[_Target]] = {}
        for name in OF_SYSTEM:
            self._add(name, _Target(OF_FEEDER, 0, 1.0))
        for i, name in enumerate(assets.customers.id):
            self._add(str(name), _Target("customer", i, float(assets.peak_kw[i])))
        for i, name in enumerate(assets.pv.id):
            self._add(str(name), _Target("system", i, float(assets.pv.p_max_kw[i])))
        for kind, units in (("battery", assets.batteries), ("set", assets.gensets)):
            for name in units.id:
                self._add(str(name), _Target(kind, 0, 1.0))
        customers = set(assets.customers.bus)
        for i, name in enumerate(feeder.loads.id):
            kind = "load" if feeder.loads.bus[i] in customers else "left out"
            target = _Target(kind, i, float(feeder.loads.p_kw[i]))
            if assets.of_load[i] >= 0:
                target = _Target("customer", int(assets.of_load[i]), target.rating_kw)
            self._add_element(str(name), target)
        table = assets.generators
        parts = Counter(table["system"])
        columns = (table[name] for name in ("id", "p_max_kw", "system", "genset"))
        for i, (name, p_max_kw, position, genset) in enumerate(zip(*columns, strict=True)):
            kind = "generator" if position >= 0 else "set" if genset else "left out"
            target = _Target(kind, 0 if kind == "set" else i, float(p_max_kw))
            if parts[position] == 1 and position >= 0:
                target = _Target("system", int(position), float(p_max_kw))
            self._add_element(str(name), target)
        for name in feeder.storages.id:
            self._add_element(str(name), _Target("battery", 0, 1.0))
        self.suggestions = Suggestions(
            [*assets.customers.id, *assets.pv.id, *self.known],
            "Name a customer or system of the scenario, or an element of the network.",
        )

    def _add_element(self, label: str, target: _Target) -> None:
        """An element by its label, by table and index, and by its name."""
        short, _, name = label.partition(" (")
        for text in dict.fromkeys((label, short, name.removesuffix(")"))):
            if text:
                self._add(text, target)

    def _add(self, name: str, target: _Target) -> None:
        targets = self.known.setdefault(name, [])
        # A customer that has the name of its load, a system that has that of its generator.
        if all((each.kind, each.at) != (target.kind, target.at) for each in targets):
            targets.append(target)

    def target(self, profile: Profile) -> _Target | Problem:
        """Target of a series, or why it has none."""
        found = self.known.get(profile.name, [])
        if len(found) == 1:
            return found[0]
        if found:
            message = f"is the name of {len(found)} elements of the network"
            cure = "Use the label, such as 'load 3'."
        else:
            message = "is neither an asset of the scenario nor an element of the network"
            cure = self.suggestions.cure(profile.name)
        if not found and (unit := other_unit(profile.name)):
            message = f"is in {unit}, and series are power in kW, MW or pu, or energy in kWh"
            cure = f"Convert it. {UNITS_CURE}."
        return _problem(profile, message, cure)


def _scale(profile: Profile, target: _Target) -> float:
    """KW for a value of the series."""
    if profile.unit in _KWH:
        return _KWH[profile.unit] / _interval_h(profile)
    return _KW.get(profile.unit, target.rating_kw)


def _interval_h(profile: Profile) -> float:
    """Time between two values of a series in h."""
    return usual_step(pd.DatetimeIndex(profile.values.index)) / pd.Timedelta(hours=1)


def _is_register(profile: Profile) -> bool:
    """Whether energy is what a meter has counted so far."""
    counted = profile.values.dropna().to_numpy(float)
    rises = np.diff(counted)
    return len(counted) >= _REGISTER_VALUES and bool((rises >= 0.0).all() and rises.any())


def _problem(profile: Profile, message: str, cure: str) -> Problem:
    """Error of a series, by its column, or by the name that its rows have."""
    field = "column" if profile.column else "id"
    value = profile.column or profile.name
    return Problem(profile.where, message, cure, field=field, value=value)


def _by_owner(
    placed: dict[tuple[str, int], Floats],
    kinds: tuple[str, str],
    parts: list[list[int]],
    part_kw: Floats,
    whole_kw: Floats,
    profile_kw: Floats,
    size_kw: Floats,
) -> tuple[Floats, list[int]]:
    """Power of customers or systems, (T, P), and those of them that follow their profile.

    Each has its own series, or the sum of those of its parts in the source, and of its profile,
    which is for its size, what no series is for.
    """
    owner, part = kinds
    found_kw, following = profile_kw.copy(), []
    for i, own in enumerate(parts):
        if (owner, i) in placed:
            found_kw[:, i] = placed[owner, i]
            continue
        given = [each for each in own if (part, each) in placed]
        rest_kw = whole_kw[i] - part_kw[given].sum()
        rest_kw = rest_kw if abs(rest_kw) > LEAST_KW else 0.0
        if not given or rest_kw:
            following.append(i)
        if given:
            series_kw = np.sum([placed[part, each] for each in given], axis=0)
            found_kw[:, i] = series_kw + profile_kw[:, i] * rest_kw / size_kw[i]
    return found_kw, following


def _invented(names: Names, following: list[int], what: str, rule: str = "") -> Iterator[str]:
    """Sentence on profiles instead of series that were not given."""
    if following:
        of = "all of them" if len(following) == len(names) else named(names[following])
        yield f"Invented: {what} without a series follows one bundled summer day{rule}: {of}."


FROM_ZERO = {
    "customer": "Demand counts from 0: give generation as a system of its own.",
    "system": "Generation counts from 0: write 0 where the system draws power.",
}
"""Cures of a series below zero."""


def _negative(values: Floats, names: Names, what: str, files: str, grid: TimeGrid) -> list[Problem]:
    """Assets whose series falls below zero."""
    return [
        Problem(
            files,
            f"falls to {values[:, i].min():.4g} kW at "
            f"{iso(grid.times[int(values[:, i].argmin())])}",
            FROM_ZERO[what],
            field=what,
            value=names[i],
        )
        for i in np.flatnonzero((values < -1e-9).any(axis=0))
    ]


def _too_large(pv_kw: Floats, pv: PVSystems, files: str, grid: TimeGrid) -> list[Problem]:
    """Systems whose series exceeds their largest power."""
    most = pv_kw.max(axis=0, initial=0.0)
    return [
        Problem(
            files,
            f"reaches {most[i]:.4g} kW at {iso(grid.times[int(pv_kw[:, i].argmax())])}, and its "
            f"largest power is {pv.p_max_kw[i]:.4g} kW",
            "Correct the unit of the series, or the power in the network.",
            field="system",
            value=pv.id[i],
        )
        for i in np.flatnonzero(most > pv.p_max_kw * (1.0 + RATING_TOLERANCE))
    ]

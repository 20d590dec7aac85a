"""Customers, generators and batteries of a new scenario: the source's, and what is asked for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pandas as pd

from vppres.core.arrays import Flags, Floats, Names, Wholes
from vppres.core.text import named
from vppres.feeders.feeder import ImportedFeeder
from vppres.feeders.net.names import identifiers, name_in
from vppres.feeders.new.connections import battery_of, loads_of
from vppres.feeders.new.gensets import NewSets, sets_of, taken
from vppres.feeders.new.kinds import PV, burns_fuel, kind_of
from vppres.feeders.new.options import (
    BATTERY_KWH_PER_PEAK_KW,
    PV_SHARE_OF_BUSES,
    PV_SHARE_OF_PEAK,
    TIER_SHARES,
    NewScenarioOptions,
)
from vppres.io import schema
from vppres.kinds.gensets.data import Gensets
from vppres.scenario.assets import TIER_WEIGHTS, Batteries, Customers, PVSystems

DECIMALS = 6
POWER_FACTOR_DECIMALS = 9
"""Near 1 a power factor needs them: 1 - 1e-9 still has 0.004 % of reactive power."""

ONE_TIER = {"all": 1.0}
"""The tier of all customers where neither the source nor a draw tells them apart."""

LAST_TIER = "low"
"""Tier of the loads that a source with tiers leaves open."""

PV_INVERTER_RATIO = 1.1
BATTERY_INVERTER_RATIO = 1.15
# The paper's fleet: 1.272 MW for 2.542 MWh.
BATTERY_KW_PER_KWH = 0.5


@dataclass(frozen=True, eq=False)
class NewAssets:
    """Assets of a new scenario."""

    #: The tables.
    customers: Customers
    pv: PVSystems
    batteries: Batteries
    gensets: Gensets
    tiers: dict[str, float]  #: tiers and their weights, most important first
    peak_kw: Floats  #: load of each customer in the source, (C,)
    #: Position of the system that each generator of the source is a part of, (G,); -1 for none.
    of_generator: Wholes
    #: Position of the customer that each load of the source is, (E,); -1 for a part of one, or
    #: none.
    of_load: Wholes
    notes: tuple[str, ...]  #: what was chosen, drawn or left out, in sentences
    set_labels: dict[str, str]  #: labels of the source by the sets that are made of its generators


def new_assets(feeder: ImportedFeeder, options: NewScenarioOptions) -> NewAssets:
    """The source's assets, with what the options ask to add."""
    draw_tier, draw_pv = (np.random.default_rng([options.seed, i]) for i in range(2))
    if feeder.phased is None:
        connections = connections_of(feeder)
    else:
        connections = loads_of(feeder.phased, len(feeder.loads.id))
    peak_kw = connections["p_kw"].to_numpy(float)
    tier, tiers = _tiers(connections["tier"].to_numpy(dtype=object), options, draw_tier)
    customers = _customers(connections, tier, tiers)
    table = generator_table(feeder)
    kept = _kept(table, options)
    taken = {str(name) for name in customers.id}
    grouped = _own_systems(table[kept], feeder.named)
    grouped["id"] = _apart(grouped["id"], grouped["kind"].replace(PV, "PV"), taken)
    before = 0
    if options.pv == "sized":
        sized = _sized_pv(customers, peak_kw, options, draw_pv, feeder.named)
        before = len(sized)
        pv = _joined(sized, _systems(grouped, customers, {*sized.customer}))
    else:
        pv = _systems(grouped, customers, set())
    engines = sets_of(table, feeder.phased)
    sets = _own_sets(engines, feeder.named, taken)
    set_labels = dict(zip(map(str, sets.sets.id), map(str, engines["id"]), strict=True))
    own = _own_batteries(feeder)
    own = replace(own, id=_apart(own.id, ["battery"] * len(own), taken))
    added = _added_batteries(customers, peak_kw, options, set(own.id), feeder.named)
    notes = [
        _told_tiers(feeder, tier, tiers, options),
        *_told_generators(feeder, pv, options),
        *sets.told(),
        *_told_batteries(own, added, sets.sets.grid_forming),
        *_told_merged(feeder, connections),
        *_told_loads(feeder),
    ]
    of_generator = _positions(table, kept, grouped, before)
    batteries = _joined(own, added)
    if sets.sets.grid_forming.any() and feeder.phased is None:
        # Where a set is named, a battery that comes first has to be named too.
        batteries = replace(batteries, grid_forming=batteries.formers)
        notes += _told_former(batteries)
    of_load = connections.attrs["of_load"]
    tables = (customers, pv, batteries, sets.sets)
    return NewAssets(*tables, tiers, peak_kw, of_generator, of_load, tuple(notes), set_labels)


def written(values: Floats) -> Floats:
    """Numbers without the noise of their arithmetic, so that a person can read the files."""
    return np.round(values, DECIMALS)


def _tiers(
    given: Names, options: NewScenarioOptions, draw: np.random.Generator
) -> tuple[Names, dict[str, float]]:
    """Tier of each customer: the source's, drawn if that is asked, else one tier for all."""
    tier = given.copy()
    free = np.flatnonzero(tier == "")
    if options.draw_tiers:
        shares = options.tier_shares or TIER_SHARES
        tier[draw.permutation(free)] = _drawn_tiers(len(free), shares)
        return tier, TIER_WEIGHTS
    if len(free) == len(tier):
        tier[:] = next(iter(ONE_TIER))
        return tier, ONE_TIER
    tier[free] = LAST_TIER
    return tier, TIER_WEIGHTS


def _drawn_tiers(count: int, shares: tuple[float, float, float]) -> list[str]:
    """Tiers by count: shares rounded, the lowest tier takes what is left."""
    names = list(TIER_WEIGHTS)
    first = round(shares[0] * count)
    second = min(round(shares[1] * count), count - first)
    return [names[0]] * first + [names[1]] * second + [names[2]] * (count - first - second)


def _told_tiers(
    feeder: ImportedFeeder, tier: Names, tiers: dict[str, float], options: NewScenarioOptions
) -> str:
    if len(tiers) == 1:
        name = next(iter(tiers))
        those = f"All {len(tier)} customers are in one tier, {name}"
        if len(tier) == 1:
            those = f"The only customer is in tier {name!r}"
        return f"{those}: the source names none, and none was drawn."
    count = ", ".join(f"{int((tier == name).sum())} {name}" for name in tiers)
    given = bool(feeder.tier.any())
    if not options.draw_tiers:
        origin = f"from the source's column `tier`; customers without a tier there are {LAST_TIER}"
    elif given:
        origin = f"from the source's column `tier`; the others are drawn, seed {options.seed}"
    else:
        origin = f"drawn, seed {options.seed}"
    return f"Customers: {count} (tiers {origin})."


def connections_of(feeder: ImportedFeeder) -> pd.DataFrame:
    """Loads that become customers: one a bus, or the source's loads with their names.

    Columns ``id``, ``bus``, ``p_kw``, ``q_kvar`` and ``tier``; ``attrs["of_load"]`` has the row of
    each load of the source, -1 for none. Where loads are not the customers of a bus one by one,
    because one gives power or a ward draws too, the bus has one customer.
    """
    loaded = np.flatnonzero(feeder.p_load_kw > 0)
    at_bus = pd.DataFrame(
        {
            "bus": feeder.network.buses[loaded],
            "p_kw": feeder.p_load_kw[loaded],
            "q_kvar": feeder.q_load_kvar[loaded],
            "tier": feeder.tier[loaded],
        }
    )
    of_load = np.full(len(feeder.loads.id), -1, dtype=int)
    if not feeder.named:
        found = at_bus.assign(id=_ids("c", at_bus["bus"].to_numpy(dtype=object)))
        found.attrs["of_load"] = of_load
        return found
    rows: list[dict[Any, Any]] = []
    for row in at_bus.to_dict("records"):
        loads = _customers_among(feeder, row)
        if not len(loads):
            rows.append({**row, "id": f"c{row['bus']}", "label": f"c{row['bus']}"})
        for load in loads:
            of_load[load] = len(rows)
            label = str(feeder.loads.id[load])
            power = {"p_kw": feeder.loads.p_kw[load], "q_kvar": feeder.loads.q_kvar[load]}
            named = {"id": name_in(label), "label": label.partition(" (")[0]}
            rows.append({**row, **power, **named, "tier": feeder.loads.tier[load]})
    found = pd.DataFrame(rows, columns=["id", "label", *at_bus.columns])
    found["id"] = identifiers([*found["id"]], [*found["label"]])
    found.attrs["of_load"] = of_load
    return found


def _customers_among(feeder: ImportedFeeder, at_bus: Mapping[Any, Any]) -> Wholes:
    """Loads of a bus that are its customers; none where they are not all of its demand."""
    loads = feeder.loads
    mine = np.flatnonzero((loads.bus == at_bus["bus"]) & ((loads.p_kw != 0) | (loads.q_kvar != 0)))
    size = np.hypot(loads.p_kw[mine], loads.q_kvar[mine])
    owned = loads.p_kw[mine] > schema.MIN_POWER_FACTOR * size
    rest = (loads.p_kw[mine].sum() - at_bus["p_kw"], loads.q_kvar[mine].sum() - at_bus["q_kvar"])
    return mine if owned.all() and np.hypot(*rest) < schema.MIN_KW else mine[:0]


def _customers(connections: pd.DataFrame, tier: Names, tiers: dict[str, float]) -> Customers:
    """Customers of a scenario."""
    bus = connections["bus"].to_numpy(dtype=object)
    p_kw, q_kvar = (connections[name].to_numpy(float) for name in ("p_kw", "q_kvar"))
    leading = np.where(q_kvar < 0, -1.0, 1.0)
    return Customers(
        id=connections["id"].to_numpy(dtype=object),
        bus=bus,
        tier=tier,
        weight=np.array([tiers[t] for t in tier]),
        power_factor=leading * np.round(p_kw / np.hypot(p_kw, q_kvar), POWER_FACTOR_DECIMALS),
    )


def _told_merged(feeder: ImportedFeeder, connections: pd.DataFrame) -> Iterator[str]:
    """Customers that are several loads of the source, of several tiers."""
    if feeder.phased is not None:
        return  # loads are customers one by one
    loads = feeder.loads
    merged = (connections.attrs["of_load"] < 0) & ((loads.p_kw != 0) | (loads.q_kvar != 0))
    found = []
    for name, bus, tier in zip(*(connections[c] for c in ("id", "bus", "tier")), strict=True):
        mine = np.flatnonzero(merged & (loads.bus == bus))
        if len({loads.tier[load] for load in mine}) > 1 and tier:
            each = [f"{loads.id[load]}: {loads.tier[load] or LAST_TIER}" for load in mine]
            found.append(f"{name} ({tier}; {named(each)})")
    if found:
        cure = "" if feeder.named else " With --source-names each load is a customer of its own."
        yield f"Customers that merge loads of several tiers have the highest: {named(found)}.{cure}"


def _told_loads(feeder: ImportedFeeder) -> Iterator[str]:
    """Sentence on loads of the source that no customer of the scenario owns."""
    if feeder.phased is not None:
        left = [
            f"{load.kind} {load.connection.id} ({load.p_kw:.4g} kW, {load.q_kvar:.4g} kvar)"
            for load in feeder.phased.loads
            if not load.p_kw > 0 and (load.p_kw or load.q_kvar)
        ]
        if left:
            yield (
                "Left out, as the feeder keeps its phases and a customer needs active power: "
                f"{named(left)}."
            )
        return
    net = feeder.network
    fixed = np.flatnonzero((net.p_fixed_kw != 0) | (net.q_fixed_kvar != 0))
    if len(fixed):
        sizes = [
            f"{net.buses[n]} ({net.p_fixed_kw[n]:.4g} kW, {net.q_fixed_kvar[n]:.4g} kvar)"
            for n in fixed
        ]
        yield f"Drawn in every step and owned by no customer: bus {named(sizes)}."


def generator_table(feeder: ImportedFeeder) -> pd.DataFrame:
    """Generators of the source with their kind, and why the scenario has them or not.

    Columns ``id``, ``bus``, ``kind``, ``p_kw``, ``p_max_kw``, ``p_min_kw``, ``s_kva`` and
    ``counterpart``, those that are PV systems of the scenario.
    """
    own = feeder.generators
    kind = [kind_of(str(w), name_in(i)) for w, i in zip(own.kind, own.id, strict=True)]
    table = pd.DataFrame(
        {f.name: getattr(own, f.name) for f in fields(own)} | {"kind": kind}, dtype=object
    ).astype(dict.fromkeys(("p_kw", "p_max_kw", "p_min_kw", "s_kva"), float))
    fuelled = table["kind"].map(burns_fuel).astype(bool)
    return table.assign(counterpart=~fuelled & (table["p_max_kw"] >= schema.MIN_KW))


def _kept(table: pd.DataFrame, options: NewScenarioOptions) -> Flags:
    """Generators of the source that the scenario takes, (G,)."""
    keep = table["counterpart"].to_numpy(bool)
    if options.pv == "sized":
        return np.asarray(keep & (table["kind"] != PV).to_numpy(bool))
    return keep & (options.pv == "existing")


def _own_systems(kept: pd.DataFrame, named: bool) -> pd.DataFrame:
    """The source's systems by bus and kind: largest power and inverter.

    With names, a system that is one generator of the source keeps its name.
    """
    at_bus = kept.groupby(["bus", "kind"], sort=False)
    grouped = at_bus[["p_max_kw", "s_kva"]].sum().reset_index()
    words = zip(grouped["kind"], grouped["bus"], strict=True)
    ids = [f"{kind.replace(' ', '_')}{bus}" for kind, bus in words]
    if named and len(kept):
        alone = at_bus["id"].agg(lambda of: name_in(of.iloc[0]) if len(of) == 1 else "")
        ids = identifiers([str(name) for name in alone], ids)
    return grouped.assign(id=_distinct(_names(ids)))


def _own_sets(rows: pd.DataFrame, named: bool, taken: set[str]) -> NewSets:
    """The source's generating sets, each for itself."""
    ids = [f"{kind}{bus}" for kind, bus in zip(rows["kind"], rows["bus"], strict=True)]
    if named:
        ids = identifiers([name_in(str(name)) for name in rows["id"]], ids)
    sizes = written(rows[["p_max_kw", "p_min_kw"]].to_numpy(float)).T
    rows = rows.assign(p_max_kw=sizes[0], p_min_kw=sizes[1])
    return NewSets.of(
        rows, [str(name) for name in _apart(_distinct(_names(ids)), rows["kind"], taken)]
    )


def _positions(table: pd.DataFrame, kept: Flags, grouped: pd.DataFrame, before: int) -> Wholes:
    """Position of each generator's system, after those that were sized; -1 for none, (G,)."""
    pairs = zip(grouped["bus"], grouped["kind"], strict=True)
    position = {pair: before + i for i, pair in enumerate(pairs)}
    return np.array(
        [
            position[bus, kind] if keep else -1
            for bus, kind, keep in zip(table["bus"], table["kind"], kept, strict=True)
        ],
        dtype=int,
    )


def _systems(own: pd.DataFrame, customers: Customers, supplied: set[object]) -> PVSystems:
    """The source's systems: one behind each customer's meter, PV before other kinds.

    Further kinds at a customer's bus, systems at buses without a customer or with several, and
    those of customers that are supplied by another one stand alone.
    """
    after_pv = np.argsort((own["kind"] != PV).to_numpy(int), kind="stable")
    first = own.iloc[after_pv].drop_duplicates("bus").index
    at_bus = Counter(customers.bus)
    pairs = zip(customers.bus, customers.id, strict=True)
    owner = {bus: name for bus, name in pairs if at_bus[bus] == 1 and name not in supplied}
    owned = own.index.isin(first) & own["bus"].isin([*owner]).to_numpy(bool)
    s_kva = written(own["s_kva"].to_numpy(float))
    return PVSystems(
        id=own["id"].to_numpy(dtype=object),
        customer=np.where(owned, own["bus"].map(owner), ""),
        p_max_kw=np.minimum(written(own["p_max_kw"].to_numpy(float)), s_kva),
        s_max_kva=s_kva,
        kind=own["kind"].to_numpy(dtype=object),
        bus=own["bus"].astype(object).mask(owned, None).to_numpy(),
    )


def _sized_pv(
    customers: Customers,
    peak_kw: Floats,
    options: NewScenarioOptions,
    draw: np.random.Generator,
    named: bool,
) -> PVSystems:
    """PV at some of the customers, sized by their peak load."""
    kw_per_kw = options.pv_share_of_peak or PV_SHARE_OF_PEAK
    chosen = draw.permutation(len(customers))[: round(PV_SHARE_OF_BUSES * len(customers))]
    p_kw = np.zeros(len(customers))
    p_kw[chosen] = kw_per_kw * peak_kw[chosen]
    p_kw = written(p_kw)
    has = np.flatnonzero(p_kw > 0)
    return PVSystems(
        id=_ids("PV of ", customers.id[has]) if named else _ids("pv", _stems(customers)[has]),
        customer=customers.id[has],
        p_max_kw=p_kw[has],
        s_max_kva=written(PV_INVERTER_RATIO * p_kw[has]),
    )


def _own_batteries(feeder: ImportedFeeder) -> Batteries:
    """The source's batteries, each for itself."""
    own = feeder.storages
    ids = _distinct(_ids("b", own.bus))
    if feeder.named:
        ids = _names(identifiers([name_in(str(name)) for name in own.id], [*ids]))
    if feeder.phased is not None:  # each has phases of its own
        ids = _names([battery_of(name_in(str(name))) for name in own.id])
    given = ("soc_min", "soc_max", "soc_initial", "eta_charge", "eta_discharge")
    return _batteries(
        id=ids,
        bus=own.bus,
        **{name: written(getattr(own, name)) for name in ("energy_kwh", "p_max_kw", "s_max_kva")},
        **{name: written(getattr(own, name)) for name in given},
    )


def _added_batteries(
    customers: Customers,
    peak_kw: Floats,
    options: NewScenarioOptions,
    taken: set[str],
    named: bool,
) -> Batteries:
    """A battery at every customer, sized by its peak load; the format's defaults elsewhere."""
    size = options.battery_kwh_per_peak_kw
    size = BATTERY_KWH_PER_PEAK_KW if size is None else size
    energy_kwh = written((size if options.add_batteries else 0.0) * peak_kw)
    has = np.flatnonzero(energy_kwh > 0)
    p_kw = written(BATTERY_KW_PER_KWH * energy_kwh[has])
    names = [f"b{name}" for name in _stems(customers)[has]]
    if named:
        names = [f"battery of {name}" for name in customers.id[has]]
    return _batteries(
        id=np.array([f"{n}_added" if n in taken else n for n in names], dtype=object),
        bus=customers.bus[has],
        energy_kwh=energy_kwh[has],
        p_max_kw=p_kw,
        s_max_kva=written(BATTERY_INVERTER_RATIO * p_kw),
    )


def _batteries(**columns: Any) -> Batteries:
    """Batteries with the format's defaults in the columns that are not given."""
    count = len(columns["id"])
    for name, field in schema.BatteryRow.model_fields.items():
        if not field.is_required():
            default = np.nan if field.default is None else field.default
            columns.setdefault(name, np.full(count, default))
    if np.isnan(columns["soc_initial"]).all():
        columns["soc_initial"] = columns["soc_min"]
    columns["grid_forming"] = np.zeros(count, dtype=bool)
    return Batteries(**columns)


def _joined(first: Any, second: Any) -> Any:
    """Two tables of the same assets as one."""
    return type(first)(
        **{
            f.name: np.concatenate([getattr(first, f.name), getattr(second, f.name)])
            for f in fields(first)
        }
    )


def _told_generators(
    feeder: ImportedFeeder, pv: PVSystems, options: NewScenarioOptions
) -> Iterator[str]:
    """Systems of the scenario, what was sized, and generators that the scenario does not have."""
    if len(pv) == 0:
        yield (
            "No generator: the source has none at a supplied bus that the scenario can hold, and "
            "none was sized."
        )
    else:
        alone = [str(name) for name in pv.id[pv.alone]]
        yield (
            f"{pv.counted()}, {pv.p_max_kw.sum():,.1f} kW"
            + (" (PV invented by size)" if options.pv == "sized" else " (the source's)")
            + (f"; without a customer, all exported or curtailed: {named(alone)}" if alone else "")
            + "."
        )
    table = generator_table(feeder)
    yield from _told_fuelled(table, taken(table, feeder.phased))
    yield from _told_replaced(table, options)
    larger = table["counterpart"] & (table["p_max_kw"] > table["s_kva"] * (1 + 1e-9))
    if larger.any():
        yield f"Generators keep to their inverter's rating: {named(table['id'][larger])}."


def _told_fuelled(table: pd.DataFrame, sets: pd.Series[bool]) -> Iterator[str]:
    """Generators without a counterpart: what they are, how large, and what is missing without."""
    fuelled = table[table["kind"].map(burns_fuel).astype(bool)]
    left = fuelled[~sets[fuelled.index]]
    if len(left):
        names = named(
            f"{name}, {kind}, {p_kw:.4g} kW"
            for name, kind, p_kw in zip(left["id"], left["kind"], left["p_max_kw"], strict=True)
        )
        yield (
            f"Generators with a fuel of their own are left out: {names}. They are missing in an "
            "island."
        )
    if fuelled["p_kw"].any():
        yield (
            f"The {fuelled['p_kw'].sum():.4g} kW that generators with a fuel give in the source "
            "come from the grid here."
        )
    drawing = table[~table["counterpart"] & (table["p_max_kw"] < schema.MIN_KW)]
    drawing = drawing.drop(fuelled.index, errors="ignore")
    if len(drawing):
        yield f"Generators that give no active power are left out: {named(drawing['id'])}."


def _told_replaced(table: pd.DataFrame, options: NewScenarioOptions) -> Iterator[str]:
    """Generators of the source that the options leave out."""
    out = table[table["counterpart"] & (options.pv != "existing")]
    if options.pv == "sized":
        out = out[out["kind"] == PV]
    if len(out):
        yield (
            f"Generators of the source that --pv {options.pv} leaves out: {named(out['id'])}, "
            f"{out['p_max_kw'].sum():.4g} kW."
        )


def _told_batteries(own: Batteries, added: Batteries, forming: Flags) -> Iterator[str]:
    """Batteries of the source, and those that were added, beside sets that form the grid."""
    if len(own):
        yield f"{_amount(own)} of the source."
    if len(added):
        yield f"{_amount(added)} invented, sized by the customers' peak loads."
    if not len(own) and not len(added):
        without = "" if forming.any() else " Without one no island has a grid."
        yield f"No battery: the source has none at a supplied bus, and none was added.{without}"


def _told_former(batteries: Batteries) -> Iterator[str]:
    """Which battery comes before the sets."""
    if batteries.grid_forming.any():
        yield (
            f"Chosen: {named(batteries.id[batteries.grid_forming])} forms the grid of an island "
            "before a generating set does, because it has the largest inverter. Correct "
            "grid_forming in batteries.csv."
        )


def _amount(batteries: Batteries) -> str:
    count = len(batteries)
    return (
        f"{count} {'battery' if count == 1 else 'batteries'} of "
        f"{batteries.energy_kwh.sum():,.1f} kWh and {batteries.p_max_kw.sum():,.1f} kW"
    )


def _stems(customers: Customers) -> Names:
    """Stems of the customers' names: their bus, or their load."""
    return np.array([str(name)[1:] for name in customers.id], dtype=object)


def _ids(prefix: str, buses: Names) -> Names:
    """Identifiers of assets, after their bus."""
    return np.array([f"{prefix}{bus}" for bus in buses], dtype=object)


def _names(values: Sequence[str]) -> Names:
    return np.array([*values], dtype=object)


def _distinct(names: Names) -> Names:
    """Names, the second of the same as ``name_2`` and so on."""
    series = pd.Series(names, dtype=object)
    number = series.groupby(series).cumcount() + 1
    return np.where(number > 1, series + "_" + number.astype(str), series).astype(object)


def _apart(names: Iterable[Any], kinds: Iterable[str], taken: set[str]) -> Names:
    """Names, with their kind where another asset has the same; they are ``taken`` then.

    Readings and set-points go by name. A source has names by class, so that a load, a battery and a
    PV system of one house may be called alike there.
    """
    both = zip(map(str, names), kinds, strict=True)
    found = _names([f"{kind} of {name}" if name in taken else name for name, kind in both])
    taken.update(found)
    return found

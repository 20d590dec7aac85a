"""How voltages and a former's power by phase follow set-points, in three phases.

For each source, the grid or a device that holds an island, the squared voltage of a node and the
power of each of the source's phases are linear in the powers that assets draw, around no load:
``u = offset + Mp p + Mq q``. The slopes stay as they are; the offsets are those of an AC point.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy.sparse as sp

from vppres.contract.dispatch import Dispatch
from vppres.core.arrays import Complexes, Flags, Floats, Wholes
from vppres.core.units import W_PER_KW
from vppres.model.data import WindowData
from vppres.model.parts import Parts
from vppres.model.site import Site
from vppres.physics.phased_loading import Loadings
from vppres.physics.phased_sources import (
    Fed,
    assets_of,
    buses_of,
    flow_of_former,
    flow_of_grid,
    flow_of_parts,
    measured_at,
)
from vppres.physics.phases import NoPhasedSolutionError, PhasedFlow, PhasedResult
from vppres.scenario.formers import former_kva, island_formers
from vppres.scenario.phases import PHASES

GRID, NOTHING_FORMS = 0, -1
"""Supplies of a step beside those of the formers of islands, of which the first is 1."""

SIDES = 32
"""Sides of the polygon inside a phase's disc: it takes 0.5% of the rating away."""

NOTHING: Mapping[str, Floats] = MappingProxyType({})

REACH = float(np.cos(np.pi / SIDES))
"""Distance of a side from the middle of its disc, as a share of the radius."""


class Slopes:
    """Change of one source's quantities per kW and kvar that each asset draws, at no load.

    Nothing is kept of all voltages and assets: what powers change is one solution of the network's
    equations, and so is a row of factors for one voltage.

    Attributes
    ----------
    former_p, former_q : array, shape (3, D)
        Complex power of the source's phases, of several sources one after another.
    u_0, former_0, current_0 : array
        Squared voltages, (m,), the source's power, (3,), and currents, (k,), at no load.
    """

    def __init__(self, flow: PhasedFlow, loadings: Loadings) -> None:
        self._flow = flow
        self._per_volt = loadings.per_volt
        w = flow.no_load_v
        self._across = flow.no_load_u
        ratio = np.abs(self._across) / flow.rated_v
        # Load models at the voltages there.
        self._p = _by_asset(flow, ratio**flow.p_exponent)
        self._q = _by_asset(flow, ratio**flow.q_exponent)
        self._measured = flow.measured[1]
        self._at = self._measured @ w
        self.u_0 = np.where(flow.measured_lit, np.abs(self._at), 1.0) ** 2
        self.former_0 = flow.v_held * np.conj((flow.y @ w)[flow.held]) / W_PER_KW
        self.current_0 = loadings.currents(w)
        currents = flow.coils.T[flow.held] - flow.taken_at(flow.y[flow.held])
        power = flow.v_held[:, None] * np.conj(np.asarray(currents)) / self._across[None, :]
        self.former_p: Complexes = power @ self._p
        self.former_q: Complexes = 1j * power @ self._q
        self._known: dict[tuple[bool, int], tuple[Complexes, Complexes]] = {}

    def _taken(self, p_kw: Floats, q_kvar: Floats) -> Complexes:
        """Voltages of the nodes that powers of the assets take away, (nodes, W)."""
        # A coil that draws S takes drop conj(S / U) off the voltage: kW are thousands of watts.
        drawn = self._p @ p_kw.T - 1j * (self._q @ q_kvar.T)
        return self._flow.taken(W_PER_KW * drawn / np.conj(self._across)[:, None])

    def changes(self, p_kw: Floats, q_kvar: Floats) -> tuple[Floats, Complexes]:
        """Changes by powers (W, D): squared voltages, (W, m), and the source's power, (W, 3)."""
        taken = self._measured @ self._taken(p_kw, q_kvar)
        u = -2.0 * np.real(np.conj(self._at)[:, None] * taken).T
        return np.asarray(u), p_kw @ self.former_p.T + q_kvar @ self.former_q.T

    def currents(self, p_kw: Floats, q_kvar: Floats) -> Complexes:
        """Changes of currents by powers (W, D), as shares of their ratings, (W, k)."""
        return np.asarray(-(self._per_volt @ self._taken(p_kw, q_kvar)).T)

    def of_voltages(self, places: Wholes) -> tuple[Floats, Floats]:
        """Factors of some squared voltages for each kW and kvar, (R, D) each."""
        p, q = self._rows(False, places)
        return p.real, q.real

    def of_currents(self, places: Wholes) -> tuple[Complexes, Complexes]:
        """Factors of some currents, (k, D) by active and by reactive power."""
        return self._rows(True, places)

    def of_former(self, places: Wholes) -> tuple[Complexes, Complexes]:
        """Factors of some of the source's phases, (k, D) by active and by reactive power."""
        return self.former_p[places], self.former_q[places]

    def _rows(self, of_currents: bool, places: Wholes) -> tuple[Complexes, Complexes]:
        """Factors of some places, of which those that were asked for before are known."""
        new = [at for at in np.unique(places).tolist() if (of_currents, at) not in self._known]
        if new:
            read = (self._per_volt if of_currents else self._measured)[new]
            each = W_PER_KW * self._flow.taken_at(read) / np.conj(self._across)[None, :]
            if of_currents:
                p, q = -each @ self._p, 1j * each @ self._q
            else:
                turned = -2.0 * np.conj(self._at[new])[:, None] * each
                p, q = turned.real @ self._p, turned.imag @ self._q
            for row, at in enumerate(new):
                self._known[of_currents, at] = p[row], q[row]
        rows = [self._known[of_currents, at] for at in places.tolist()]
        count = len(self._flow.assets)
        p, q = (np.array(each).reshape(len(rows), count) for each in zip(*rows, strict=True))
        return p, q


def _by_asset(flow: PhasedFlow, factor: Floats) -> Any:
    """Share of each asset's power that each coil draws, (coils, D)."""
    coils = np.arange(len(flow.asset))
    shape = (len(coils), len(flow.assets))
    return sp.csr_array((flow.share * factor, (coils, flow.asset)), shape=shape)


SupplyKey = tuple[bytes | None, Fed]
"""Number of the part of each bus, none of a feeder in one piece, and the sources of parts."""


@dataclass(frozen=True, eq=False)
class Supply:
    """A feeder and what holds its voltages: the grid or a former, of each part that has one.

    ``ratings_kva`` (S,) are those of formers, 0 of the grid; ``devices`` are the places of formers
    among the assets, and ``buses`` (S,) those of the sources among the buses.
    """

    fed: Fed
    flow: PhasedFlow
    loadings: Loadings
    ratings_kva: Floats
    devices: Wholes
    buses: Wholes

    @classmethod
    def of(cls, site: Site, fed: Fed, flow: PhasedFlow, loadings: Loadings) -> Supply:
        """The supply of a site from some sources."""
        names, at = assets_of(site), buses_of(site)
        devices = [names.index(former) for _, former in fed if former]
        buses = [at[names.index(former)] if former else site.network.buses[0] for _, former in fed]
        ratings = [former_kva(site, former) if former else 0.0 for _, former in fed]
        places = np.array([site.network.bus_index[bus] for bus in buses], dtype=int)
        of_formers = np.array(devices, dtype=int)
        return cls(fed, flow, loadings, np.array(ratings, dtype=float), of_formers, places)

    @cached_property
    def slopes(self) -> Slopes:
        """How its voltages and sources follow powers."""
        return Slopes(self.flow, self.loadings)

    @property
    def forms(self) -> Flags:
        """Phases of its sources that are those of a former, (K,)."""
        return np.repeat([bool(former) for _, former in self.fed], len(PHASES))

    def beyond(self, found: PhasedResult, p_kw: Floats, q_kvar: Floats) -> tuple[Floats, Floats]:
        """Power of each source beyond what its assets draw at rated voltage, (S,) each."""
        found_kva = found.source_kva.reshape(-1, len(PHASES)).sum(axis=1)
        kw, kvar = ([each[own].sum() for own in self.flow.supplied] for each in (p_kw, q_kvar))
        return found_kva.real - kw, found_kva.imag - kvar


@dataclass(frozen=True, eq=False)
class PhasedPoints:
    """AC points of W steps: squared voltages (W, m), sources' kVA (W, K), what the network draws.

    ``currents`` are shares of their ratings, (W, k). ``network_kw`` and ``network_kvar`` are, at
    the bus of each source, its power beyond what assets draw at rated voltage, (W, N): losses,
    capacitors, and loads that follow the voltage.
    """

    u_pu2: Floats
    source_kva: Complexes
    currents: Complexes
    network_kw: Floats
    network_kvar: Floats
    converged: Flags


class PhasedModel:
    """A site's three phases, with the grid as source and with each former of its islands.

    ``supplies`` are those of the grid, then of the ``formers``: the battery that forms islands,
    then units of kinds. Behind them are those of parts, as lines were out.
    """

    def __init__(self, site: Site) -> None:
        self.site = site
        self.formers = tuple(island_formers(site))
        self._of_parts: dict[SupplyKey, int] = {}
        phases, names, net = site.phases, assets_of(site), site.feeder
        voltages = (net.v_slack_pu, net.v_min_pu, net.v_max_pu)
        flows = [flow_of_grid(phases, names, net.v_slack_pu)]
        flows += [flow_of_former(phases, names, former, *voltages) for former in self.formers]
        of = Loadings.of if site.rated else Loadings.none
        self.supplies = [
            Supply.of(site, ((0, former),), flow, of(flow.phases))
            for former, flow in zip(("", *self.formers), flows, strict=True)
        ]

    @property
    def rated(self) -> tuple[str, ...]:
        """Names of the currents that plans limit."""
        return self.supplies[GRID].loadings.names

    @property
    def rated_kva(self) -> Floats:
        """Power that each of them carries at its rating, (k,)."""
        return self.supplies[GRID].loadings.kva

    def sources(self, data: WindowData) -> Wholes:
        """Supply of each step of a window, (W,)."""
        found = self.sources_of(data.dark, data.ahead.formers())
        for t in np.flatnonzero(data.parts.cut):
            found[t] = self.source_in(data.parts.part(slice(t, t + 1)), bool(data.dark[t]))
        return found

    def sources_of(self, island: Flags, forms: Mapping[str, Flags]) -> Wholes:
        """Supplies of steps, (...,), with units of kinds that form islands, (..., n).

        Where none does it is the first of the formers.
        """
        first = 1 if self.formers else NOTHING_FORMS
        source = np.where(island, first, GRID)
        for kind, flags in forms.items():
            for unit in np.flatnonzero(flags.any(axis=tuple(range(flags.ndim - 1)))):
                name = str(self.site.kinds[kind].id[unit])
                there = flags[..., unit] & island
                source = np.where(there, 1 + self.formers.index(name), source)
        return source

    def source_in(self, parts: Parts, island: bool, which: Flags | None = None) -> int:
        """Supply of a step in which lines are out.

        ``which`` are the buses of the parts that have a source, (N,); all that something forms if
        not given.
        """
        b, index = self.site.batteries, self.site.network.bus_index
        at = np.array([index[bus] for bus in b.bus], dtype=int)
        numbers, lit = parts.of_bus[0], ~parts.dead[0]
        lit = lit if which is None else lit & which
        forms = parts.forms[0] & lit[at]
        fed = [] if island or not lit[0] else [(0, "")]
        for number in np.unique(numbers[at[forms]]).tolist():
            kva = np.where(forms & (numbers[at] == number), b.s_max_kva, -1.0)
            fed.append((number, str(b.id[np.argmax(kva)])))
        return self.supplied(numbers, tuple(fed))

    def supplied(self, numbers: Wholes, fed: Fed) -> int:
        """Supply of parts by the number of each bus, (N,), made once."""
        if not fed:
            return NOTHING_FORMS
        numbers = np.asarray(numbers, dtype=np.int64)
        key = numbers.tobytes(), fed
        if key not in self._of_parts:
            site, net, phases = self.site, self.site.feeder, self.site.phases
            of_bus = {row.bus: int(numbers[net.bus_index[row.at]]) for row in phases.buses}
            voltages = (net.v_slack_pu, net.v_min_pu, net.v_max_pu)
            flow = flow_of_parts(phases, assets_of(site), of_bus, fed, voltages)
            loadings = self.supplies[GRID].loadings.in_parts(phases, flow.phases)
            self._of_parts[key] = len(self.supplies)
            self.supplies.append(Supply.of(site, fed, flow, loadings))
        return self._of_parts[key]

    def source_of(self, key: SupplyKey) -> int:
        """Supply of a key."""
        numbers, fed = key
        if numbers is None:
            return 1 + self.formers.index(fed[0][1])
        return self.supplied(np.frombuffer(numbers, dtype=np.int64), fed)

    def parts_in(self, data: WindowData) -> list[SupplyKey]:
        """Supplies of parts in a window."""
        there = set(self.sources(data).tolist())
        found = (key for key, source in self._of_parts.items() if source in there)
        return sorted(found, key=repr)

    def _width(self, sources: Wholes) -> int:
        """Sources of the step of a window that has the most."""
        return max([1, *(len(self.supplies[i].fed) for i in np.unique(sources) if i > GRID)])

    def _each(self, sources: Wholes) -> Iterator[tuple[Supply, Flags]]:
        """Supplies of a window that hold any voltage, and the steps of each, (W,)."""
        for source in np.unique(sources):
            if source != NOTHING_FORMS:
                yield self.supplies[source], sources == source

    def ratings_kva(self, data: WindowData) -> Floats:
        """Rating of each source in each step, (W, S), of the grid and of nothing none."""
        sources = self.sources(data)
        found = np.zeros((data.n_steps, self._width(sources)))
        for supply, steps in self._each(sources):
            found[steps, : len(supply.fed)] = supply.ratings_kva
        return found

    def headroom_kva(self, data: WindowData) -> Floats:
        """Power that a plan leaves free of each former in each step, (W, S)."""
        sources = self.sources(data)
        found = np.zeros((data.n_steps, self._width(sources)))
        of_units = (known.kept_kw().sum(axis=1) for known in data.ahead.by_kind.values())
        found[:, 0] = sum(of_units, start=found[:, 0])
        place = {str(name): i for i, name in enumerate(self.site.batteries.id)}
        for supply, steps in self._each(sources):
            for at, (_, former) in enumerate(supply.fed):
                if former in place:
                    found[steps, at] = data.physics.headroom_kw[steps, place[former]]
        return found

    def formed(self, data: WindowData) -> Flags:
        """Phases of sources in islands, (W, K): those of formers."""
        sources = self.sources(data)
        found = np.zeros((data.n_steps, len(PHASES) * self._width(sources)), dtype=bool)
        found[:, : len(PHASES)] = (data.dark & ~data.parts.cut)[:, None]
        for t in np.flatnonzero(data.parts.cut & (sources != NOTHING_FORMS)):
            forms = self.supplies[sources[t]].forms
            found[t, : len(forms)] = forms
        return found

    def limits_at(self, data: WindowData, lit: Flags) -> Flags:
        """Voltages that plans keep within limits in steps with power, (W, m): of parts with any."""
        return np.asarray(self.limited & lit[:, None] & ~data.parts.dead[:, self.at_bus])

    @cached_property
    def limited(self) -> Flags:
        """Voltages that plans keep within limits: all but those of the grid's own bus."""
        grid = self.supplies[GRID].flow
        labels, slack = grid.measured[0], grid.phases.buses[0].bus
        return np.array([bus != slack for bus, _ in labels])

    @cached_property
    def by_phase(self) -> tuple[Wholes, ...]:
        """Places of the voltages of each phase, or of each pair of phases."""
        names = np.array([phase for _, phase in self.supplies[GRID].flow.measured[0]])
        return tuple(np.flatnonzero(names == name) for name in np.unique(names))

    @cached_property
    def at_bus(self) -> Wholes:
        """Bus of the network at which each voltage is measured, (m,)."""
        return measured_at(self.site.phases, self.site.network)

    @cached_property
    def at_bus_of_assets(self) -> Wholes:
        """Bus of the network of each asset, (D,)."""
        index = self.site.network.bus_index
        return np.array([index[bus] for bus in buses_of(self.site)], dtype=int)

    def drawn(self, data: WindowData, dispatch: Dispatch) -> tuple[Floats, Floats]:
        """Power of each asset in each step, (W, D) each, its former's own power left out."""
        return self.powers(
            self.sources(data),
            load_kw=data.load_kw * dispatch.supplied,
            pv=(dispatch.pv_self_kw + dispatch.pv_export_kw, dispatch.pv_q_kvar),
            batteries=(dispatch.discharge_kw - dispatch.charge_kw, dispatch.batt_q_kvar),
            taken_kw=dispatch.taken_kw,
            given_kvar=dispatch.given_kvar,
        )

    def powers(
        self,
        source: Wholes | int,
        load_kw: Floats,
        pv: tuple[Floats, Floats],
        batteries: tuple[Floats, Floats],
        taken_kw: Mapping[str, Floats] = NOTHING,
        given_kvar: Mapping[str, Floats] = NOTHING,
    ) -> tuple[Floats, Floats]:
        """Power of each asset, (..., D) each, nothing by what is the source, (...,).

        Demand is drawn; ``pv`` and ``batteries`` are the kW and kvar that they give. Of the units
        of a kind it is what they take in kW and give in kvar, nothing where it is not said.
        """
        nothing = {
            kind: np.zeros((*load_kw.shape[:-1], len(units)))
            for kind, units in self.site.kinds.items()
        }
        taken = [taken_kw.get(kind, none) for kind, none in nothing.items()]
        given = [given_kvar.get(kind, none) for kind, none in nothing.items()]
        p = np.concatenate([load_kw, -pv[0], -batteries[0], *taken], axis=-1)
        drawn_kvar = load_kw * self.site.customers.q_per_p
        q = np.concatenate([drawn_kvar, -pv[1], -batteries[1], *(-each for each in given)], axis=-1)
        for one in np.unique(source):
            for device in self.devices(int(one)):
                p[..., device] = np.where(source == one, 0.0, p[..., device])
                q[..., device] = np.where(source == one, 0.0, q[..., device])
        return p, q

    def devices(self, source: int) -> Wholes:
        """Places of a supply's formers among the assets."""
        return self.supplies[max(source, GRID)].devices

    def solved(self, source: int, p_kw: Floats, q_kvar: Floats) -> PhasedResult | None:
        """The flow of one step; None for an island that nothing holds."""
        return None if source == NOTHING_FORMS else self.supplies[source].flow.solve(p_kw, q_kvar)

    def points(self, data: WindowData, p_kw: Floats, q_kvar: Floats, lit: Flags) -> PhasedPoints:
        """AC points of powers that assets draw, step by step; those that are not lit rest."""
        W, sources = data.n_steps, self.sources(data)
        u = np.ones((W, len(self.at_bus)))
        kva: Complexes = np.zeros((W, len(PHASES) * self._width(sources)), dtype=complex)
        currents: Complexes = np.zeros((W, len(self.rated)), dtype=complex)
        network = np.zeros((2, W, self.site.network.n_buses))
        converged = np.ones(W, dtype=bool)
        for t in np.flatnonzero(lit):
            source = int(sources[t])
            try:
                found = self.solved(source, p_kw[t], q_kvar[t])
            except NoPhasedSolutionError:
                converged[t] = False
                continue
            if found is not None:
                supply = self.supplies[source]
                u[t] = supply.flow.v_pu(found.v) ** 2
                kva[t, : len(found.source_kva)] = found.source_kva
                currents[t] = supply.loadings.currents(found.v)
                network[:, t, supply.buses] = supply.beyond(found, p_kw[t], q_kvar[t])
        return PhasedPoints(u, kva, currents, network[0], network[1], converged)

    def linear(self, data: WindowData, p_kw: Floats, q_kvar: Floats) -> tuple[Floats, Complexes]:
        """Change of squared voltages (W, m) and of the sources' complex power (W, K) by powers."""
        W, sources = data.n_steps, self.sources(data)
        u = np.zeros((W, len(self.at_bus)))
        former: Complexes = np.zeros((W, len(PHASES) * self._width(sources)), dtype=complex)
        for supply, steps in self._each(sources):
            changes = supply.slopes.changes(p_kw[steps], q_kvar[steps])
            u[steps], former[steps, : len(supply.forms)] = changes
        return u, former

    def currents(self, data: WindowData, p_kw: Floats, q_kvar: Floats) -> Complexes:
        """Change of the rated currents by powers, as shares of the rating, (W, k)."""
        found: Complexes = np.zeros((data.n_steps, len(self.rated)), dtype=complex)
        for supply, steps in self._each(self.sources(data)):
            found[steps] = supply.slopes.currents(p_kw[steps], q_kvar[steps])
        return found

    def at_no_load(self, data: WindowData) -> tuple[Floats, Complexes, Complexes]:
        """Offsets at no load, (W, m), (W, K) and (W, k)."""
        W, sources = data.n_steps, self.sources(data)
        grid = self.supplies[GRID].slopes
        u, currents = np.tile(grid.u_0, (W, 1)), np.tile(grid.current_0, (W, 1))
        former: Complexes = np.zeros((W, len(PHASES) * self._width(sources)), dtype=complex)
        for supply, steps in self._each(sources):
            u[steps], currents[steps] = supply.slopes.u_0, supply.slopes.current_0
            at_rest = np.where(supply.forms, supply.slopes.former_0, 0.0)
            former[steps, : len(at_rest)] = at_rest
        return u, former, currents

    def phase_kva(self, data: WindowData, kept_kva: Floats | float = 0.0) -> Floats:
        """Rating of each phase of the formers in each step, (W, K), less what is kept free."""
        left_kva = self.ratings_kva(data) - kept_kva
        return np.repeat(left_kva / len(PHASES), len(PHASES), axis=1)


_KNOWN: OrderedDict[str, PhasedModel] = OrderedDict()
_KEPT = 16


def phased_model(site: Site) -> PhasedModel:
    """The model of a site, made once for equal sites."""
    found = _KNOWN.pop(site.key, None) or PhasedModel(site)
    _KNOWN[site.key] = found
    while len(_KNOWN) > _KEPT:
        _KNOWN.popitem(last=False)
    return found

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
from vppres.model.site import Site
from vppres.physics.phased_loading import Loadings
from vppres.physics.phased_sources import (
    assets_of,
    flow_of_former,
    flow_of_grid,
    measured_at,
)
from vppres.physics.phases import NoPhasedSolutionError, PhasedFlow, PhasedResult
from vppres.scenario.formers import former_kva, island_formers, largest_forming_battery
from vppres.scenario.phases import PHASES

GRID, NOTHING_FORMS = 0, -1
"""Sources of a step beside the formers of islands, of which the first is 1."""

SIDES = 32
"""Sides of the polygon inside a phase's disc: it takes 0.5% of the rating away."""

NOTHING: Mapping[str, Floats] = MappingProxyType({})

REACH = float(np.cos(np.pi / SIDES))
"""Distance of a side from the middle of its disc, as a share of the radius."""


class Slopes:
    """Change of one source's quantities per kW and kvar that each asset draws, at no load.

    Nothing is kept of all voltages and assets: what powers change is one solution of the network's
    equations, and so is a row of factors for one voltage.

    Parameters
    ----------
    flow : PhasedFlow
        The network with the source.
    loadings : Loadings
        Currents that have a rating.

    Attributes
    ----------
    former_p, former_q : array, shape (3, D)
        Complex power of the source's phases.
    u_0, former_0, current_0 : array
        Squared voltages, (m,), the source's power, (3,), and currents, (k,), at no load.
    """

    def __init__(self, flow: PhasedFlow, loadings: Loadings) -> None:
        self._flow = flow
        self._per_volt = loadings.per_volt
        w = flow.no_load_v
        self._across = flow.coils @ w
        ratio = np.abs(self._across) / flow.rated_v
        # Load models at the voltages there.
        self._p = _by_asset(flow, ratio**flow.p_exponent)
        self._q = _by_asset(flow, ratio**flow.q_exponent)
        self._measured = flow.measured[1]
        self._at = self._measured @ w
        self.u_0 = np.abs(self._at) ** 2
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


@dataclass(frozen=True, eq=False)
class PhasedPoints:
    """AC points of W steps: squared voltages (W, m), source's kVA (W, 3), what the network draws.

    ``currents`` are shares of their ratings, (W, k).
    ``network_kw`` and ``network_kvar`` are the source's power beyond what assets draw at rated
    voltage: losses, capacitors, and loads that follow the voltage.
    """

    u_pu2: Floats
    source_kva: Complexes
    currents: Complexes
    network_kw: Floats
    network_kvar: Floats
    converged: Flags


@dataclass(frozen=True, eq=False)
class PhasedModel:
    """A site's three phases, with the grid as source and with each former of its islands.

    ``flows`` and ``slopes`` are those of the grid, then of the ``formers``: the battery that forms
    islands, then units of kinds. ``loadings`` are of the currents that plans limit,
    for each source.
    """

    site: Site
    flows: tuple[PhasedFlow, ...]
    formers: tuple[str, ...]
    loadings: tuple[Loadings, ...]

    @classmethod
    def of(cls, site: Site) -> PhasedModel:
        """The model of a site that has phases."""
        phases = site.phases
        formers = tuple(island_formers(site))
        names = assets_of(site)
        net = site.feeder
        voltages = (net.v_slack_pu, net.v_min_pu, net.v_max_pu)
        grid = flow_of_grid(phases, names, net.v_slack_pu)
        flows = (grid, *(flow_of_former(phases, names, former, *voltages) for former in formers))
        of = Loadings.of if site.rated else Loadings.none
        return cls(site, flows, formers, tuple(of(flow.phases) for flow in flows))

    @cached_property
    def slopes(self) -> tuple[Slopes, ...]:
        """Slopes of each source."""
        return tuple(map(Slopes, self.flows, self.loadings))

    @property
    def rated(self) -> tuple[str, ...]:
        """Names of the currents that plans limit."""
        return self.loadings[GRID].names

    @property
    def rated_kva(self) -> Floats:
        """Power that each of them carries at its rating, (k,)."""
        return self.loadings[GRID].kva

    @cached_property
    def devices(self) -> Wholes:
        """Place of each source among the assets; that of the grid is none of them, -1."""
        names = assets_of(self.site)
        return np.array([-1, *map(names.index, self.formers)], dtype=int)

    @cached_property
    def _ratings_kva(self) -> Floats:
        """Rating of each source, of the grid and of nothing none."""
        return np.array([0.0, *(former_kva(self.site, name) for name in self.formers), 0.0])

    def sources(self, data: WindowData) -> Wholes:
        """Source of each step of a window, (W,)."""
        return self.sources_of(data.dark, data.ahead.formers())

    def sources_of(self, island: Flags, forms: Mapping[str, Flags]) -> Wholes:
        """Sources of steps, (...,), with units of kinds that form islands, (..., n).

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

    def ratings_kva(self, sources: Wholes) -> Floats:
        """Rating of the source of each step, (...,)."""
        return np.asarray(self._ratings_kva[sources])

    def headroom_kva(self, data: WindowData) -> Floats:
        """Power that a plan leaves free of the former of each step, (W,)."""
        sources = self.sources(data)
        nothing = np.zeros(data.n_steps)
        of_units = (known.kept_kw().sum(axis=1) for known in data.ahead.by_kind.values())
        kept = sum(of_units, start=nothing)
        battery = largest_forming_battery(self.site)
        if battery is None:
            return kept
        of_battery = data.require_physics().headroom_kw[:, battery]
        return np.asarray(np.where(sources == 1, of_battery, kept))

    @property
    def n_measured(self) -> int:
        """Voltages that have limits."""
        return len(self.flows[0].measured[0])

    def nothing(self, n_steps: int) -> Floats:
        """Power of all assets at rest, (W, D)."""
        return np.zeros((n_steps, len(self.flows[GRID].assets)))

    @cached_property
    def limited(self) -> Flags:
        """Voltages that plans keep within limits: all but those of the grid's own bus."""
        labels = self.flows[0].measured[0]
        slack = self.flows[0].phases.buses[0].bus
        return np.array([bus != slack for bus, _ in labels])

    @cached_property
    def by_phase(self) -> tuple[Wholes, ...]:
        """Places of the voltages of each phase, or of each pair of phases."""
        names = np.array([phase for _, phase in self.flows[0].measured[0]])
        return tuple(np.flatnonzero(names == name) for name in np.unique(names))

    @cached_property
    def at_bus(self) -> Wholes:
        """Bus of the network at which each voltage is measured, (m,)."""
        return measured_at(self.flows[0].phases, self.site.network)

    # Set-points.

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
        q_kvar = load_kw * self.site.customers.q_per_p
        nothing = {
            kind: np.zeros((*load_kw.shape[:-1], len(units)))
            for kind, units in self.site.kinds.items()
        }
        taken = [taken_kw.get(kind, none) for kind, none in nothing.items()]
        given = [given_kvar.get(kind, none) for kind, none in nothing.items()]
        p = np.concatenate([load_kw, -pv[0], -batteries[0], *taken], axis=-1)
        q = np.concatenate([q_kvar, -pv[1], -batteries[1], *(-each for each in given)], axis=-1)
        for place, device in enumerate(self.devices[1:], start=1):
            p[..., device] = np.where(source == place, 0.0, p[..., device])
            q[..., device] = np.where(source == place, 0.0, q[..., device])
        return p, q

    def solved(self, source: int, p_kw: Floats, q_kvar: Floats) -> PhasedResult | None:
        """The flow of one step; None for an island that nothing holds."""
        return None if source == NOTHING_FORMS else self.flows[source].solve(p_kw, q_kvar)

    def points(self, data: WindowData, p_kw: Floats, q_kvar: Floats, lit: Flags) -> PhasedPoints:
        """AC points of powers that assets draw, step by step; those that are not lit rest."""
        W, m = data.n_steps, self.n_measured
        u = np.ones((W, m))
        kva: Complexes = np.zeros((W, 3), dtype=complex)
        currents: Complexes = np.zeros((W, len(self.rated)), dtype=complex)
        network = np.zeros((W, 2))
        converged = np.ones(W, dtype=bool)
        sources = self.sources(data)
        for t in np.flatnonzero(lit):
            source = int(sources[t])
            try:
                found = self.solved(source, p_kw[t], q_kvar[t])
            except NoPhasedSolutionError:
                converged[t] = False
                continue
            if found is not None:
                u[t] = self.flows[source].v_pu(found.v) ** 2
                kva[t] = found.source_kva
                currents[t] = self.loadings[source].currents(found.v)
                network[t] = beyond(found, p_kw[t], q_kvar[t])
        return PhasedPoints(u, kva, currents, network[:, 0], network[:, 1], converged)

    def offsets(
        self, data: WindowData, p_kw: Floats, q_kvar: Floats, points: PhasedPoints
    ) -> tuple[Floats, Complexes]:
        """Offsets that make the linear model meet the AC points: (W, m) and (W, 3)."""
        u, former = self.linear(data, p_kw, q_kvar)
        return points.u_pu2 - u, points.source_kva - former

    def linear(self, data: WindowData, p_kw: Floats, q_kvar: Floats) -> tuple[Floats, Complexes]:
        """Change of squared voltages (W, m) and of the source's complex power (W, 3) by powers."""
        W = data.n_steps
        u = np.zeros((W, self.n_measured))
        former: Complexes = np.zeros((W, 3), dtype=complex)
        for slopes, steps in self._by_source(data):
            u[steps], former[steps] = slopes.changes(p_kw[steps], q_kvar[steps])
        return u, former

    def currents(self, data: WindowData, p_kw: Floats, q_kvar: Floats) -> Complexes:
        """Change of the rated currents by powers, as shares of the rating, (W, k)."""
        found: Complexes = np.zeros((data.n_steps, len(self.rated)), dtype=complex)
        for slopes, steps in self._by_source(data):
            found[steps] = slopes.currents(p_kw[steps], q_kvar[steps])
        return found

    def _by_source(self, data: WindowData) -> Iterator[tuple[Slopes, Flags]]:
        """Slopes of each source that there is, and its steps, (W,)."""
        sources = self.sources(data)
        for source, slopes in enumerate(self.slopes):
            if (sources == source).any():
                yield slopes, sources == source

    def at_no_load(self, data: WindowData) -> tuple[Floats, Complexes, Complexes]:
        """Offsets at no load, (W, m), (W, 3) and (W, k)."""
        W = data.n_steps
        u = np.tile(self.slopes[GRID].u_0, (W, 1))
        former = np.zeros((W, 3), dtype=complex)
        currents = np.tile(self.slopes[GRID].current_0, (W, 1))
        for slopes, steps in self._by_source(data):
            u[steps], currents[steps] = slopes.u_0, slopes.current_0
            former[steps] = np.where(data.dark[steps, None], slopes.former_0, 0.0)
        return u, former, currents

    def phase_kva(self, data: WindowData, kept_kva: Floats | float = 0.0) -> Floats:
        """Rating of each phase of the former in each step, (W,), less what is kept free."""
        rating_kva = self.ratings_kva(self.sources(data))
        return np.asarray((rating_kva - kept_kva) / len(PHASES))


def beyond(found: PhasedResult, p_kw: Floats, q_kvar: Floats) -> tuple[float, float]:
    """Source's power beyond what assets draw at rated voltage."""
    total = found.source_kva.sum()
    return float(total.real - p_kw.sum()), float(total.imag - q_kvar.sum())


_KNOWN: OrderedDict[str, PhasedModel] = OrderedDict()
_KEPT = 3


def phased_model(site: Site) -> PhasedModel:
    """The model of a site, made once for equal sites."""
    found = _KNOWN.pop(site.key, None) or PhasedModel.of(site)
    _KNOWN[site.key] = found
    while len(_KNOWN) > _KEPT:
        _KNOWN.popitem(last=False)
    return found

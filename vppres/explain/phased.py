"""A recorded step of a phased feeder: its AC power flow, and how it follows one more demand."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from vppres.control.converged import dark_steps, physics_of
from vppres.control.phased_window import PhasedLinearisation
from vppres.core.arrays import Complexes, Flags, Floats
from vppres.explain.recorded import Recorded
from vppres.model.beyond_paper.ratings import with_ratings
from vppres.model.data import WindowData
from vppres.model.parts import parts_of
from vppres.model.phases import GRID, NOTHING_FORMS, PhasedModel, Slopes, Supply, phased_model
from vppres.physics.phased_sources import buses_of
from vppres.physics.phases import PhasedResult

ON_THE_WAY = 0.25
"""kVA through a phase of a line by a kW of an asset from which it is on the asset's way: a third of
what has three phases."""


class PhasedStep:
    """The phases of a step as they were recorded."""

    def __init__(self, recorded: Recorded, t: int) -> None:
        self.recorded = recorded
        self.t = t
        self.site = recorded.site

    @property
    def model(self) -> PhasedModel:
        """The site's three phases."""
        return phased_model(self.site)

    @cached_property
    def source(self) -> int:
        """Supply of the step: the grid, or what formed islands."""
        day, now = self.recorded.scenario, range(self.t, self.t + 1)
        island, out = day.outage[now], day.out_of_service(now)
        parts = parts_of(self.site, out, self.recorded.soc_start(self.t), island, True)
        if not parts.whole:
            return self.model.source_in(parts, bool(island[0]))
        forms = self.recorded.trajectory.forms(self.t)
        return int(self.model.sources_of(island[0], forms))

    @property
    def supply(self) -> Supply | None:
        """The supply itself; None where nothing held a voltage."""
        return None if self.source == NOTHING_FORMS else self.model.supplies[self.source]

    @property
    def slopes(self) -> Slopes:
        """How voltages and sources follow powers; those of the grid where nothing held them."""
        return self.model.supplies[max(self.source, GRID)].slopes

    @cached_property
    def drawn(self) -> tuple[Floats, Floats]:
        """Power of the assets, (1, D) each, the formers' own left out."""
        now = self.recorded.done.step(self.t)
        return self.model.powers(
            self.source,
            load_kw=self.recorded.load_kw[[self.t]] * now.supplied,
            pv=(now.pv_self_kw + now.pv_export_kw, now.pv_q_kvar),
            batteries=(now.discharge_kw - now.charge_kw, now.batt_q_kvar),
            taken_kw=now.taken_kw,
            given_kvar=now.given_kvar,
        )

    @cached_property
    def found(self) -> PhasedResult | None:
        """AC power flow of the step; None where nothing held a voltage."""
        if not np.isfinite(self.recorded.done.v_pu[self.t]).any():
            return None
        (p,), (q,) = self.drawn
        return self.model.solved(self.source, p, q)

    @property
    def former_kva(self) -> Complexes:
        """Complex power of its sources on each phase in a step with power, (K,)."""
        assert self.found is not None
        return self.found.source_kva

    @property
    def currents(self) -> Complexes:
        """Currents as shares of their ratings, (k,)."""
        if self.found is None:
            return np.zeros(len(self.model.rated), dtype=complex)
        return self.model.supplies[self.source].loadings.currents(self.found.v)

    def linearised(self, seen: WindowData) -> WindowData:
        """The window of the step, its first step linearised at what was recorded."""
        headroom = float(self.recorded.options["headroom"])
        seen, _ = seen.formed(self.site, dark_steps(self.site, seen), headroom)
        physics = physics_of(self.site, seen, headroom)
        at = PhasedLinearisation(self.model)
        data = at.at_rest(replace(seen, physics=physics))
        p, q = (np.pad(one, [(0, data.n_steps - 1), (0, 0)]) for one in self.drawn)
        first = (np.arange(data.n_steps) == 0) & (at.model.sources(data) == self.source)
        first &= np.isfinite(self.recorded.done.v_pu[self.t]).any()
        found = at.at_known(data, (p, q), first)
        return with_ratings(self.site, found) if self.site.rated else found

    def alone(self, customer: int) -> tuple[Floats, Floats]:
        """The whole demand of a customer in kW and kvar as the only one, (1, D) each."""
        kw = self.recorded.load_kw[self.t, customer]
        one = np.arange(self.slopes.former_p.shape[1])[None, :] == customer
        return one * kw, one * kw * self.site.customers.q_per_p[customer]

    def towards(self, bus: str) -> Flags:
        """Currents that carry most of what an asset of a bus draws, (k,)."""
        at = buses_of(self.site) == bus
        each = np.eye(len(at))[at]
        through = np.abs(self.slopes.currents(each, np.zeros_like(each))) * self.model.rated_kva
        return np.asarray(through.max(axis=0, initial=0.0) > ON_THE_WAY)

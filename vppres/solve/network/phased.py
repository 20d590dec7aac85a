"""Injections of a phased feeder: limits of its phases in place of voltages along the lines."""

from __future__ import annotations

from vppres.core.arrays import Floats
from vppres.model.data import WindowData
from vppres.model.phases import phased_model
from vppres.model.site import Site
from vppres.solve.network.injections import Injections
from vppres.solve.network.reactance import Reactance
from vppres.solve.network.rows import Rows
from vppres.solve.phases import Draws, PhaseLimits, Term


class PhasedInjections(Injections):
    """The same columns and rows, with the limits of a phased window's phases."""

    def __init__(
        self, site: Site, reactance: Reactance, data: WindowData, rules: Rows | None = None
    ) -> None:
        super().__init__(site, reactance, data, rules)
        self.limits = PhaseLimits(site, data, self._draws())

    def _draws(self) -> Draws:
        """What assets draw by the columns."""
        at = self.at
        site = self.site
        model = phased_model(site)
        pv = len(site.customers)
        batteries = pv + len(site.pv)
        active: list[Term] = [
            (0, at["x"], self.data.load_kw),
            (pv, at["P_exp"], -1.0),
            (pv, at["x"][:, site.owner], -self.usual.own_kw),
            (batteries, at["P_ch"], 1.0),
            (batteries, at["P_dch"], -1.0),
        ]
        reactive: list[Term] = [
            (0, at["x"], self.usual.kvar),
            (pv, at["Q_pv"], -1.0),
            (batteries, at["Q_batt"], -1.0),
        ]
        nothing = model.nothing(self.data.n_steps)
        return Draws.of(model, self.data, self.size, active, reactive, (nothing, nothing))

    @property
    def near(self) -> list[Rows]:
        """Rows of limits that the last candidate nearly reached."""
        return [*self.limits.near]

    def voltage_rows(self, x: Floats, tolerance_pu2: float) -> list[Rows]:
        """Rows of the voltages and of the former's phases that exceed their limits."""
        return [*self.limits.exceeded(x, tolerance_pu2)]

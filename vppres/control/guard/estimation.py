"""State estimate from measurements, judged by what the plant did; missing ones are estimated.

Forecasts are no evidence against a reading: two of them differ by their own noise. A reading counts
as frozen only where the plant's response contradicts it, so that on a day without faults nothing is
replaced (``docs/operation.md``).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from vppres.contract.ahead import KindsAhead
from vppres.contract.decision import OUT, Decision
from vppres.contract.observation import Observation
from vppres.control.guard.balance import feeder_off
from vppres.control.guard.moved import Moved
from vppres.control.guard.reckoning import JUMPED, SocReckoning
from vppres.control.guard.series import SeriesJudge
from vppres.control.remembered import PART
from vppres.core.arrays import Flags, Floats, Wholes
from vppres.model.site import Site

RESPONSE_SHARE = 0.02
SILENT_SHARE = 1e-3
"""A battery asked for more than the first share of its rating that gives less than the second is
out."""

RETRY_STEPS = 3
"""Steps after which a battery that did not respond is tried again."""


class Estimator:
    """Keeps what is needed to judge the next measurements: the last ones, and what was commanded.

    In ``physical`` mode batteries hold the islands, and so do not follow their set-points there.
    """

    REMEMBERED: ClassVar[dict[str, Any]] = {
        "series": PART,
        "_soc": SocReckoning,
        "_moved": Moved,
        "_last": Observation | None,
        "_out_until": Wholes,
    }

    def __init__(self, site: Site, physical: bool = False) -> None:
        self.site = site
        self.physical = physical
        self.series = SeriesJudge(site)
        self._soc = SocReckoning.start(site)
        self._moved = Moved.nothing(len(site.batteries))
        self._last: Observation | None = None
        self._out_until: Wholes = np.zeros(len(site.batteries), dtype=np.int64)

    def known(self, seen: Observation) -> Observation:
        """The observation with estimates for what cannot be trusted."""
        online = self._online(seen)
        self._estimate_soc(seen)
        online &= ~self._soc.unknown
        load_kw, pv_kw, series_words = self.series.judged(seen, *self._expected(seen))
        forecast = seen.forecast
        if series_words:
            forecast = replace(
                forecast,
                load_kw=np.vstack([load_kw, forecast.load_kw[1:]]),
                pv_kw=np.vstack([pv_kw, forecast.pv_kw[1:]]),
            )
        out = self.site.batteries.id[~online]
        words = [*self._soc_words(), *series_words, *map(OUT.format, out)]
        # A battery of which nothing is known is out, and counts as empty.
        soc = np.where(np.isnan(self._soc.soc), self.site.batteries.soc_min, self._soc.soc)
        believed = replace(
            seen,
            forecast=forecast,
            soc=soc,
            online=online,
            estimated="; ".join(words),
            told=(),
            soc_age_h=None,
        )
        self._last = _remembered(believed)
        return believed

    def proven(self, known: Observation) -> Observation:
        """Estimate without demands far above all that an import has agreed with.

        Itself where there are none.
        """
        load_kw, words = self.series.proven()
        if not words:
            return known
        rows = np.vstack([load_kw, known.forecast.load_kw[1:]])
        believed = replace(
            known,
            forecast=replace(known.forecast, load_kw=rows),
            estimated="; ".join(word for word in (known.estimated, *words) if word),
        )
        self._last = _remembered(believed)
        return believed

    def commanded(self, decision: Decision) -> None:
        """Keep what was decided, to compare it with what comes back."""
        self.series.before = self.series.before.decided(decision)
        self._note_override(self._soc.at_h, self.series.before.battery_kw)

    def _online(self, seen: Observation) -> Flags:
        """Batteries that report to be there and followed their set-points."""
        if seen.battery_kw is not None and self._should_have_followed(seen):
            rating = self.site.batteries.p_max_kw
            told_kw = seen.told[-1].battery_kw if seen.told else self.series.before.battery_kw
            silent = (np.abs(told_kw) > RESPONSE_SHARE * rating) & (
                np.abs(seen.battery_kw) < SILENT_SHARE * rating
            )
            self._out_until = np.where(silent, seen.t0 + RETRY_STEPS, self._out_until)
        return seen.online & (self._out_until <= seen.t0)

    def _should_have_followed(self, seen: Observation) -> bool:
        """Whether batteries were to follow their set-points in the last step.

        Where nothing flowed, protection stopped them; those that hold an island, or a part behind
        a line that is out, share its mismatch.
        """
        before = None if self._last is None else self._last.forecast
        island = before is not None and before.grid_limit_kw[0] <= 0.0
        in_parts = before is not None and before.in_parts_now
        return not (feeder_off(seen) or (self.physical and island) or in_parts)

    def _estimate_soc(self, seen: Observation) -> None:
        """The state of charge: the newest reading, and what was stored since.

        Set-points are held over steps that were left out.
        """
        now_h = seen.t0 * self.site.dt_h + seen.elapsed_h
        for told in seen.told:
            self._note_override(now_h - told.before_h, told.battery_kw)
        if seen.battery_kw is not None and self._last is not None:
            self._moved = self._moved.seen(self._soc.at_h, seen.battery_kw, self._eta(self._last))
        age_h = np.zeros(len(self.site.batteries)) if seen.soc_age_h is None else seen.soc_age_h
        self._soc = self._soc.after(seen.soc, now_h - age_h, now_h, self._moved)

    def _note_override(self, at_h: float, battery_kw: Floats) -> None:
        """Batteries got other set-points from a time on."""
        b = self.site.batteries
        eta = (b.eta_charge, b.eta_discharge) if self._last is None else self._eta(self._last)
        self._moved = self._moved.ordered(at_h, battery_kw, eta)

    @staticmethod
    def _eta(seen: Observation) -> tuple[Floats, Floats]:
        return seen.eta_charge, seen.eta_discharge

    def _soc_words(self) -> list[str]:
        """The batteries whose state of charge is reckoned, or not known at all."""
        soc = self._soc
        names = self.site.batteries.id
        words = []
        for i in np.flatnonzero(~soc.trusted):
            if np.isnan(soc.soc[i]):
                words.append(f"soc {names[i]} was never received")
                continue
            kind = "(frozen)" if soc.frozen[i] else JUMPED if soc.jumped[i] else "(missing)"
            words.append(f"soc {names[i]} {soc.soc[i]:.4f} +-{soc.band[i]:.3f} {kind}")
        return words

    def _expected(self, seen: Observation) -> tuple[Floats, Floats, bool]:
        """Demand and PV power that a forecast or the profile expects, and True; else the last."""
        if self._last is None:
            ahead = seen.forecast
            if seen.profile_kw is not None and seen.profile_pv_kw is not None:
                return seen.profile_kw, seen.profile_pv_kw, True
            if len(ahead.load_kw) > 1:
                return ahead.load_kw[1], ahead.pv_kw[1], True
            return np.zeros(len(self.site.customers)), np.zeros(len(self.site.pv)), False
        before = self._last.forecast
        steps = seen.t0 - self._last.t0
        row = steps if steps < len(before.load_kw) else 0
        return before.load_kw[row], before.pv_kw[row], row > 0


def _remembered(seen: Observation) -> Observation:
    """Observation to compare the next step with; kinds have readings of their own."""
    return replace(seen, ahead=KindsAhead())

"""Readings of demand and PV power: missing, frozen, and far from all that was expected.

A frozen reading is replaced where the plant contradicts it. A demand that is ten times, or a tenth
of, all that was forecast or read before is in another unit or a spike: it is replaced until the
import that is measured over a step says that it was right. One that the lines to the customer
could not carry is never right, and an import that the connection could not pass says nothing.

A demand that is twice, or half of, what was expected counts, unless the import of the step
before contradicts the meters: then it is the one without which least of the mismatch is left, or
all of them, and what was expected stands in until the import agrees with the meter again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from vppres.contract.observation import Observation
from vppres.control.guard.balance import (
    StepBefore,
    contradicts,
    mismatch_kw,
    served,
    tolerance_kw,
)
from vppres.core.arrays import Flags, Floats, Names
from vppres.model.site import Site

FAR = 10.0
"""A demand beyond this multiple of all that was expected of it, or below its inverse, is far."""

ODD = 2.0
"""Beyond this multiple of what was expected, or below its inverse, a demand may be a meter's."""

EXPLAINED = 0.5
"""Without the meters that are wrong less than this share of a mismatch is left."""


class SeriesJudge:
    """Tells which readings of demand and PV power stand still although the plant says otherwise."""

    REMEMBERED: ClassVar[dict[str, Any]] = {"before": StepBefore}

    def __init__(self, site: Site) -> None:
        self.site = site
        self.before = StepBefore.nothing(site)
        self._carried_kw = _carried_kw(site)

    def judged(
        self, seen: Observation, expected_load_kw: Floats, expected_pv_kw: Floats, foretold: bool
    ) -> tuple[Floats, Floats, list[str]]:
        """Demand and PV power with estimates where they must be, and what was estimated.

        What was expected of this step before it is ``foretold``, or the reading of a step before.
        """
        names = self.site.customers.id
        read_kw, pv_kw = seen.forecast.load_kw[0], seen.forecast.pv_kw[0]
        doubted, proven_kw = self._by_import(seen)
        least_kw, most_kw = self._confirmed(seen)
        profiled = seen.profile_kw is not None
        far = _far_now(seen, expected_load_kw, least_kw, most_kw) & profiled
        far |= (read_kw > self._carried_kw) & (expected_load_kw < self._carried_kw)
        usual_kw = expected_load_kw
        if not foretold and seen.profile_kw is not None:
            usual_kw = seen.profile_kw
        if not profiled:  # forecasts alone, or a reading before, are no evidence
            proven_kw = np.full_like(usual_kw, np.inf)
        doubted &= _implausible(read_kw, usual_kw) & ~far
        load_kw = np.where(far, expected_load_kw, np.where(doubted, usual_kw, read_kw))
        frozen_load, frozen_pv = self._frozen_now(seen, load_kw, pv_kw)
        frozen = bool(frozen_load.any() or frozen_pv.any())
        kept = frozen and not self._forecast_was_nearer(seen, frozen_load, frozen_pv)
        self.before = replace(
            self.before,
            t=seen.t0,
            load_kw=load_kw,
            pv_kw=pv_kw,
            read_kw=read_kw,
            expected_load_kw=expected_load_kw,
            expected_pv_kw=expected_pv_kw,
            usual_kw=usual_kw,
            far=far,
            doubted=doubted,
            frozen_load=frozen_load,
            frozen_pv=frozen_pv,
            proven_kw=proven_kw,
            least_kw=least_kw,
            most_kw=most_kw,
            most_import_kw=_most_import_kw(seen, expected_load_kw, load_kw),
        )
        load, load_words = _estimated("load", names, load_kw, expected_load_kw, frozen_load, kept)
        pv, pv_words = _estimated("pv", self.site.pv.id, pv_kw, expected_pv_kw, frozen_pv, kept)
        far_words = [
            f"load {names[i]} {load[i]:.2f} kW ({read_kw[i]:g} is far from it)"
            for i in np.flatnonzero(far)
        ]
        odd_words = [
            f"load {names[i]} {load[i]:.2f} kW (the import contradicts {read_kw[i]:g})"
            for i in np.flatnonzero(doubted)
        ]
        return load, pv, [*load_words, *pv_words, *far_words, *odd_words]

    @property
    def unproven(self) -> Flags:
        """Demands of the step far above what was expected and what an import agreed with, (C,)."""
        now = self.before
        most_kw = np.maximum(now.usual_kw, now.proven_kw)
        return np.asarray((now.load_kw > ODD * most_kw) & (now.usual_kw > 0.0))

    def proven(self) -> tuple[Floats, list[str]]:
        """Demand of the step without what is far above all that an import has agreed with, (C,).

        And what was replaced, in words. From then on it counts as doubted.
        """
        now, unproven = self.before, self.unproven
        kw = np.where(unproven, now.usual_kw, now.load_kw)
        self.before = replace(now, load_kw=kw, doubted=now.doubted | unproven)
        return kw, [
            f"load {self.site.customers.id[i]} {kw[i]:.2f} kW ({now.load_kw[i]:g} cannot be "
            "supplied, and no import has shown it)"
            for i in np.flatnonzero(unproven)
        ]

    def _confirmed(self, seen: Observation) -> tuple[Floats, Floats]:
        """The least and the most demand that was far, and that the import of its step confirms."""
        before = self.before
        used_kw = self._import_mismatch_kw(seen, before)
        read_kw = self._import_mismatch_kw(seen, replace(before, load_kw=before.read_kw))
        if not abs(read_kw) < abs(used_kw):
            return before.least_kw, before.most_kw
        kw = np.where(before.read_kw > self._carried_kw, before.load_kw, before.read_kw)
        return (
            np.where(before.far, np.minimum(before.least_kw, kw), before.least_kw),
            np.where(before.far, np.maximum(before.most_kw, kw), before.most_kw),
        )

    def _by_import(self, seen: Observation) -> tuple[Flags, Floats]:
        """Meters that the import of the step before contradicts, and the most that it agreed with.

        Where that import is not known, or explained by no meter, the verdict before stands.
        """
        before = self._as_read(seen)
        kept, proven_kw, usual_kw = before.doubted, before.proven_kw, before.usual_kw
        off_kw = self._import_mismatch_kw(seen, before)
        if np.isnan(off_kw):
            return kept, proven_kw
        on = served(before, seen)
        if not contradicts(off_kw, before, seen):
            agreed_kw = np.where(on > 0.0, np.maximum(proven_kw, before.load_kw), proven_kw)
            return kept & (on == 0.0), agreed_kw
        odd = _implausible(before.load_kw, usual_kw) & (on > 0.0)
        if not odd.any():
            return kept, proven_kw
        alone = np.abs(off_kw + on * (before.load_kw - usual_kw))
        worst = np.arange(len(odd)) == np.argmin(np.where(odd, alone, np.inf))
        found = kept
        least_kw = abs(off_kw)
        for tried in (worst, odd):
            kw = np.where(tried, usual_kw, before.load_kw)
            left_kw = abs(self._import_mismatch_kw(seen, replace(before, load_kw=kw)))
            if left_kw < EXPLAINED * least_kw:
                found, least_kw = tried | (kept & (on == 0.0)), left_kw
        return found, proven_kw

    def _as_read(self, seen: Observation) -> StepBefore:
        """The step before as it was read; far readings only if the import bears them out.

        What was missing is as it was estimated.
        """
        before = self.before
        read = np.isfinite(before.read_kw) & (before.read_kw >= 0.0)
        whole = replace(before, load_kw=np.where(read, before.read_kw, before.load_kw))
        tame = replace(whole, load_kw=np.where(before.far, before.load_kw, whole.load_kw))
        off_kw = [abs(self._import_mismatch_kw(seen, one)) for one in (whole, tame)]
        return tame if off_kw[1] < off_kw[0] else whole

    def _frozen_now(self, seen: Observation, load_kw: Floats, pv_kw: Floats) -> tuple[Flags, Flags]:
        """Readings that stand still while the balance of the step before contradicts them.

        Where that balance is not known the verdict before stands, until a reading moves.
        """
        before = self.before
        off_kw = self._import_mismatch_kw(seen, before)
        load, pv = load_kw == before.load_kw, pv_kw == before.pv_kw
        if np.isnan(off_kw):
            return load & before.frozen_load, pv & before.frozen_pv
        wrong = contradicts(off_kw, before, seen)
        return load & wrong, pv & wrong

    def _forecast_was_nearer(self, seen: Observation, frozen_load: Flags, frozen_pv: Flags) -> bool:
        """Whether the forecast explains the step before better than the frozen readings do.

        It counts as better where neither is known.
        """
        before = self.before
        by_forecast = replace(
            before,
            load_kw=np.where(frozen_load, before.expected_load_kw, before.load_kw),
            pv_kw=np.where(frozen_pv, before.expected_pv_kw, before.pv_kw),
        )
        readings_kw, forecast_kw = (
            abs(self._import_mismatch_kw(seen, one)) for one in (before, by_forecast)
        )
        return not forecast_kw >= readings_kw

    def _import_mismatch_kw(self, seen: Observation, before: StepBefore) -> float:
        """Mismatch of the step before, NaN where it is not known."""
        if seen.t0 != before.t + 1:
            return np.nan
        if seen.import_kw is None or seen.import_kw > before.most_import_kw:
            return np.nan
        return mismatch_kw(self.site, before, seen)


def _far_now(seen: Observation, expected_kw: Floats, least_kw: Floats, most_kw: Floats) -> Flags:
    """Demand far from its forecasts, and from the least and most that were shown to be right.

    By more than meters are off by; where no demand was expected nothing is far.
    """
    read_kw = seen.forecast.load_kw[0]
    profile_kw = expected_kw if seen.profile_kw is None else seen.profile_kw
    ahead = np.vstack([expected_kw, profile_kw, seen.forecast.load_kw[1:]])
    far = read_kw > FAR * np.maximum(ahead.max(axis=0), most_kw)
    far |= read_kw < np.minimum(ahead.min(axis=0), least_kw) / FAR
    matters = np.abs(read_kw - expected_kw) > tolerance_kw(float(expected_kw.sum()))
    return np.asarray(far & matters & (expected_kw > 0.0))


def _implausible(read_kw: Floats, usual_kw: Floats) -> Flags:
    """Demands so far from what was expected that a meter may be wrong, (C,)."""
    return np.asarray((read_kw > ODD * usual_kw) | (read_kw < usual_kw / ODD))


def _carried_kw(site: Site) -> Floats:
    """The most demand that the lines to each customer could carry, were it the only one, (C,).

    Beyond the nose of its power flow there is no voltage, and linear squared voltages fall below
    half of the slack bus's no later than there.
    """
    net = site.network
    r, x = (
        site.customer_bus.T @ (drop @ net.downstream)
        for drop in (net.r_pu2_per_kw, net.x_pu2_per_kvar)
    )
    per_kw = np.maximum(r + x * site.customers.q_per_p, 0.0)
    most = np.full(len(per_kw), np.inf)
    found: Floats = np.divide(0.25 * net.v_slack_pu**2, per_kw, out=most, where=per_kw > 0.0)
    return found


def _most_import_kw(seen: Observation, expected_kw: Floats, usable_kw: Floats) -> float:
    """The most import of a step that is one: what the connection passes, and no more than far.

    A demand that was accepted counts as expected.
    """
    limit_kw = float(seen.forecast.grid_limit_kw[0])
    demand_kw = float(np.fmax(expected_kw, usable_kw).sum())
    battery_kw = 0.0 if seen.battery_kw is None else float(np.abs(seen.battery_kw).sum())
    far_kw = FAR * (demand_kw + battery_kw) + tolerance_kw(demand_kw)
    passes_kw = limit_kw + tolerance_kw(limit_kw) if limit_kw > 0.0 else np.inf
    return min(far_kw, passes_kw)


def _estimated(
    what: str, ids: Names, now: Floats, expected: Floats, frozen: Flags, kept: bool
) -> tuple[Floats, list[str]]:
    """Readings with the expected ones in their place where needed, and what to say of it.

    Frozen readings that are nearer to the truth than the forecast are kept, but named.
    """
    missing = ~(np.isfinite(now) & (now >= 0.0))
    # A frozen reading that the forecast confirms, such as PV power at night, is not worth a word.
    frozen = frozen & ~missing & (expected != now)
    wrong = missing | frozen
    values = np.where(missing | (frozen & (not kept)), expected, now)
    if not wrong.any():
        return now, []
    kind = "frozen, kept" if kept else "frozen"
    for flags, word in ((missing, "missing"), (frozen, kind)):
        if flags.all():
            return values, [f"{what} of all {len(ids)}, {values.sum():.1f} kW ({word})"]
    return values, [
        f"{what} {ids[i]} {values[i]:.2f} kW ({'missing' if missing[i] else kind})"
        for i in np.flatnonzero(wrong)
    ]

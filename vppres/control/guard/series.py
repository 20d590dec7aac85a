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

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from vppres.contract.observation import Observation
from vppres.control.guard.balance import (
    Commanded,
    LoadAndPVReadings,
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


@dataclass(frozen=True, eq=False)
class _Frozen:
    """Which readings are frozen: demand (C,) and PV power (P,)."""

    load: Flags
    pv: Flags

    @property
    def any(self) -> bool:
        return bool(self.load.any() or self.pv.any())


@dataclass(frozen=True, eq=False)
class _Step:
    """A step: readings that are usable, what had been forecast, and demand as it was read.

    An import beyond ``most_import_kw`` says nothing of it. ``usual_kw`` is what stands in where a
    demand is ``doubted``, ``proven_kw`` the most of each that an import has agreed with.
    """

    t: int
    seen: LoadAndPVReadings
    expected: LoadAndPVReadings
    read_kw: Floats
    most_import_kw: float = np.inf
    usual_kw: Floats | None = None
    doubted: Flags | None = None
    proven_kw: Floats | None = None


@dataclass(frozen=True, eq=False)
class _Usual:
    """The least and the most demand that a step has shown to be right, (C,)."""

    least_kw: Floats
    most_kw: Floats


class SeriesJudge:
    """Tells which readings of demand and PV power stand still although the plant says otherwise."""

    REMEMBERED: ClassVar[dict[str, Any]] = {
        "_before": _Step | None,
        "_frozen": _Frozen,
        "_far": Flags,
        "_usual": _Usual,
    }

    def __init__(self, site: Site) -> None:
        self.site = site
        self._before: _Step | None = None
        self._frozen = _Frozen(
            np.zeros(len(site.customers), dtype=bool), np.zeros(len(site.pv), dtype=bool)
        )
        self._far = np.zeros(len(site.customers), dtype=bool)
        self._usual = _Usual(np.full(len(site.customers), np.inf), np.zeros(len(site.customers)))
        self._carried_kw = _carried_kw(site)

    def judged(
        self,
        seen: Observation,
        expected: LoadAndPVReadings,
        foretold: bool,
        commanded: Commanded | None,
    ) -> tuple[LoadAndPVReadings, list[str]]:
        """Readings of the step with estimates where they must be, and what was estimated.

        ``expected`` is what was known of this step before it: ``foretold``, or the reading of a
        step before.
        """
        read_kw = seen.forecast.load_kw[0]
        doubted, proven_kw = self._by_import(seen, commanded)
        self._accept_confirmed(seen, commanded)
        profiled = foretold or seen.profile_kw is not None
        far = self._far_now(read_kw, seen, expected) & profiled
        beyond = read_kw > self._carried_kw
        self._far = far = far | (beyond & (expected.load_kw < self._carried_kw))
        usual_kw = expected.load_kw
        if not foretold and seen.profile_kw is not None:
            usual_kw = seen.profile_kw
        if not profiled:  # a reading before is no evidence against the next one
            proven_kw = np.full_like(usual_kw, np.inf)
        doubted &= _implausible(read_kw, usual_kw) & ~far
        usable_kw = np.where(far, expected.load_kw, np.where(doubted, usual_kw, read_kw))
        usable = LoadAndPVReadings(usable_kw, seen.forecast.pv_kw[0])
        most_kw = _most_import_kw(seen, expected, usable)
        now = _Step(seen.t0, usable, expected, read_kw, most_kw, usual_kw, doubted, proven_kw)
        frozen = self._frozen_now(now, seen, commanded)
        kept = frozen.any and not self._forecast_was_nearer(seen, commanded, frozen)
        self._frozen = frozen
        self._before = now
        load, load_words = _estimated(
            "load", self.site.customers.id, now.seen.load_kw, expected.load_kw, frozen.load, kept
        )
        pv, pv_words = _estimated(
            "pv", self.site.pv.id, now.seen.pv_kw, expected.pv_kw, frozen.pv, kept
        )
        far_words = [
            f"load {self.site.customers.id[i]} {load[i]:.2f} kW ({read_kw[i]:g} is far from it)"
            for i in np.flatnonzero(far)
        ]
        odd_words = [
            f"load {self.site.customers.id[i]} {load[i]:.2f} kW (the import contradicts "
            f"{read_kw[i]:g})"
            for i in np.flatnonzero(doubted)
        ]
        return LoadAndPVReadings(load, pv), [*load_words, *pv_words, *far_words, *odd_words]

    @property
    def unproven(self) -> Flags:
        """Demands of the step far above what was expected and what an import agreed with, (C,)."""
        now = self._before
        if now is None or now.usual_kw is None or now.proven_kw is None:
            return np.zeros(len(self.site.customers), dtype=bool)
        most_kw = np.maximum(now.usual_kw, now.proven_kw)
        return np.asarray((now.seen.load_kw > ODD * most_kw) & (now.usual_kw > 0.0))

    def proven(self) -> tuple[Floats, list[str]]:
        """Demand of the step without what is far above all that an import has agreed with, (C,).

        And what was replaced, in words. From then on it counts as doubted.
        """
        now, unproven = self._before, self.unproven
        if now is None or now.usual_kw is None or not unproven.any():
            return np.empty(0), []
        load_kw = now.seen.load_kw
        kw = np.where(unproven, now.usual_kw, load_kw)
        doubted = unproven if now.doubted is None else now.doubted | unproven
        self._before = replace(now, seen=replace(now.seen, load_kw=kw), doubted=doubted)
        return kw, [
            f"load {self.site.customers.id[i]} {kw[i]:.2f} kW ({load_kw[i]:g} cannot be supplied, "
            "and no import has shown it)"
            for i in np.flatnonzero(unproven)
        ]

    def _far_now(self, read_kw: Floats, seen: Observation, expected: LoadAndPVReadings) -> Flags:
        """Demand far from its forecasts, and from all that a step has shown to be right.

        By more than meters are off by; where no demand was expected nothing is far.
        """
        profile_kw = expected.load_kw if seen.profile_kw is None else seen.profile_kw
        ahead = np.vstack([expected.load_kw, profile_kw, seen.forecast.load_kw[1:]])
        most_kw = np.maximum(ahead.max(axis=0), self._usual.most_kw)
        least_kw = np.minimum(ahead.min(axis=0), self._usual.least_kw)
        far = (read_kw > FAR * most_kw) | (read_kw < least_kw / FAR)
        off_kw = np.abs(read_kw - expected.load_kw)
        matters = off_kw > tolerance_kw(float(expected.load_kw.sum()))
        return np.asarray(far & matters & (expected.load_kw > 0.0))

    def _accept_confirmed(self, seen: Observation, commanded: Commanded | None) -> None:
        """Take up what was far if the import of its step says that it was right."""
        before = self._before
        if before is None or not self._far.any():
            return
        used = self._import_mismatch_kw(seen, commanded, before.seen)
        read = self._import_mismatch_kw(
            seen, commanded, replace(before.seen, load_kw=before.read_kw)
        )
        if used is not None and read is not None and abs(read) < abs(used):
            kw = np.where(before.read_kw > self._carried_kw, before.seen.load_kw, before.read_kw)
            self._usual = _Usual(
                np.where(self._far, np.minimum(self._usual.least_kw, kw), self._usual.least_kw),
                np.where(self._far, np.maximum(self._usual.most_kw, kw), self._usual.most_kw),
            )

    def _by_import(self, seen: Observation, commanded: Commanded | None) -> tuple[Flags, Floats]:
        """Meters that the import of the step before contradicts, and the most that it agreed with.

        Where that import is not known, or explained by no meter, the verdict before stands.
        """
        before = self._before
        nobody = np.zeros(len(self.site.customers), dtype=bool)
        if before is None or before.usual_kw is None:
            return nobody, np.zeros(len(nobody))
        kept = nobody if before.doubted is None else before.doubted
        proven_kw = np.zeros(len(nobody)) if before.proven_kw is None else before.proven_kw
        given = self._readings_before(seen, commanded, before)
        off_kw = None if given is None else self._import_mismatch_kw(seen, commanded, given)
        if given is None or off_kw is None or commanded is None:
            return kept, proven_kw
        on = served(commanded, seen)
        if not contradicts(off_kw, commanded, seen, given):
            agreed_kw = np.where(on > 0.0, np.maximum(proven_kw, given.load_kw), proven_kw)
            return kept & (on == 0.0), agreed_kw
        odd = _implausible(given.load_kw, before.usual_kw) & (on > 0.0)
        if not odd.any():
            return kept, proven_kw
        alone = np.abs(off_kw + on * (given.load_kw - before.usual_kw))
        worst = np.arange(len(odd)) == np.argmin(np.where(odd, alone, np.inf))
        found = kept
        least_kw = abs(off_kw)
        for tried in (worst, odd):
            kw = np.where(tried, before.usual_kw, given.load_kw)
            left_kw = self._import_mismatch_kw(seen, commanded, replace(given, load_kw=kw))
            if left_kw is not None and abs(left_kw) < EXPLAINED * least_kw:
                found, least_kw = tried | (kept & (on == 0.0)), abs(left_kw)
        return found, proven_kw

    def _readings_before(
        self, seen: Observation, commanded: Commanded | None, before: _Step
    ) -> LoadAndPVReadings | None:
        """Readings of the step before; far ones only if the import bears them out.

        What was missing is as it was estimated.
        """
        read = np.isfinite(before.read_kw) & (before.read_kw >= 0.0)
        whole = replace(before.seen, load_kw=np.where(read, before.read_kw, before.seen.load_kw))
        if not self._far.any():
            return whole
        tame_kw = np.where(self._far, before.seen.load_kw, whole.load_kw)
        both = [whole, replace(whole, load_kw=tame_kw)]
        off_kw = [self._import_mismatch_kw(seen, commanded, one) for one in both]
        known = [(abs(off), i) for i, off in enumerate(off_kw) if off is not None]
        return both[min(known)[1]] if known else None

    def _frozen_now(self, now: _Step, seen: Observation, commanded: Commanded | None) -> _Frozen:
        """Readings that stand still while the balance of the step before contradicts them.

        Where that balance is not known the verdict before stands, until a reading moves.
        """
        before = self._before
        if before is None:
            return self._frozen
        still = _Frozen(
            now.seen.load_kw == before.seen.load_kw, now.seen.pv_kw == before.seen.pv_kw
        )
        off_kw = self._import_mismatch_kw(seen, commanded, before.seen)
        if commanded is None or off_kw is None:
            return _Frozen(still.load & self._frozen.load, still.pv & self._frozen.pv)
        if contradicts(off_kw, commanded, seen, before.seen):
            return still
        return _Frozen(np.zeros_like(still.load), np.zeros_like(still.pv))

    def _forecast_was_nearer(
        self, seen: Observation, commanded: Commanded | None, frozen: _Frozen
    ) -> bool:
        """Whether the forecast explains the step before better than the frozen readings do."""
        before = self._before
        assert before is not None  # without a step before nothing is frozen
        by_forecast = LoadAndPVReadings(
            np.where(frozen.load, before.expected.load_kw, before.seen.load_kw),
            np.where(frozen.pv, before.expected.pv_kw, before.seen.pv_kw),
        )
        of_readings = self._import_mismatch_kw(seen, commanded, before.seen)
        of_forecast = self._import_mismatch_kw(seen, commanded, by_forecast)
        if of_readings is None or of_forecast is None:
            return True
        return abs(of_forecast) < abs(of_readings)

    def _import_mismatch_kw(
        self, seen: Observation, commanded: Commanded | None, readings: LoadAndPVReadings
    ) -> float | None:
        """Mismatch of the step before, None where it is not known."""
        before = self._before
        if commanded is None or before is None or seen.t0 != before.t + 1:
            return None
        if seen.import_kw is None or seen.import_kw > before.most_import_kw:
            return None
        return mismatch_kw(self.site, commanded, seen, readings)


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


def _most_import_kw(
    seen: Observation, expected: LoadAndPVReadings, usable: LoadAndPVReadings
) -> float:
    """The most import of a step that is one: what the connection passes, and no more than far.

    A demand that was accepted counts as expected.
    """
    limit_kw = float(seen.forecast.grid_limit_kw[0])
    demand_kw = float(np.fmax(expected.load_kw, usable.load_kw).sum())
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

"""Rules of customers on arrays: in windows, and what a step leaves to the next.

:mod:`vppres.kinds.customer.rows` states the same rules for the solver.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vppres.core.arrays import Flags, Floats, Wholes
from vppres.kinds.customer.data import RuleSteps, SwitchingRules, steps_within
from vppres.scenario.assets import Customers

UNLIMITED = 1e6
"""Actions left where there is no limit."""

DAY_H = 24.0
"""The limit of actions holds for every 24 h from the first step on, whatever clocks say."""


@dataclass(frozen=True, eq=False)
class LongestOff:
    """Limits of the n customers that have one, in a window of W steps."""

    customer: Wholes  #: their positions, (n,)
    steps: Wholes  #: steps that each may be off at a time, (n,)
    #: Whether a step is beyond the limit if the customer was off in all steps of the window up to
    #: it, (W, n): off before the window, or for long enough in it.
    asked: Flags
    price: Floats  #: price of a step beyond it, in weighted customer hours, (n,)

    @classmethod
    def of(cls, longest_h: Floats, off_h: Floats, dt_h: float, n_steps: int) -> LongestOff:
        """The limits of the window that begins now, without prices; none if they ask nothing.

        ``longest_h`` is how long each may be off at a time, infinite for any time, ``off_h`` how
        long each has been, (C,) each. Off for one hour of two, the second step is the first beyond.

        >>> LongestOff.of(np.array([2.0, np.inf]), np.array([1.0, 0.0]), 1.0, 3).asked[:, 0]
        array([False,  True,  True])
        """
        customer = np.flatnonzero(np.isfinite(longest_h))
        steps = steps_within(longest_h[customer], dt_h)
        before = np.round(off_h[customer] / dt_h).astype(int)
        asked = before + np.arange(n_steps)[:, None] >= steps
        found = cls(customer, np.minimum(steps, n_steps), asked, np.zeros(len(customer)))
        return found if asked.any() else found.without_customers()

    def __len__(self) -> int:
        return len(self.customer)

    def without_customers(self) -> LongestOff:
        """Limits of no customer."""
        return LongestOff(self.customer[:0], self.steps[:0], self.asked[:, :0], self.price[:0])

    def priced(self, hour_beyond: Floats, dt_h: float) -> LongestOff:
        """The limits at the prices of an hour beyond, (C,)."""
        return replace(self, price=hour_beyond[self.customer] * dt_h)

    def beyond(self, served: Flags) -> Flags:
        """Steps beyond the limit under a service (W, C), shape (W, n)."""
        on = np.cumsum(served[:, self.customer], axis=0)
        before = np.arange(len(on))[:, None] - self.steps - 1
        until = np.take_along_axis(on, np.maximum(before, 0), axis=0)
        return np.asarray(self.asked & (on == np.where(before < 0, 0, until)))

    def cost(self, served: Flags) -> float:
        """Penalty of a service for steps beyond the limits, in weighted customer hours."""
        return float(self.beyond(served).sum(axis=0) @ self.price)

    def part(self, steps: slice) -> LongestOff:
        """The limits in some steps of the window: behind its first the time before is not known."""
        first, stop, _ = steps.indices(len(self.asked))
        asked = self.asked[steps]
        found = replace(self, steps=np.minimum(self.steps, stop), asked=asked)
        return found if first == 0 and asked.any() else found.without_customers()


def due(longest_h: Floats, off_h: Floats, dt_h: float) -> Flags:
    """Customers that would be off beyond their longest time now, (C,).

    >>> due(np.array([1.5, np.inf]), np.array([1.0, 1.0]), dt_h=1.0)
    array([ True, False])
    """
    found = np.zeros(len(longest_h), dtype=bool)
    limits = LongestOff.of(longest_h, off_h, dt_h, n_steps=1)
    found[limits.customer] = limits.asked[0]
    return found


@dataclass(frozen=True, eq=False)
class SwitchingData:
    """Rules of one window of W steps and C customers, in D days."""

    steps: RuleSteps  #: minimum times and cold load in steps
    served_before: Flags  #: who was served in the step before the window, (C,)
    #: Who must be served, and who may be, because of what happened before the window, (W, C).
    served_min: Flags
    served_max: Flags
    actions_left: Floats  #: actions that each customer has left in each day, (D, C)
    price_per_action: float  #: in weighted customer hours
    cold_factor: float  #: demand after a restoration as a multiple of the usual one
    #: Whose demand would be higher for a restoration before the window, if still served, (W, C).
    cold_before: Flags
    day: Wholes  #: day of each step, counted from that of the first, (W,)
    #: How long customers may be off at a time. It may be broken at a price, so that no service
    #: breaks a rule by it.
    longest_off: LongestOff

    def keeping(self, served: Flags) -> SwitchingData:
        """The rules where some customers, (n, C), must be served in the first n steps too."""
        kept = self.served_min.copy()
        kept[: len(served)] |= served
        return replace(self, served_min=kept)

    def part(self, steps: slice) -> SwitchingData:
        """The rules of some of the window's steps."""
        by_step = ("served_min", "served_max", "cold_before", "day")
        return replace(
            self,
            **{name: getattr(self, name)[steps] for name in by_step},
            longest_off=self.longest_off.part(steps),
        )

    def priced(self, hour_beyond: Floats, dt_h: float) -> SwitchingData:
        """The rules at the prices of an hour beyond the longest time off, (C,)."""
        return replace(self, longest_off=self.longest_off.priced(hour_beyond, dt_h))

    def without_duties(self) -> SwitchingData:
        """The rules without duties of the past: no customer has to be supplied."""
        return replace(
            self,
            served_min=np.zeros_like(self.served_min),
            actions_left=np.full_like(self.actions_left, UNLIMITED),
        )

    def in_the_dark(self, dark: Flags) -> SwitchingData:
        """The rules with steps in which no customer can be supplied: no duty holds then.

        They are those of all, (W,), or of each, (W, C).
        """
        if not dark.any():
            return self
        of_each = dark if dark.ndim == 2 else dark[:, None]
        return replace(self.without_duties(), served_max=self.served_max & ~of_each)

    @property
    def idle(self) -> bool:
        """Whether any service obeys, at no price and with no higher demand."""
        return self._any_switching and not len(self.longest_off)

    @property
    def only_time_off(self) -> bool:
        """Whether all that the rules say is how long customers may be off."""
        return self._any_switching and len(self.longest_off) > 0

    @property
    def _any_switching(self) -> bool:
        """Whether customers may be switched at will.

        Minimum times of one step are no rule, nor is a limit of as many actions as a day has steps.
        """
        steps = self.steps
        free = steps.served == steps.unserved == 1 and not self.served_min.any()
        enough = (self.actions_left >= self.in_day.sum(axis=1)[:, None]).all()
        unlimited = self.served_max.all() and enough
        return bool(free and unlimited and steps.cold == 0 and self.price_per_action == 0.0)

    @property
    def in_day(self) -> Flags:
        """Whether a step is in a day, (D, W)."""
        return np.asarray(self.day == np.arange(len(self.actions_left))[:, None])

    def changes(self, served: Flags) -> tuple[Flags, Flags]:
        """Customers that are switched on, and off, at the beginning of each step, (W, C) each."""
        before = np.vstack([self.served_before, served[:-1]])
        return served & ~before, before & ~served

    @property
    def price_of_pair(self) -> float:
        """Price of switching a customer off and on again, in weighted customer hours."""
        return 2.0 * self.price_per_action

    def price(self, served: Flags) -> float:
        """Price of a service, in weighted customer hours.

        Two actions for each switching off, and what is beyond the longest times off.
        """
        pairs = self.price_of_pair * float(self.changes(served)[1].sum())
        return pairs + self.longest_off.cost(served)

    def demand_factor(self, served: Flags) -> Floats:
        """Demand of each customer as a multiple of the usual one under a service, (W, C)."""
        on, _ = self.changes(served)
        cold = self.cold_before | _acted_within(on, self.steps.cold)
        return np.where(served & cold, self.cold_factor, 1.0)

    def broken(self, served: Flags) -> Flags:
        """Customers whose schedule breaks a rule, shape (C,)."""
        on, off = self.changes(served)
        broken = (self.served_min & ~served) | (served & ~self.served_max)
        broken |= _acted_within(on, self.steps.served) & ~served
        broken |= _acted_within(off, self.steps.unserved) & served
        actions = self.in_day.astype(float) @ (on | off)
        beyond = (actions > self.actions_left).any(axis=0)
        return np.asarray(broken.any(axis=0) | beyond)

    def connected(self, unlimited: Flags) -> Flags:
        """Customers that are served without loss where the import has no limit, (W, C).

        Those served before the window up to its first limited step, and all customers after the
        last limited step; where minimum times unserved, actions or cold load matter, none
        (``docs/method.md``).
        """
        if self.only_time_off:
            return np.tile(unlimited[:, None], self.served_max.shape[1])
        limited = (self.actions_left < UNLIMITED).any()
        if self.steps.unserved > 1 or self.steps.cold or limited:
            return np.zeros_like(self.served_max)
        prefix = np.cumprod(unlimited).astype(bool)[:, None] & self.served_before
        suffix = np.cumprod(unlimited[::-1])[::-1].astype(bool)[:, None]
        return np.asarray((prefix | suffix) & self.served_max)


@dataclass(frozen=True, eq=False)
class SwitchingState:
    """State of the switching rules, from the customers that were really served."""

    rules: SwitchingRules  #: the rules
    dt_h: float  #: length of a step in h
    served: Flags  #: who was served in the last step, (C,)
    since_h: Floats  #: time since the last action in h, infinite where there was none, (C,)
    actions: Floats  #: actions so far in the present day, (C,)
    longest_off_h: Floats  #: how long each may be off at a time in h, infinite for any time, (C,)
    duties: bool = True  #: whether the past demands anything of the service
    step: int = 0  #: the step that begins now, counted from the first

    @classmethod
    def start(cls, rules: SwitchingRules, dt_h: float, n_customers: int) -> SwitchingState:
        """All customers are supplied, have been for long, and may be off for any time."""
        served, forever = np.ones(n_customers, dtype=bool), np.full(n_customers, np.inf)
        return cls(rules, dt_h, served, forever, np.zeros(n_customers), forever)

    @classmethod
    def of(cls, rules: SwitchingRules, customers: Customers, dt_h: float) -> SwitchingState:
        """The start of a site's customers."""
        start = cls.start(rules, dt_h, len(customers))
        return replace(start, longest_off_h=customers.longest_off_h)

    @property
    def limits_time_off(self) -> bool:
        """Whether any customer may be off for so long only."""
        return bool(np.isfinite(self.longest_off_h).any())

    @property
    def matters(self) -> bool:
        """Whether any decision depends on who was served before."""
        return self.rules.active or self.limits_time_off

    @property
    def off_h(self) -> Floats:
        """How long each customer has been off in h, 0 if it was served in the last step."""
        return np.where(self.served, 0.0, self.since_h)

    def advance(self, served: Flags) -> SwitchingState:
        """The state after a step; the start goes on where no past matters."""
        if not self.matters:
            return self
        changed = served != self.served
        now, later = self._days(2)
        return replace(
            self,
            served=served.copy(),
            actions=self.actions + changed if now == later else np.zeros(len(served)),
            since_h=np.where(changed, 0.0, self.since_h) + self.dt_h,
            step=self.step + 1,
        )

    def demand_factor(self, served: Flags) -> Floats:
        """Demand of each customer in the step that begins now as a multiple of the usual one, (C,).

        >>> rules = SwitchingRules(cold_load_factor=1.5)
        >>> state = SwitchingState.start(rules, 1.0, 1).advance(np.array([False]))
        >>> state.demand_factor(np.array([True]))
        array([1.5])
        """
        if not self.rules.cold:
            return np.ones(len(served))
        return np.asarray(self.window(1).demand_factor(served[np.newaxis])[0])

    @property
    def due(self) -> Flags:
        """Customers that would be off beyond their longest time now, (C,)."""
        return due(self.longest_off_h, self.off_h, self.dt_h)

    @property
    def restored(self) -> Flags:
        """Customers that are served again after an interruption, (C,)."""
        return np.asarray(self.served & np.isfinite(self.since_h))

    def window(self, n_steps: int) -> SwitchingData:
        """The rules of the window that begins now."""
        rules = self.rules
        step = np.arange(n_steps)[:, None]
        # A customer restored for good stays served for as long as any window looks.
        served_h = np.inf if rules.stay_restored else rules.min_served_h
        most = rules.max_actions_per_customer
        days = self._days(n_steps)
        n_days = 1 if most is None else int(days[-1]) + 1
        shape = RuleSteps(
            served=n_steps if rules.stay_restored else self._steps(served_h, n_steps),
            unserved=self._steps(rules.min_unserved_h, n_steps),
            cold=self._steps(rules.cold_load_h, n_steps) if rules.cold else 0,
            days=n_days,
        )
        cold_h = max(rules.cold_load_h, self.dt_h) if rules.cold else 0.0
        left = np.full((n_days, len(self.served)), UNLIMITED if most is None else float(most))
        if most is not None:
            left[0] = np.maximum(most - self.actions, 0.0)
        data = SwitchingData(
            steps=shape,
            served_before=self.served,
            served_min=self.restored & (step < self._steps_left(served_h)),
            served_max=self.served | (step >= self._steps_left(rules.min_unserved_h)),
            actions_left=left,
            price_per_action=rules.price_per_action,
            cold_factor=rules.cold_load_factor,
            cold_before=self.restored & (step < self._steps_left(cold_h)),
            day=days,
            longest_off=LongestOff.of(self.longest_off_h, self.off_h, self.dt_h, n_steps),
        )
        return data if self.duties else data.without_duties()

    def _days(self, n_steps: int) -> Wholes:
        """Day of the steps from now on, counted from the present one, (n_steps,)."""
        hours = (self.step + np.arange(n_steps)) * self.dt_h
        day = np.floor(hours / DAY_H + 1e-9).astype(np.int64)
        return np.asarray(day - day[0])

    def _steps(self, hours: float, n_steps: int) -> int:
        """Steps of a minimum time, at least 1; more than the window has makes no difference."""
        return min(max(SwitchingRules.steps(hours, self.dt_h), 1), n_steps)

    def _steps_left(self, hours: float) -> Floats:
        """Steps that a time since the last action still lasts, (C,)."""
        if np.isinf(hours):
            return np.where(np.isfinite(self.since_h), np.inf, 0.0)
        return np.ceil((hours - self.since_h) / self.dt_h - 1e-9)


@dataclass(frozen=True, eq=False)
class Owed:
    """Demand that dimmed customers lack, by the steps in which it may still be caught up."""

    kw: Floats  #: demand of a step, (K, C); that of row k may be caught up in the next k + 1 steps
    steps: Wholes  #: steps in which each may catch up, 0 for a customer that does not, (C,)

    @classmethod
    def of(cls, customers: Customers, dt_h: float) -> Owed:
        """Nothing is owed yet; a table without rows if no customer catches up."""
        steps = customers.recovery_steps(dt_h)
        return cls(np.zeros((steps.max(initial=0), len(customers))), steps)

    def after(self, load_kw: Floats, share: Floats) -> Owed:
        """Owed demand after a step of this demand, of which each was given a share, (C,) each.

        The oldest is caught up first. Of a customer that is off, nothing is caught up later.

        >>> owed = Owed(np.zeros((2, 1)), np.array([2]))
        >>> owed = owed.after(np.array([10.0]), np.array([0.4]))
        >>> owed.kw.ravel().tolist()
        [0.0, 6.0]
        >>> owed.after(np.array([10.0]), np.array([1.5])).kw.ravel().tolist()
        [1.0, 0.0]
        """
        paid_kw = load_kw * np.maximum(share - 1.0, 0.0)
        before_kw = np.cumsum(self.kw, axis=0) - self.kw
        left_kw = self.kw - np.clip(paid_kw - before_kw, 0.0, self.kw)
        aged = np.vstack([left_kw[1:], np.zeros_like(left_kw[:1])])
        more_kw = np.where(share > 0.0, load_kw * np.maximum(1.0 - share, 0.0), 0.0)
        newest = np.arange(len(aged))[:, None] == self.steps - 1
        return Owed(aged + newest * more_kw, self.steps)

    def valid(self, n_steps: int) -> Floats:
        """Demand that may still be caught up at the beginning of each step of a window, (W, C)."""
        rows = np.vstack([self.kw, np.zeros((n_steps, self.kw.shape[1]))])
        return np.cumsum(rows[::-1], axis=0)[::-1][:n_steps]


def _acted_within(actions: Flags, steps: int) -> Flags:
    """Whether there was an action in the last ``steps`` steps, the present one included."""
    found = np.zeros_like(actions)
    for back in range(min(steps, len(actions))):
        found[back:] |= actions[: len(actions) - back]
    return found

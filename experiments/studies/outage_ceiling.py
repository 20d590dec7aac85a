"""The most that anyone can make of uncertain outages: exact, without network, in seconds.

All batteries are one on a copper plate and customers are served in shares, so that the policies of
``experiments.studies.uncertain`` take milliseconds a day. ``best`` is a bound for all that do not
know the truth: its battery holds at every onset what it can have charged since midnight, at no
cost. It rations by the exact value over (energy; hours out; all that was said of the length), of
someone who knows how days are drawn and foresees that messages become better. ``python -m
experiments.studies.outage_ceiling --days 300``
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import typer
from scipy.special import ndtr, ndtri

from benchmarks.frame.pages import markdown_table
from benchmarks.frame.paired import by_seed
from benchmarks.frame.seeds import Study, report
from experiments.report import machine
from experiments.studies.outage_days import Outage, OutageClimate, OutageDay, draw_outage_day
from vppres.core.arrays import Flags, Floats
from vppres.day.outages import GridSeen
from vppres.io.find import load_scenario
from vppres.outlook import durations
from vppres.outlook.belief import OutageBelief
from vppres.outlook.outlook import OutageOutlook
from vppres.outlook.presets import Statistics
from vppres.outlook.value import Ahead, EquivalentBattery, stored_value
from vppres.scenario.scenario import Scenario

POLICIES = {
    "likely": "the most likely outage",
    "belief": "the belief",
    "belief/2": "the belief, half the value of lost load",
    "belief/5": "the belief, a fifth of it",
    "best": "best of all that do not know the end",
    "known": "the exact window, H = 5 h",
}
VALUED = {"belief": 1.0, "belief/2": 0.5, "belief/5": 0.2}
"""Share of the value of lost load that a belief goes by."""

POINTS = 62
"""Energies that are told apart."""

WINDOW_STEPS = 6
SERVICE_FIRST_GBP = 1e6
"""Worth of a weighted customer hour where cost only decides between plans that serve the same."""

MEANS = np.linspace(-2.0, 2.6, 47)
"""Logarithms of lengths, from that of the median, at which values are computed."""

TRUTHS = (np.arange(15) + 0.5) / 15
"""Quantiles of the true length over which the next message is averaged."""

SIGNS, SIGN_WEIGHTS = np.polynomial.hermite_e.hermegauss(9)
"""Errors of the next message, and their weights."""

CLIMATE = OutageClimate()

Value = Callable[[int], tuple[Floats, float]]
"""By the step: what energies are worth behind it, and the GBP of a unit of that."""


@dataclass(frozen=True, eq=False)
class Plate:
    """A day without network: what it is worth to go from one energy to another in each step."""

    ahead: Ahead  #: demand, PV and prices
    fleet: EquivalentBattery  #: the battery
    energy_kwh: Floats  #: energies, (n,)
    #: By the energy before and behind a step, (T, n, n): service less curtailment, and service, in
    #: an outage; cost with grid. Minus infinity, or infinity, for what the battery cannot do.
    out: Floats
    service: Floats
    cost_gbp: Floats

    @classmethod
    def of(cls, scenario: Scenario) -> Plate:
        """The plate of a day of hours, in the paper's mode."""
        b = scenario.batteries
        power_kw = float(b.active_max_kw.sum())
        efficiencies = float(b.eta_charge.mean()), float(b.eta_discharge.mean())
        fleet = EquivalentBattery(
            float(b.energy_kwh @ b.soc_min),
            float(b.energy_kwh @ b.soc_max),
            power_kw,
            power_kw,
            *efficiencies,
        )
        ahead = _ahead(scenario, 0)
        energy = np.linspace(fleet.least_kwh, fleet.most_kwh, POINTS)
        change = energy[None] - energy[:, None]
        charge = np.where(change > 0.0, change / fleet.eta_charge, change * fleet.eta_discharge)
        steps = range(ahead.n_steps)
        allowed = np.abs(charge) <= power_kw
        net = [ahead.total_kw[t] - ahead.pv_kw[t] + charge for t in steps]
        worth = np.array([ahead.worth_in_outage(t, charge) for t in steps])
        service = np.array([ahead.service(t, ahead.pv_kw[t] - charge) for t in steps])
        cost = [ahead.price_gbp_per_kwh[t] * np.maximum(net[t], 0.0) for t in steps]
        return cls(
            ahead,
            fleet,
            energy,
            np.where(allowed, worth, -np.inf),
            np.where(allowed, service, -np.inf),
            np.where(allowed, np.array(cost), np.inf),
        )

    def worth(self, t: int, out: bool, gbp_per_service: float) -> Floats:
        """What the moves of a step are worth, (n, n), in weighted customer hours."""
        return np.asarray(self.out[t] if out else -self.cost_gbp[t] / gbp_per_service)

    def window(self, t: int, out: Flags) -> Floats:
        """What energies are worth behind step ``t`` in a window of a known future, (n,)."""
        behind = np.zeros(POINTS)
        for i in range(len(out) - 1, 0, -1):
            moves = self.worth(t + i, bool(out[i]), SERVICE_FIRST_GBP) + behind
            behind = moves.max(axis=1)
        return behind


def _ahead(scenario: Scenario, row: int) -> Ahead:
    """What is expected from a step on: exactly what comes, outages left out."""
    return Ahead(
        load_kw=scenario.load_kw[row:],
        pv_kw=scenario.pv_kw[row:].sum(axis=1),
        price_gbp_per_kwh=scenario.price_gbp_per_kwh[row:],
        import_kw=np.full(len(scenario.load_kw) - row, np.inf),
        export=None,
        weight=scenario.customers.weight,
        lambda_curt=scenario.objective.lambda_curt,
        dt_h=scenario.grid.dt_h,
        delivered_kwh=np.zeros(len(scenario.load_kw) - row),
    )


@cache
def heatwave() -> tuple[Scenario, Plate]:
    """The packaged day of the paper."""
    scenario = load_scenario("uk-heatwave-2022")
    return scenario, Plate.of(scenario)


# The bound.


@dataclass(frozen=True, eq=False)
class Rationing:
    """The best use of a battery in an outage that begins at a step after some messages.

    What it maximises is the expected share of service over the hours of the outage.
    """

    #: After ``j`` steps out, by the mean of the length's logarithm, (J, M, n): what energies are
    #: worth.
    behind: Floats
    hour: Floats  #: what an hour's service counts, (J, M): the mean of one by the length

    def value(self, j: int, mean: float) -> Floats:
        """What energies are worth behind a step, in hours of service of that step, (n,)."""
        place = np.interp(mean, MEANS, np.arange(len(MEANS)))
        low = min(int(place), len(MEANS) - 2)
        part = place - low
        behind = (1.0 - part) * self.behind[j, low] + part * self.behind[j, low + 1]
        hour = (1.0 - part) * self.hour[j, low] + part * self.hour[j, low + 1]
        return np.asarray(behind / hour)


@cache
def rationing(begin: int, messages: int) -> Rationing:
    """By dynamic programming from the end of the day, for an outage that begins at a step."""
    _, plate = heatwave()
    steps = plate.ahead.n_steps - begin
    precision = CLIMATE.duration_sigma**-2 + messages * CLIMATE.duration_sign**-2
    behind = np.zeros((steps, len(MEANS), POINTS))
    hour = np.zeros((steps, len(MEANS)))
    best = np.zeros((len(MEANS), POINTS))
    for j in range(steps - 1, -1, -1):
        known = precision + (j + 1) * CLIMATE.restoration_sign**-2
        length = np.array([_length(mean, known**-0.5) for mean in MEANS])
        left = length[:, j:].sum(axis=1)
        sure = left < 1e-12
        ends = np.where(sure, 1.0, length[:, j] / np.where(sure, 1.0, left))
        shares = 1.0 / np.minimum(np.arange(1, length.shape[1] + 1), steps)
        mean_share = (length[:, j:] @ shares[j:]) / np.where(sure, 1.0, left)
        hour[j] = np.where(sure, shares[j], mean_share)
        behind[j] = (1.0 - ends)[:, None] * (_next_means(j, known) @ best)
        moves = hour[j][:, None, None] * plate.out[begin + j] + behind[j][:, None]
        best = moves.max(axis=2)
    return Rationing(behind, hour)


def _length(mean: float, std: float) -> Floats:
    """Probabilities of the steps of an outage by the logarithm of its length."""
    median_h = CLIMATE.duration_median_h * float(np.exp(mean))
    return durations.lognormal(median_h, std, 1.0, 60)


def _next_means(j: int, precision: float) -> Floats:
    """Probability of each mean after the next message, if more than ``j + 1`` steps are out."""
    std = precision**-0.5
    sign_precision = CLIMATE.restoration_sign**-2
    so_far = np.log((j + 1.5) / CLIMATE.duration_median_h)
    below = ndtr((so_far - MEANS) / std)[:, None]
    quantile = np.clip(below + (1.0 - below) * TRUTHS, 1e-12, 1.0 - 1e-12)
    truth = MEANS[:, None] + std * ndtri(quantile)
    sign = truth[..., None] + CLIMATE.restoration_sign * SIGNS
    mean = (precision * MEANS[:, None, None] + sign_precision * sign) / (precision + sign_precision)
    place = np.interp(mean, MEANS, np.arange(len(MEANS)))
    low = np.minimum(place.astype(int), len(MEANS) - 2)
    part = place - low
    weight = np.broadcast_to(SIGN_WEIGHTS / SIGN_WEIGHTS.sum() / len(TRUTHS), mean.shape)
    found = np.zeros((len(MEANS), len(MEANS)))
    rows = np.broadcast_to(np.arange(len(MEANS))[:, None, None], mean.shape)
    np.add.at(found, (rows, low), weight * (1.0 - part))
    np.add.at(found, (rows, low + 1), weight * part)
    return found


def best_resilience(day: OutageDay) -> float:
    """Resilience with all that batteries can hold at each onset, and the best rationing then."""
    scenario, plate = heatwave()
    served = [_served(plate, day, outage, scenario.grid.start) for outage in day.outages]
    everyone = float(scenario.customers.weight.sum())
    return float(np.concatenate(served).mean() / everyone)


def _served(plate: Plate, day: OutageDay, outage: Outage, midnight: pd.Timestamp) -> Floats:
    """Service in each step of an outage."""
    scenario, _ = heatwave()
    announced = day.comes and outage is day.expected
    name = "announced" if announced else "surprise"
    hours = outage.steps
    said = {
        round((w.issued_at - midnight) / pd.Timedelta(hours=1)): np.log(w.duration_p50_h)
        for w in day.warnings
        if w.outage == name and w.duration_p50_h is not None
    }
    before = sum(hour < hours.start for hour in said)
    energy = _reachable(plate, scenario, hours.start)
    found = []
    steps = range(hours.start, min(hours.stop, plate.ahead.n_steps))
    for j, t in enumerate(steps):
        mean = said[t] - np.log(CLIMATE.duration_median_h)
        behind = rationing(hours.start, before).value(j, float(mean))
        chosen = int(np.argmax(plate.out[t, energy] + behind))
        found.append(plate.service[t, energy, chosen])
        energy = chosen
    return np.array(found)


def _reachable(plate: Plate, scenario: Scenario, hour: int) -> int:
    """The most energy that batteries can hold at an onset: charged at full power from midnight."""
    b = scenario.batteries
    begun_kwh = float(b.energy_kwh @ b.soc_initial)
    charged_kwh = plate.fleet.eta_charge * plate.fleet.p_max_kw * scenario.grid.dt_h * hour
    most_kwh = min(begun_kwh + charged_kwh, plate.fleet.most_kwh)
    # The point above it, so that the bound stays one.
    return int(np.searchsorted(plate.energy_kwh, most_kwh - 1e-9))


# The policies.


@dataclass(frozen=True)
class Outcome:
    """What a policy made of a day on the copper plate."""

    seed: int  #: the day, the same for every policy
    #: What day it was, and what was known of outages.
    kind: str
    policy: str
    hours: int  #: hours without grid
    resilience: float | None  #: none on a day without outage
    cost_gbp: float | None  #: as in ``experiments.studies.uncertain``; None for the bound


def ceiling_day(seed: int) -> list[Outcome]:
    """All policies on one day."""
    scenario, plate = heatwave()
    day = draw_outage_day(seed, scenario.grid.start, CLIMATE)
    hours = np.arange(plate.ahead.n_steps)
    out = np.any([np.isin(hours, outage.steps) for outage in day.outages] or [hours < 0], axis=0)
    beliefs = believed(scenario, day, out)
    found = []
    for policy in POLICIES:
        if policy == "best":
            resilience = best_resilience(day) if out.any() else None
            cost = None
        else:
            resilience, cost = played(plate, out, _value(policy, scenario, plate, out, beliefs))
        found.append(Outcome(seed, day.kind, policy, int(out.sum()), resilience, cost))
    return found


def believed(scenario: Scenario, day: OutageDay, out: Flags) -> list[OutageBelief]:
    """The belief at each step."""
    outlook = OutageOutlook(day.warnings, CLIMATE.statistics, scenario.grid.dt_h)
    grid = GridSeen()
    found = []
    for t, now in enumerate(scenario.grid.times):
        grid = grid.after(now, 0.0 if out[t] else np.inf)
        found.append(outlook.at(now, len(out) - t, grid.outages))
    return found


def _value(
    policy: str, scenario: Scenario, plate: Plate, out: Flags, beliefs: Sequence[OutageBelief]
) -> Value:
    """What a policy takes energies to be worth."""
    if policy in VALUED:
        gbp_per_kwh = (
            VALUED[policy] * Statistics.of(CLIMATE.statistics).value_of_lost_load_gbp_per_kwh
        )
        return lambda t: _believed_value(scenario, plate, t, beliefs[t], gbp_per_kwh)

    def of_window(t: int) -> tuple[Floats, float]:
        future = out[t:] if policy == "known" else beliefs[t].likely
        return plate.window(t, future[:WINDOW_STEPS]), SERVICE_FIRST_GBP

    return of_window


def _believed_value(
    scenario: Scenario, plate: Plate, t: int, belief: OutageBelief, gbp_per_kwh: float
) -> tuple[Floats, float]:
    """What a belief takes energies to be worth behind a step."""
    price = float(scenario.price_gbp_per_kwh.min()) / plate.fleet.eta_charge

    def end_gbp(energy_kwh: Floats) -> Floats:
        return price * (energy_kwh - plate.fleet.least_kwh)

    value = stored_value(belief, plate.fleet, _ahead(scenario, t), gbp_per_kwh, end_gbp)
    return np.interp(plate.energy_kwh, value.energy_kwh, value.service), value.gbp_per_service


def played(plate: Plate, out: Flags, value: Value) -> tuple[float | None, float]:
    """Resilience and cost of a day, by what energies are taken to be worth."""
    energy = 0
    served = []
    cost = 0.0
    for t, dark in enumerate(out):
        behind, gbp_per_service = value(t)
        moves = plate.worth(t, bool(dark), gbp_per_service)[energy] + behind
        chosen = int(np.flatnonzero(moves >= moves.max() - 1e-9)[0])
        if dark:
            served.append(plate.service[t, energy, chosen])
        else:
            cost += plate.cost_gbp[t, energy, chosen]
        energy = chosen
    price = float(plate.ahead.price_gbp_per_kwh.min()) / plate.fleet.eta_charge
    cost -= price * float(plate.energy_kwh[energy] - plate.energy_kwh[0])
    share = float(np.mean(served) / plate.ahead.weight.sum()) if served else None
    return share, float(cost)


# Report.


def _table(outcomes: Sequence[Outcome]) -> str:
    """Every policy on some days."""
    outages = [one for one in outcomes if one.resilience is not None]

    def of(policy: str) -> Floats:
        return by_seed(outages, lambda one: one.resilience, policy=policy)

    likely, known = of("likely"), of("known")
    hours = by_seed(outages, lambda one: one.hours, policy="likely")
    spent = {
        name: by_seed(outcomes, lambda one: one.cost_gbp, policy=name).sum() for name in POLICIES
    }
    rows = [
        (
            words,
            f"{of(name).mean():.4f}",
            f"{(of(name) - likely).mean() / (known - likely).mean():.2f}",
            f"{(of(name) - likely) @ hours / ((known - likely) @ hours):.2f}",
            "" if name == "best" else f"{spent[name] / spent['likely'] - 1.0:+.2%}",
        )
        for name, words in POLICIES.items()
    ]
    head = ("what is known", "R", "gap closed", "gap closed, by hours of service", "cost")
    return markdown_table(head, rows)


def _write(days: Sequence[list[Outcome]], wall_s: float, folder: Path) -> Path:
    """Tables of all days and of those of each kind that has outages."""
    outcomes = [one for day in days for one in day]
    parts = [
        "No network: one battery on a copper plate, customers served in shares. The best of all "
        "that do not know the end has a full battery at every onset, at no cost, and rations by "
        "the exact value; it bounds the expected R of every such policy. Costs are those of all "
        "days.",
        _counted("All days", outcomes),
    ]
    for kind in ("announced", "unannounced"):
        of_kind = [one for one in outcomes if one.kind == kind]
        if of_kind:
            parts.append(_counted(kind.capitalize(), of_kind))
    parts.append(f"Wall time {wall_s / 60:.1f} min, {machine()}.")
    title = "What can be made of uncertain outages at best"
    return report(folder / "outage-ceiling", title, "\n\n".join(parts), outcomes, wall_s)


def _counted(title: str, outcomes: Sequence[Outcome]) -> str:
    """A table under its title."""
    days = len({one.seed for one in outcomes})
    outages = len({one.seed for one in outcomes if one.resilience is not None})
    return f"## {title}: {days} days, {outages} with an outage\n\n{_table(outcomes)}"


STUDY = Study(ceiling_day, _write, width=120)


main = STUDY.command(
    days=300, words="Bound what can be made of the days of ``experiments.studies.uncertain``."
)


if __name__ == "__main__":
    typer.run(main)

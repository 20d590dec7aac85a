"""Words of explanations: binding limits in the report's terms, and figures in sentences."""

from __future__ import annotations

from collections.abc import Sized

import numpy as np

from vppres.core.arrays import Floats, Names
from vppres.core.text import in_pounds
from vppres.core.units import h_to_minutes
from vppres.explain.costs import WORTH
from vppres.explain.prices import WHOLE, WORTH_GBP
from vppres.explain.reason import Binding, Scarce
from vppres.explain.step import Step
from vppres.kinds.table import KINDS
from vppres.scenario.phases import PHASES
from vppres.scenario.priority import Ranks

SCARCE: dict[Binding, str] = {
    "energy": "stored energy",
    "power": "battery power",
    "inverter": "inverter rating",
    "rating": "the rating of a line",
    "phase": "the rating of a phase",
    "voltage": "the voltage limit",
    "grid": "the grid limit",
    "": "nothing",
}


def scarce_name(step: Step, binding: Binding) -> str:
    """Name of what is scarce; the source of power in an island that has no batteries."""
    if binding not in ("power", "energy") or len(step.site.batteries):
        return SCARCE[binding]
    units: list[tuple[str, Sized]] = [(step.site.pv.word, step.site.pv)]
    giving = (kind for kind in step.site.kinds if KINDS[kind].gives)
    units += [(KINDS[kind].what, step.site.kinds[kind]) for kind in giving]
    return f"power from {' and '.join(name for name, each in units if len(each)) or 'batteries'}"


def too_little(step: Step, binding: Scarce) -> str:
    """Phrase for too little of what is scarce."""
    if binding in ("energy", "power", "inverter"):
        return f"not enough {scarce_name(step, binding)} to supply it in full"
    if binding == "phase":
        return "a phase of the grid-forming battery would be overloaded"
    return f"{SCARCE[binding]} does not allow its full demand"


def figure(value: float) -> str:
    """A number with two digits that count.

    >>> figure(0.0012217), figure(0.21), figure(1234.5)
    ('0.0012', '0.21', '1230')
    """
    if value == 0 or not np.isfinite(value):
        return "0"
    digits = 2 if abs(value) < 100 else 3
    rounded = float(f"{value:.{digits}g}")
    return f"{rounded:.0f}" if abs(rounded) >= 100 else f"{rounded:.10f}".rstrip("0").rstrip(".")


def money(value: float) -> str:
    """An amount per kWh, to a tenth of a penny.

    >>> money(0.4032), money(-0.05)
    ('£0.403', '-£0.050')
    """
    return in_pounds(value, ".3f")


def pounds(value: float) -> str:
    """The value of a kWh: whole pounds from 10 on, else to a penny.

    >>> pounds(41.7), pounds(0.523)
    ('£42', '£0.52')
    """
    return in_pounds(value, ".0f" if value >= 10.0 else ".2f")


def one_more(step: Step, binding: Binding, which: int | None = None) -> str:
    """The value of one more unit of the binding limit, without a full stop; empty if none.

    ``which`` is a battery, or of ratings a line or a phase; the most valuable one if not given.
    """
    p = step.service
    if p is None:
        return ""
    batteries, buses = step.site.batteries.id, step.scenario.network.buses
    rated = p.former_phase if binding == "phase" else p.line_rating
    full = int(np.argmax(rated)) if which is None and len(rated) else which or 0
    offers: list[tuple[float, str]] = []
    if binding == "energy":
        offers = [(float(p.stored_energy.max(initial=0.0)), "one more stored kWh")]
    elif binding == "power":
        offers = [
            _dearest("one more kW of battery", batteries, p.battery_discharging, which),
            _dearest("one more kW at bus", buses, p.active),
        ]
    elif binding == "inverter":
        offers = [
            _dearest("one more kVA of battery", batteries, p.battery_inverter, which),
            _dearest("one more kvar at bus", buses, p.reactive),
        ]
    elif binding == "voltage":
        offers = [_dearest("a voltage limit 0.001 pu lower at bus", buses, p.voltage_floor)]
    elif binding == "rating":
        offers = [(float(rated[full]), f"one more kVA through {line_name(step, full)}")]
    elif binding == "phase":
        offers = [(float(rated[full]), f"one more kVA on {phase_name(step, full)}")]
    elif binding == "grid":
        offers = [(p.grid, "one more kW from the grid")]
    worth = ((value, what) for value, what in offers if value > WORTH)
    return next((f"{what} would add {service_words(step, value)}" for value, what in worth), "")


def line_words(step: Step, line: int) -> str:
    """A line with its ends, and the share of its rating that its AC current has."""
    return f"{line_name(step, line)} ({step.loading[line]:.0%} of its rating)"


def line_name(step: Step, line: int) -> str:
    """A line or transformer with the buses at its ends, of a phased feeder with its phase."""
    if step.site.phases:
        return f"the {step.phased.model.rated[line]}"
    net = step.scenario.network
    kind = "line" if net.ratio[line] == 1.0 else "transformer"
    return f"the {kind} from {net.from_bus[line]} to {net.to_bus[line]}"


def phase_name(step: Step, phase: int) -> str:
    """A phase of the device that holds an island."""
    supply = step.phased.supply
    source, own = divmod(phase, len(PHASES))
    name = "" if supply is None else supply.fed[source][1]
    return f"phase {PHASES[own]} of {name or 'the grid'}"


def service_words(step: Step, value: float, kwh: float = 1.0) -> str:
    """Service in words, of so many kWh or kW: in strict order of a tier that is rationed."""
    ranks = step.site.ranks
    load_kw = step.levels.window.load_kw
    if ranks is None or step.levels.service is None:
        return hours(value, ranks, load_kw, kwh)
    share = step.levels.service.served_share
    in_part = (share > WHOLE) & (share < 1.0 - WHOLE)
    return hours(value, ranks, np.where(in_part, load_kw, 0.0) if in_part.any() else load_kw, kwh)


def hours(value: float, ranks: Ranks | None, load_kw: Floats, kwh: float = 1.0) -> str:
    """Service in words: weighted customer hours; in strict order a time of supply in one tier.

    In strict order it is about the tier of the customer, by ``load_kw``, (W, C), whose supply is
    worth most nearly as much for the energy ``kwh`` that adds or takes this service.

    Examples
    --------
    >>> hours(0.21, None, np.ones((1, 1)))
    '0.21 weighted customer hours'
    """
    if ranks is None:
        return f"{figure(value)} weighted customer hours"
    takes = load_kw > 0.0
    worth = np.log(np.broadcast_to(ranks.weight, load_kw.shape)[takes] / load_kw[takes])
    off = np.abs(worth - np.log(max(value, WORTH) / max(kwh, WORTH)))
    tiers = np.broadcast_to(ranks.tier, load_kw.shape)[takes]
    return hours_of(value, ranks, int(tiers[np.argmin(off)]) if len(off) else len(ranks.tiers) - 1)


def hours_of(value: float, ranks: Ranks, tier: int) -> str:
    """A value of the strict order as the time for which it supplies a customer of a tier."""
    return (
        f"{time_of(value / ranks.worth[tier])} of supply for a customer of tier {ranks.tiers[tier]}"
    )


def time_of(hours: float) -> str:
    """A time in a unit that can be grasped.

    >>> time_of(0.0027), time_of(0.33), time_of(2.0)
    ('9.7 s', '20 min', '2 h')
    """
    minutes = h_to_minutes(hours)
    if hours >= 1.0:
        return f"{figure(hours)} h"
    return f"{figure(minutes)} min" if minutes >= 1.0 else f"{figure(60.0 * minutes)} s"


def stored_worth_gbp(step: Step, battery: int) -> float | None:
    """Later saving of a stored kWh; None if unknown, or if service decides."""
    if step.cost is None:
        return None
    value = float(step.cost.kept_energy[battery])
    return value if value > WORTH_GBP else None


def _dearest(
    what: str, names: Names, values: Floats, which: int | None = None
) -> tuple[float, str]:
    """The highest of some values, or a given one, and at which of the names it is."""
    if not len(values):
        return 0.0, what
    at = int(np.argmax(values)) if which is None else which
    return float(values[at]), f"{what} {names[at]}"

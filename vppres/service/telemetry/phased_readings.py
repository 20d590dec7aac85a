"""Readings by phase: which phases there are, and what those of an asset add up to."""

from __future__ import annotations

from collections.abc import Iterable

from vppres.control.guard.balance import tolerance_kw
from vppres.core.errors import Problem
from vppres.live.by_phase import GRID
from vppres.physics.phased_sources import labels_by_source
from vppres.scenario.phases import PHASES
from vppres.scenario.scenario import Scenario
from vppres.service.payloads import Readings
from vppres.service.storage.records import Reading
from vppres.service.telemetry.refused import Refusal

SUMMED = ("load_kw", "pv_kw", "battery_kw", "import_kw")
"""Powers whose phases add up to the asset's."""

ALWAYS = ("source_kva", "v_pu")
"""Quantities that are of a phase, and never of all of them."""

WHERE = "telemetry"


def stored(quantity: str, phase: str | None) -> str:
    """The name under which a quantity of a phase is kept.

    >>> stored("source_kva", "a"), stored("load_kw", None)
    ('source_kva/a', 'load_kw')
    """
    return f"{quantity}/{phase}" if phase else quantity


def phases_of(scenario: Scenario, quantity: str, asset: str) -> list[str]:
    """Phases that a quantity of an asset has; none of a feeder without phases."""
    phases = scenario.phases
    if not phases:
        return []
    if quantity == "v_pu":
        grid, island = labels_by_source(scenario)
        return [*dict.fromkeys(phase for bus, phase in (*grid, *island) if bus == asset)]
    if asset == GRID or quantity == "source_kva":
        return list(PHASES)
    return phases.connection(asset).coils.split()


def wrong_phase(one: Readings, scenario: Scenario) -> Problem | None:
    """Error of the phase of readings."""
    needed = one.quantity in ALWAYS
    if not (one.phase or needed):
        return None
    allowed = needed or one.quantity in SUMMED
    known = phases_of(scenario, one.quantity, one.asset) if allowed else []
    if one.phase in known:
        return None
    cure = f"Give one of {', '.join(known)}." if known else "Leave the phase out."
    field = f"phase of {one.quantity} of {one.asset}"
    return Problem(WHERE, "is no phase of it", cure, None, field, str(one.phase))


def with_sums(
    readings: Iterable[Reading], scenario: Scenario
) -> tuple[list[Reading], list[Refusal]]:
    """Readings of a batch with the sums of powers by phase, and what does not fit together.

    Of an asset that lacks a phase nothing is kept: phases of other batches would not add up with
    it. A power of all phases that is not their sum is not kept.
    """
    kept: list[Reading] = []
    refused: list[Refusal] = []
    found: dict[tuple[str, str, str, int, int], dict[str, Reading]] = {}
    for one in readings:
        quantity, _, phase = one.quantity.partition("/")
        if phase and quantity in SUMMED:
            key = one.asset, quantity, one.source, one.time, one.resolution_s
            found.setdefault(key, {})[phase] = one
        else:
            kept.append(one)
    added: list[Reading] = []
    totals: dict[tuple[str, str, str, int], Reading] = {}
    for (asset, quantity, source, time, long), phases in found.items():
        lacking = [p for p in phases_of(scenario, quantity, asset) if p not in phases]
        if lacking:
            message = f"lacks phase {' and '.join(lacking)}"
            cure = "Send all phases of an asset in one batch."
            wrong = Problem(WHERE, message, cure, None, f"{quantity} of {asset}")
            refused.append(Refusal(source, asset, quantity, wrong))
            continue
        total = Reading(asset, quantity, time, source, long, sum(p.value for p in phases.values()))
        totals[_place(total)] = total
        added += [*phases.values(), total]
    for one in kept:
        sum_kw = totals.get(_place(one), one).value
        # By more than meters are off by it is another power.
        if abs(one.value - sum_kw) > tolerance_kw(abs(sum_kw)):
            refused.append(_other_than(sum_kw, one))
    return [*(one for one in kept if _place(one) not in totals), *added], refused


def _place(one: Reading) -> tuple[str, str, str, int]:
    """Place of a reading in the store, which holds one value there."""
    return one.asset, one.quantity, one.source, one.time


def _other_than(sum_kw: float, one: Reading) -> Refusal:
    message = f"is not the sum of its phases, {sum_kw:g} kW"
    cure = "Send the phases alone, or the sum alone."
    wrong = Problem(WHERE, message, cure, None, f"{one.quantity} of {one.asset}", one.value)
    return Refusal(one.source, one.asset, one.quantity, wrong)

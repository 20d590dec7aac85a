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
    for (asset, quantity, source, time, long), phases in found.items():
        lacking = [p for p in phases_of(scenario, quantity, asset) if p not in phases]
        if lacking:
            message = f"lacks phase {' and '.join(lacking)}"
            cure = "Send all phases of an asset in one batch."
            wrong = Problem(WHERE, message, cure, None, f"{quantity} of {asset}")
            refused.append(Refusal(source, asset, quantity, wrong))
            continue
        total = Reading(asset, quantity, time, source, long, sum(p.value for p in phases.values()))
        refused += [_other_than(total, one) for one in kept if _contradicts(one, total)]
        kept = [one for one in kept if not _same(one, total)]
        kept += [*phases.values(), total]
    return kept, refused


def _same(one: Reading, total: Reading) -> bool:
    """Whether a reading is of all phases of which there is a sum."""
    key = one.asset, one.quantity, one.source, one.time
    return key == (total.asset, total.quantity, total.source, total.time)


def _contradicts(one: Reading, total: Reading) -> bool:
    """Whether it is another power than the sum, by more than meters are off by."""
    off_kw = abs(one.value - total.value)
    return _same(one, total) and off_kw > tolerance_kw(abs(total.value))


def _other_than(total: Reading, one: Reading) -> Refusal:
    message = f"is not the sum of its phases, {total.value:g} kW"
    cure = "Send the phases alone, or the sum alone."
    wrong = Problem(WHERE, message, cure, None, f"{one.quantity} of {one.asset}", one.value)
    return Refusal(one.source, one.asset, one.quantity, wrong)

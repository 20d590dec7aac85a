"""Results of a reconfiguration as sentences, and as a record for machines."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from vppres.core.text import named
from vppres.feeders.reconfiguration.loops import SwitchedNetwork, branch_names
from vppres.feeders.reconfiguration.search import (
    SAME_KW,
    Configuration,
    ConfigurationLimits,
    LeastLoss,
)
from vppres.feeders.reconfiguration.sequence import MOST_OPERATIONS, MOST_STATES, SwitchingOrder
from vppres.feeders.reconfiguration.told import Operation

EXACT_COUNT = 1e15
"""Number from which on a determinant has no exact digits."""


def count_words(feeder: SwitchedNetwork, most: int) -> str:
    """How many configurations there are, and whether all will be solved."""
    count = feeder.count
    ties = f"{feeder.n_loops} open switch{'es' if feeder.n_loops > 1 else ''}"
    number = f"{count:,}" if count < EXACT_COUNT else f"about {count:.2g}"
    how = "all are solved" if count <= most else f"more than {most:,}, so that a search tries some"
    return f"{ties}, {number} radial configurations: {how}."


def outcome_words(feeder: SwitchedNetwork, found: LeastLoss) -> Iterator[str]:
    """Operations, and what is certain of them, in sentences."""
    opened, closed = _operations(feeder, found.best)
    if opened:
        yield f"Close {named(closed)}; open {named(opened)}."
    else:
        yield "No switch has to move."
    kept = found.best.excess == 0.0
    if not kept and found.exact:
        yield "No radial configuration keeps the limits: this one exceeds them least."
    elif not kept:
        yield "No radial configuration within the limits was found: this one exceeds them least."
    elif found.exact:
        yield "Exact: no other radial configuration within the limits has lower losses."
    else:
        yield (
            f"Best found: the search solved {found.solved:,} configurations, and there may be a "
            "better one."
        )
    if found.exact and found.solved < found.count:
        yield f"No power flow was found for {found.count - found.solved:,} of them."


def order_words(order: SwitchingOrder) -> Iterator[str]:
    """Operations in their order, in sentences, or the reason why there is none."""
    if order.operations is None:
        yield f"There is no order of operations. {order.reason}"
        return
    if order.operations:
        yield "Order of operations:"
    yield from (f"{i}. {one.sentence}" for i, one in enumerate(order.operations, start=1))
    if order.margin < 0.0:
        yield "The feeder is beyond its limits now, and no state in between is further beyond."
    if not order.all_orders:
        yield (
            f"With more than {MOST_OPERATIONS // 2} exchanges not all orders were compared: after "
            f"each operation the best {MOST_STATES} states were followed."
        )


def order_record(order: SwitchingOrder) -> dict[str, Any]:
    """An order as JSON can hold it; ``operations`` is null if there is none."""
    found = order.operations
    return {
        "operations": None if found is None else [_operation_record(one) for one in found],
        "least_margin": order.margin if found else None,
        "all_orders": order.all_orders,
        "reason": order.reason,
    }


def _operation_record(one: Operation) -> dict[str, Any]:
    """An operation; its margin is in pu of a voltage, or a share of a rating."""
    return {
        "switch": one.switch,
        "operation": "close" if one.closes else "open",
        "margin": one.margin.value,
        "interrupted": list(one.interrupted),
        "minutes": one.minutes,
        "sentence": one.sentence,
    }


def differs(found: LeastLoss) -> bool:
    """Whether the limits cost losses."""
    return found.best.losses_kw > found.unlimited.losses_kw + SAME_KW


def reconfiguration_record(
    feeder: SwitchedNetwork, found: LeastLoss, limits: ConfigurationLimits
) -> dict[str, Any]:
    """A result as JSON can hold it."""
    opened, closed = _operations(feeder, found.best)
    return {
        "configurations": found.count,
        "solved": found.solved,
        "exact": found.exact,
        "limits": {
            "v_min_pu": limits.v_min_pu,
            "v_max_pu": limits.v_max_pu,
            "ratings": limits.ratings,
        },
        "close": closed,
        "open": opened,
        "before": _record(feeder, found.present),
        "after": _record(feeder, found.best),
        "without_limits": _record(feeder, found.unlimited),
    }


def open_names(feeder: SwitchedNetwork, configuration: Configuration) -> list[str]:
    """Names of the branches that are open."""
    names = branch_names(feeder)
    return [names[branch] for branch in configuration.opened]


def _operations(feeder: SwitchedNetwork, best: Configuration) -> tuple[list[str], list[str]]:
    """Names of what is opened and of what is closed."""
    names = branch_names(feeder)
    present = {*map(int, feeder.present)}
    opened = [names[branch] for branch in best.opened if branch not in present]
    closed = [names[branch] for branch in sorted(present - {*best.opened})]
    return opened, closed


def _record(feeder: SwitchedNetwork, one: Configuration) -> dict[str, Any]:
    """A configuration; without a power flow its figures are null."""
    solved = one.losses_kw < float("inf")
    figures = {
        "losses_kw": one.losses_kw,
        "v_min_pu": one.v_min_pu,
        "bus_min": one.bus_min,
        "v_max_pu": one.v_max_pu,
        "loading": one.loading,
    }
    return {
        **{name: value if solved else None for name, value in figures.items()},
        "keeps_limits": one.excess == 0.0,
        "open": open_names(feeder, one),
    }
